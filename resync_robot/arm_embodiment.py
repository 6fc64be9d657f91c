"""The arm as an embodiment: its given skills live in `policies`, its scenes in `sim_training`, which do not know each
other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from resync_robot.core.embodiment import Embodiment, Stage
from resync_robot.core.rig import Rig
from resync_robot.core.symbols import Operator
from resync_robot.policies.given_skills import given_skills
from resync_robot.policies.press_interface import PressInterface
from resync_robot.policies.scripted import RATE_HZ
from resync_robot.sim_training.physics.world import SimWorld


def arm_embodiment(rig: Rig, operators: Sequence[Operator]) -> Embodiment:
    """The arm of a rig in the simulator: its actions are targets of its joints, rad, and of its pads, m. Its skills are
    those that a domain has operators for."""
    limits = {f"q{i}": (-most, most) for i, most in enumerate(rig.arm.kinematics.limit)}
    return Embodiment(
        actions={**limits, "opening": (0.0, rig.gripper.max_opening)},
        rate_hz=RATE_HZ,
        simulate=partial(SimWorld, rig=rig),
        skills=partial(given_skills, rig, tuple(operators)),
    )


def arm_stage(stage: Stage, rig: Rig) -> Stage:
    """A stage of an arm's domain, its recovery a press of the closed hand."""
    return replace(stage, interface=PressInterface(rig))
