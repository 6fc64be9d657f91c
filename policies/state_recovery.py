"""The learned recovery as a skill: approach, run the policy until its beta says done, get out of the way."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from resync_robot.core import spatial
from resync_robot.core.joints import JointTarget
from resync_robot.core.library import Record
from resync_robot.core.rig import Rig
from resync_robot.core.skill import Skill, SkillEnd, SkillOutcome
from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.core.vocabulary import BLOCK, BOX, ROBOT
from resync_robot.core.world import ArmObservation
from resync_robot.learning.recovery_policy import STUD, ActorCritic, commanded_tip, observe, project
from resync_robot.learning.terminals import Terminal
from resync_robot.policies.cartesian import Blocked, Hand, Motion, run_motion
from resync_robot.policies.grasp import travel_height
from resync_robot.policies.tip_over_guard import TipOverGuard, press_on

RATE_HZ = 50.0
DECISION_STEPS = 5
"""Control steps between two decisions of the policy: 10 Hz, as it was trained."""
NOISE = 0.25
"""Standard deviation of the actions that PPO tried towards its end, in those of [-1, 1]."""

UNMOVED, SUREST = 0.003, 0.95
"""An attempt that has moved its block by less than this, m, is done only from this probability on: as far as training
went on where it could have stopped. Who asks for the recovery has found that something fails."""


@dataclass(frozen=True, kw_only=True)
class RecoverySkillSettings:
    approach_height: float = 0.06
    """m over the stud at which the policy takes over."""
    travel_speed: float = 0.25
    approach_speed: float = 0.10
    max_decisions: int = 150
    patience: int = 75
    """Decisions, more than nearly any run takes that gets there. After them the policy is followed with the noise that
    it was trained with: without it, what leads nowhere is done again and again, in this run and in the next."""
    sure: float = 0.5
    """Probability of beta at which it is done, where the record names none."""
    effort_limit: tuple[float, ...] = (40.0, 40.0, 40.0, 12.0, 12.0, 12.0)
    """N m; as in training. Without it the arm can press harder than the block stands."""
    closed: float = 0.010
    """m between the pads below which the hand counts as closed. The policy has only ever pressed with closed fingers;
    what it would do with something between them nobody has tried."""


def recovery_skill(name: str, record: Record, rig: Rig, settings: RecoverySkillSettings | None = None) -> Skill:
    """The skill of a library record, over (robot, block, box). Raises LibraryError on a broken record."""
    s = settings or RecoverySkillSettings()
    net, done = recovery_nets(record)
    return skill_from(name, net.act, done.probability, rig, replace(s, sure=how_sure(record)))


def how_sure(record: Record) -> float:
    """The probability of beta_N from which on the recovery of a record is done."""
    return float(record.meta.get("sure", RecoverySkillSettings.sure))


def recovery_nets(record: Record) -> tuple[ActorCritic, Terminal]:
    """The policy and the terminal function of a record. Raises LibraryError on a broken one."""
    net = ActorCritic.from_record(Record(record.meta.get("policy", {}), _part(record, "policy.")))
    return net, Terminal.from_record(Record(record.meta.get("terminal", {}), _part(record, "terminal.")))


def skill_from(
    name: str, act: Callable[[Tensor], Tensor], done: Callable[[Tensor], Tensor], rig: Rig, s: RecoverySkillSettings
) -> Skill:
    """A recovery skill from a policy and a terminal function over (n, 19) observations."""
    return Skill(
        name,
        (ROBOT, BLOCK, BOX),
        lambda objects, first: run_motion(_recover(objects, first, rig, act, done, s), first),
        RATE_HZ,
        time_limit_s=45,
        live_state=True,
        effort_limit=s.effort_limit,
    )


def _recover(
    objects: tuple[Object, ...],
    first: ArmObservation,
    rig: Rig,
    act: Callable[[Tensor], Tensor],
    done: Callable[[Tensor], Tensor],
    s: RecoverySkillSettings,
) -> Motion:
    robot, block, box = objects
    hand = Hand(rig, first, 1.0 / RATE_HZ, stray=np.inf)
    above = travel_height(first.state, carried=None)
    try:
        refused = yield from approach(hand, first.state, block, box, above, s)
        if refused is not None:
            return refused
        finished, guard = False, TipOverGuard()
        noise = torch.Generator().manual_seed(round(1000 * first.time))
        began = first.state.get(block, "x", "y")
        for decision in range(s.max_decisions):
            projected = project(hand.last.state, robot, block, box, hand.position)
            with torch.no_grad():
                seen = observe(projected)
                if float(done(seen)) > sure_enough(s.sure, hand.last.state.get(block, "x", "y") - began):
                    finished = True
                    break
                action = act(seen)
                if decision >= s.patience:
                    action = action + NOISE * torch.randn(action.shape, generator=noise)
                goal = commanded_tip(projected, action)[0].double().numpy()
            yield from press_on(hand, goal, DECISION_STEPS, guard)
        yield from leave(hand, above, s)
    except Blocked as blocked:
        return SkillOutcome(SkillEnd.BLOCKED, str(blocked))
    if not finished:
        return SkillOutcome(
            SkillEnd.TIMEOUT, f"in {s.max_decisions} decisions the policy did not say that {block} is free"
        )
    return SkillOutcome(SkillEnd.DONE)


def sure_enough(sure: float, way: Float[np.ndarray, "2"]) -> float:
    """The probability from which on an attempt is done that has moved its block by (2,) m, where `sure` is usual."""
    return sure if np.linalg.norm(way) > UNMOVED else max(sure, SUREST)


def approach(
    hand: Hand,
    state: State,
    block: Object,
    box: Object,
    above: float,
    s: RecoverySkillSettings,
    aside: tuple[float, float] = (0.0, 0.0),
) -> Generator[JointTarget, ArmObservation, SkillOutcome | None]:
    """Close the fingers and bring them over the block, square to the box at the smallest turn, as in training.

    Args:
        above: m, the height of the tips at which they travel.
        aside: m beside the block's middle, along the axes of the world.

    Returns:
        None, or why it cannot be: the hand is in no condition for it, or the block is not in the box, over which the
        tips stay. Raises Blocked.
    """
    box_T_world = spatial.inverse(spatial.pose_from_features(state[box][:7]))
    place = spatial.apply(box_T_world, state.get(block, "x", "y", "z")[None])[0]
    if (np.abs(place[:2]) > state.get(box, "inner_x", "inner_y") / 2).any():
        return SkillOutcome(SkillEnd.REFUSED, f"{block} is not in {box}")
    x, y, z, height = state.get(block, "x", "y", "z", "size_z")
    x, y = x + aside[0], y + aside[1]
    yaw = float(spatial.wrap(spatial.yaw_of(state.get(box, "qw", "qx", "qy", "qz")), np.pi / 2))
    yield from hand.retreat(above, s.approach_speed)
    yield from hand.close(0.0)
    if hand.last.opening > s.closed:
        gap = 1000 * hand.last.opening
        return SkillOutcome(SkillEnd.REFUSED, f"the pads stand {gap:.0f} mm apart: something is between them")
    yield from hand.move(x, y, above, yaw, s.travel_speed)
    start = min(above, z + height / 2 + STUD + s.approach_height)
    yield from hand.move(x, y, start, yaw, s.approach_speed)
    return None


def leave(hand: Hand, above: float, s: RecoverySkillSettings) -> Generator[JointTarget, ArmObservation, None]:
    """Straight up, off the block. Raises Blocked."""
    yield from hand.move(hand.position[0], hand.position[1], above, hand.yaw, s.approach_speed)


def _part(record: Record, prefix: str) -> dict[str, np.ndarray]:
    return {k.removeprefix(prefix): v for k, v in record.tensors.items() if k.startswith(prefix)}
