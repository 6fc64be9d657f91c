"""Simulation and training: the SAPIEN scene, the domains, recovery learning and dreaming. The only room with SAPIEN."""
