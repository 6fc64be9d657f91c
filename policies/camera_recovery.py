"""The recovery as the deployed robot runs it: three pictures, the joints and the scan in, steps of the hand out.

The policy thinks on a thread of its own while the step before is carried out, so the stream of targets never waits
for it. A monitor looks at the same pictures and predictions, and ends the skill where they make no sense: the planner
then looks around and plans anew. Before the policy begins, one look at whole pictures tells whether cameras were
exchanged.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
import torch

from resync_robot.core.joints import JointTarget
from resync_robot.core.rig import Rig
from resync_robot.core.skill import Skill, SkillEnd, SkillOutcome
from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.core.vocabulary import BLOCK, BOX, ROBOT
from resync_robot.core.world import ArmObservation, Cutout, Ready
from resync_robot.learning.camera_view import (
    DONE,
    DONE_IN_A_ROW,
    LEAN,
    VIEWS,
    CameraPolicy,
    Chunks,
    Prediction,
    Scanned,
    careful_steps,
    from_hand,
    leans,
    says_done,
    state_seen,
    window_at,
)
from resync_robot.learning.carried import Carried
from resync_robot.learning.recovery_policy import STEP, project, within_reach
from resync_robot.policies import camera_order
from resync_robot.policies.carried_block import ByState, CarriedBlock
from resync_robot.policies.cartesian import Blocked, Hand, Motion, run_motion
from resync_robot.policies.grasp import travel_height
from resync_robot.policies.state_recovery import (
    DECISION_STEPS,
    NOISE,
    RATE_HZ,
    RecoverySkillSettings,
    approach,
    leave,
    sure_enough,
)
from resync_robot.policies.tip_over_guard import TipOverGuard, press_on

ATTEMPT = RecoverySkillSettings(max_decisions=120, patience=40)
"""Most recoveries take 2 to 4 s. What goes by the scan, and not by pictures, does the same again and again without the
noise that comes after `patience`. A block that rather tips over than slides is let go at every press, and gets on by a
millimetre or two each time. What has not worked in 12 s is better begun again after another scan."""
ASIDE = 0.004
"""m beside the block's middle at which an attempt may begin; demonstrations begin up to 6 mm beside it."""
OVER_STEP = 0.015
"""m in 0.1 s, on the way back over a block that was let go."""


@dataclass(frozen=True, kw_only=True)
class MonitorSettings:
    """When a recovery is given up. Lengths in m, times in s."""

    dark: float = 6.0
    """Mean brightness of a picture, of 255, below which the camera counts as black."""
    frozen: int = 3
    """Times in a row that a camera may give the very same picture; noise makes any two differ."""
    late: float = 0.25
    """Age of a picture; training has pictures that are up to 0.1 s old."""
    largest_step: float = 0.035
    """Of the hand in 0.1 s: training never sees more than 0.02 along an axis."""
    stall_decisions: int = 30
    stall: float = 0.004
    """The hand has moved less than this in so many decisions, and the policy does not say that it is done."""
    lost: float = 0.09
    """Horizontal distance from the tips to the block, as the policy sees it, at which the block counts as lost."""
    lost_in_a_row: int = 4
    leaning: float = 0.6
    """Sine of the block's lean, as the policy sees it, from which on letting go does not bring it back."""
    leaning_in_a_row: int = 2


def camera_recovery_skill(
    name: str,
    policy: CameraPolicy,
    rig: Rig,
    settings: RecoverySkillSettings | None = None,
    monitor: MonitorSettings | None = None,
    hues: Mapping[str, float] | None = None,
    by_state: ByState | None = None,
) -> Skill:
    """A recovery over (robot, block, box) that follows its block by camera.

    Args:
        hues: of blocks by name, in [0, 1), by which exchanged cameras are found; without any they are not.
        by_state: what taught the policy; it acts by the scan where pictures show what cannot be.

    Raises:
        UnknownNameError: the rig lacks a camera that the policy looks through.
    """
    s, m = settings or ATTEMPT, monitor or MonitorSettings()
    for view in VIEWS:
        rig.camera(view)
    return Skill(
        name,
        (ROBOT, BLOCK, BOX),
        lambda objects, first: run_motion(_recover(objects, first, rig, policy, s, m, hues or {}, by_state), first),
        RATE_HZ,
        time_limit_s=45,
        effort_limit=s.effort_limit,
    )


class Stopped(Exception):
    """The monitor ends the skill; the message says why."""


def _recover(
    objects: tuple[Object, ...],
    first: ArmObservation,
    rig: Rig,
    policy: CameraPolicy,
    s: RecoverySkillSettings,
    m: MonitorSettings,
    hues: Mapping[str, float],
    by_state: ByState | None,
) -> Motion:
    robot, block, box = objects
    hand = Hand(rig, first, 1.0 / RATE_HZ, stray=np.inf)
    above = travel_height(first.state, carried=None)
    finished = False
    # No two attempts alike: what failed once from one place would fail again from there.
    aside = np.random.default_rng(round(1000 * first.time)).uniform(-ASIDE, ASIDE, 2)
    try:
        refused = yield from approach(hand, first.state, block, box, above, s, (float(aside[0]), float(aside[1])))
        if refused is not None:
            return refused
        _check_order(hand.last, rig, hues)
        with ThreadPoolExecutor(1, "camera-policy") as thread:
            finished = yield from _drive(hand, (robot, block, box), rig, policy, thread, s, m, by_state)
        yield from leave(hand, above, s)
    except Blocked as blocked:
        return SkillOutcome(SkillEnd.BLOCKED, str(blocked))
    except Stopped as stopped:
        yield from hand.back_off(above, s.approach_speed)
        return SkillOutcome(SkillEnd.BLOCKED, str(stopped))
    if not finished:
        return SkillOutcome(
            SkillEnd.TIMEOUT, f"in {s.max_decisions} decisions the policy did not say that {block} is free"
        )
    return SkillOutcome(SkillEnd.DONE)


def _drive(
    hand: Hand,
    objects: tuple[Object, Object, Object],
    rig: Rig,
    policy: CameraPolicy,
    thread: ThreadPoolExecutor,
    s: RecoverySkillSettings,
    m: MonitorSettings,
    by_state: ByState | None,
) -> Generator[JointTarget, ArmObservation, bool]:
    """Steps until the policy says that it is done. Returns whether it did. Raises Stopped."""
    watch, scanned = Watch(m, rig), Scanned.of(hand.last.state, *objects[1:])
    chunks, thinking = Chunks(), _Thinking(policy, thread)
    z, height = hand.last.state.get(objects[1], "z", "size_z")
    guard, astray, done_in_a_row = TipOverGuard(top=z + height / 2), False, 0
    block, blind = CarriedBlock(hand.last.state, objects), False
    noise = np.random.default_rng(round(1000 * hand.last.time))
    for decision in range(s.max_decisions):
        block.carried.follow(hand.tip())
        goal = block.step(by_state, hand.tip(), hand.position) if blind and by_state else None
        if blind and goal is None:
            return True
        if goal is not None and decision >= s.patience:
            goal = _reach(hand, objects, goal + NOISE * STEP * noise.standard_normal(3))
        if goal is None:
            goal = _reach(hand, objects, hand.position + from_hand(watch.step(chunks.next()), hand.yaw))
        if chunks.wanting and not thinking.busy:
            thinking.ask(*_observe(hand, goal, scanned, block.carried, rig, policy.picture, watch))
        if not (yield from press_on(hand, goal, DECISION_STEPS, guard)):
            # What was wanted, and what is being thought, is of a block that stood.
            block.carried.fell_back(guard.stood_at)
            if guard.sank_at is not None:
                block.sank(guard.sank_at)
            thinking.answer(hand.last.ready, wait=True)
            chunks, astray = Chunks(), True
            continue
        block.sank(hand.tip())
        answer = thinking.answer(hand.last.ready, wait=not chunks.left)
        if answer is not None:
            prediction, late = answer
            watch.prediction(prediction)
            refuted = by_state is not None and block.refutes(prediction, hand.tip())
            blind = refuted and not leans(prediction)[0]
            if blind:
                chunks, astray, done_in_a_row = Chunks(), False, 0
                continue
            if astray:
                # The policy comes down where the scan says, or where a block that it has dragged would be, and so on
                # the edge of one that has moved otherwise. Where that one is, it sees.
                beneath = hand.tip() + from_hand(np.array([*prediction.block[0, :2], 0.0]), hand.yaw)
                over = _reach(hand, objects, np.array([*block.plausible(beneath[:2]), hand.tip()[2]]))
                over[2] = hand.position[2]
                steps = DECISION_STEPS * _decisions(over - hand.position)
                astray = not (yield from press_on(hand, over, steps, guard))
                continue
            chunks.push(careful_steps(prediction)[0], late)
            says_so = says_done(prediction, sure_enough(DONE, block.carried.away))[0]
            done_in_a_row = done_in_a_row + 1 if says_so and not refuted else 0
            if done_in_a_row >= DONE_IN_A_ROW:
                return True
        watch.motion(hand.tip())
    return False


def _decisions(way: np.ndarray) -> int:
    """How many steps of the policy's own size that is."""
    return max(1, int(np.ceil(np.abs(way).max() / OVER_STEP)))


class _Thinking:
    """One question to the policy at a time, answered on its own thread."""

    def __init__(self, policy: CameraPolicy, thread: ThreadPoolExecutor) -> None:
        self._policy, self._thread = policy, thread
        self._future: Future[Prediction] | None = None
        self._steps = 0

    @property
    def busy(self) -> bool:
        return self._future is not None

    def ask(self, pictures: np.ndarray, state: np.ndarray) -> None:
        self._future, self._steps = self._thread.submit(self._policy, pictures[None], state[None]), 0

    def answer(self, ready: Ready, wait: bool) -> tuple[Prediction, int] | None:
        """The prediction, and by how many control steps it is late; None while the policy still thinks."""
        if self._future is None:
            return None
        if not wait and not ready(self._future):
            self._steps += 1
            return None
        found, self._future = self._future.result(), None
        return found, self._steps


@dataclass
class Watch:
    """Notices what cannot be right. Every method raises Stopped."""

    settings: MonitorSettings
    rig: Rig
    _last: dict[str, tuple[bytes, int]] = field(default_factory=dict)
    _tips: list[np.ndarray] = field(default_factory=list)
    _lost: int = 0
    _leaning: int = 0

    def picture(self, cutout: Cutout, now: float) -> None:
        m = self.settings
        if float(cutout.colour.mean()) < m.dark:
            raise Stopped(f"camera '{cutout.name}' is black")
        age = now - cutout.time
        if age > m.late:
            raise Stopped(f"the picture of camera '{cutout.name}' is {age:.2f} s old; allowed: {m.late} s")
        content = cutout.colour.tobytes()
        before, times = self._last.get(cutout.name, (b"", 0))
        times = times + 1 if content == before else 1
        self._last[cutout.name] = content, times
        if times > m.frozen:
            raise Stopped(f"camera '{cutout.name}' has given the same picture {times} times")

    def prediction(self, p: Prediction) -> None:
        m = self.settings
        if not all(np.all(np.isfinite(part)) for part in (p.steps, p.done, p.block)):
            raise Stopped("the policy gives numbers that are none")
        lean = float(np.hypot(*p.block[0, LEAN]))
        self._leaning = self._leaning + 1 if lean > m.leaning else 0
        if self._leaning >= m.leaning_in_a_row:
            raise Stopped(f"the block leans by {np.degrees(np.arcsin(min(1.0, lean))):.0f} degrees")
        away = float(np.hypot(*p.block[0, :2]))
        self._lost = self._lost + 1 if away > m.lost else 0
        if self._lost >= m.lost_in_a_row:
            raise Stopped(f"the block is not beneath the hand any more, but {1000 * away:.0f} mm beside it")

    def step(self, step: np.ndarray) -> np.ndarray:
        largest = float(np.abs(step).max())
        if largest > self.settings.largest_step:
            raise Stopped(f"the policy wants a step of {1000 * largest:.0f} mm in 0.1 s")
        return step

    def motion(self, tip: np.ndarray) -> None:
        m = self.settings
        self._tips.append(np.array(tip))
        recent = self._tips[-m.stall_decisions :]
        if len(recent) == m.stall_decisions and np.ptp(recent, axis=0).max() < m.stall:
            raise Stopped(f"the hand has not moved for {m.stall_decisions / 10:.0f} s")


def _observe(
    hand: Hand, goal: np.ndarray, scanned: Scanned, carried: Carried, rig: Rig, picture: int, watch: Watch
) -> tuple[np.ndarray, np.ndarray]:
    """Pictures (views, p, p, 3) and state (21,) as in training: the step to `goal` is under way."""
    seen = hand.last
    if seen.look is None:
        raise Stopped("there is no camera to look through")
    tip = rig.tip_pose(seen.arm)[:3, 3]
    pictures = []
    for view in VIEWS:
        camera = rig.camera(view)
        cutout = seen.look(view, window_at(camera, rig.camera_pose(camera, seen.arm), tip), picture)
        watch.picture(cutout, seen.time)
        pictures.append(cutout.colour)
    return np.stack(pictures), state_seen(seen.arm, tip, goal, hand.yaw, scanned, carried.away)


def _check_order(seen: ArmObservation, rig: Rig, hues: Mapping[str, float]) -> None:
    """Raises Stopped where the pictures of some cameras are explained by the places of others."""
    if seen.look is None:
        raise Stopped("there is no camera to look through")
    cameras = [rig.camera(view) for view in VIEWS]
    pictures = np.stack([seen.look(c.name, camera_order.whole(c), camera_order.SIZE).colour for c in cameras])
    foretold = [camera_order.foretell(c, rig.camera_pose(c, seen.arm), seen.state, hues) for c in cameras]
    order = camera_order.exchanged(camera_order.support(pictures, foretold))
    if order is not None:
        i = next(i for i, j in enumerate(order) if i != j)
        raise Stopped(f"the pictures of camera '{VIEWS[i]}' show what '{VIEWS[order[i]]}' must see")


def _reach(hand: Hand, objects: tuple[Object, Object, Object], wanted: np.ndarray) -> np.ndarray:
    """Where the tip is sent if it is wanted there: on its leash, inside the box as it was perceived."""
    state: State = hand.last.state
    x = project(state, *objects, hand.position)
    return within_reach(x, torch.as_tensor(wanted, dtype=torch.float32)[None])[0].double().numpy()
