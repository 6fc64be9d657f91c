"""resync-robot: a robot that learns from its own failures (ReSYNC)."""

__version__ = "0.1.0"
