"""Blocked Stacking: one block upon another, with a slab, a crate or a wall in the way."""

from resync_robot.sim_training.domains.blocked_stacking.domain import BLOCKED_STACKING

__all__ = ["BLOCKED_STACKING"]
