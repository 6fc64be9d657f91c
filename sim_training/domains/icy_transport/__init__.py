"""Icy Transport: a car brings cargo through doorways in which ice or mud pushes it aside."""

from resync_robot.sim_training.domains.icy_transport.domain import ICY_TRANSPORT

__all__ = ["ICY_TRANSPORT"]
