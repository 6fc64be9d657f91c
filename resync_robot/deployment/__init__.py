"""An episode of a robot, simulated or real: devices, the world through cameras, recording, replay, film."""
