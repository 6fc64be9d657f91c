"""The recovery by camera around its policy: what it asks, when it stops, and what a broken camera comes to."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from resync_robot.core.skill import SkillEnd, SkillOutcome
from resync_robot.core.world import ArmObservation, Cutout, Ready, Window, awaited
from resync_robot.learning.camera_view import PICTURE, STATE_NAMES, VIEWS, Prediction
from resync_robot.learning.recovery_policy import LOWEST_TIP
from resync_robot.planning.skill_run import run_skill
from resync_robot.policies.camera_recovery import MonitorSettings, camera_recovery_skill
from resync_robot.policies.grasp import travel_height
from resync_robot.policies.state_recovery import RecoverySkillSettings
from resync_robot.policies.tip_over_guard import BENEATH, LET_GO_RISE
from resync_robot.sim_training.physics.camera_noise import NoisySensor, Tone
from resync_robot.sim_training.physics.randomise import BLOCK_HUES, LOOKS, draw_looks
from resync_robot.sim_training.physics.world import SimWorld
from tests import scenes
from tests.policies.followers import RIG, Follower
from tests.scenes import B0, THE_BOX, R

SCENE = scenes.scene({"b0": (scenes.CORNER, scenes.CORNER), "b1": (0.0, 0.0)}).initial
SETTINGS = RecoverySkillSettings(max_decisions=60)


@dataclass
class Seeing(Follower):
    """A follower with cameras that show noise, unless told otherwise."""

    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))
    black: str = ""
    frozen: str = ""
    late: float = 0.0
    ready: Ready = awaited

    def observe(self, live: bool = False) -> ArmObservation:
        return replace(super().observe(live), look=self.look, ready=self.ready)

    def look(self, name: str, window: Window, size: int) -> Cutout:
        colour = self.rng.integers(60, 200, (size, size, 3)).astype(np.uint8)
        if name == self.black:
            colour = self.rng.integers(0, 3, (size, size, 3)).astype(np.uint8)
        if name == self.frozen:
            colour = np.full((size, size, 3), 90, dtype=np.uint8)
        return Cutout(name, colour, self.time - self.late)


@dataclass
class Scripted:
    """A policy that wants `step` always, and says that it is done from its `done_at`-th answer on."""

    step: tuple[float, float, float] = (0.01, 0.0, 0.0)
    done_at: int = 10_000
    away: float = 0.0
    free: float = 1.0
    lean: float = 0.0
    up: float = -0.06
    seconds: float = 0.0
    picture: int = PICTURE
    asked: int = 0

    def __call__(self, pictures: np.ndarray, state: np.ndarray) -> Prediction:
        assert pictures.shape == (1, len(VIEWS), self.picture, self.picture, 3) and state.shape == (1, len(STATE_NAMES))
        time.sleep(self.seconds)
        self.asked += 1
        return Prediction(
            np.tile(np.array(self.step), (1, 8, 1)),
            np.array([float(self.asked >= self.done_at)]),
            np.array([self.free]),
            np.array([[self.away, 0.0, self.up, 0.05, 0.05, self.lean, 0.0]]),
        )


def run(policy: Callable[..., Prediction], **world: object) -> tuple[SkillOutcome, Seeing]:
    seeing = Seeing(SCENE, **world)  # type: ignore[arg-type]
    skill = camera_recovery_skill("Recover", policy, RIG, SETTINGS)
    assert not skill.live_state, "it would see the simulator's state"
    return run_skill(seeing, skill.ground((R, B0, THE_BOX))), seeing


def test_it_ends_when_the_policy_has_said_so_twice_and_gets_out_of_the_way() -> None:
    policy = Scripted(done_at=3)
    outcome, world = run(policy)
    assert outcome == SkillOutcome(SkillEnd.DONE)
    assert policy.asked == 4
    assert world.tips[-1][2] >= travel_height(SCENE, None) - 1e-3


def test_a_policy_gets_pictures_of_the_size_that_it_wants() -> None:
    assert run(Scripted(done_at=1, picture=96))[0] == SkillOutcome(SkillEnd.DONE)


def test_a_block_that_leans_is_let_go() -> None:
    pulled, let_go, high_up = (
        run(Scripted(step=(0.01, 0.0, 0.0), lean=lean, up=up))[1]
        for lean, up in ((0.05, -0.01), (0.3, -0.01), (0.3, -0.06))
    )
    assert [tip[0] for tip in high_up.tips] == [tip[0] for tip in pulled.tips], "it has let go already"
    assert max(tip[0] for tip in pulled.tips) > max(tip[0] for tip in let_go.tips) + 0.005
    assert np.ptp([tip[1] for tip in let_go.tips[-50:]]) < 1e-3, "straight up"


@pytest.mark.parametrize("away", [0.0, -0.006, -0.012, -0.03])
def test_a_hand_that_slid_off_comes_back_over_where_the_policy_sees_the_block(away: float) -> None:
    _, world = run(Scripted(step=(0.0, 0.0, -0.015), away=away))
    tips = np.array(world.tips)
    top = float((SCENE.get(B0, "z") + SCENE.get(B0, "size_z") / 2)[0])
    sunk = np.flatnonzero((tips[1:, 2] < top - BENEATH) & (tips[:-1, 2] >= top - BENEATH))
    # Here nothing bears the hand, so it sinks, rises and comes back again and again.
    assert len(sunk) >= 4
    first, second = tips[sunk[0]], tips[sunk[1]]
    # Nothing has dragged the block, but the hand has been where it stood, so it may be 3 cm away all the same.
    assert np.linalg.norm((second - first)[:2]) == pytest.approx(abs(away), abs=3e-3)
    up = tips[sunk[0] : sunk[1], 2]
    assert up.max() == pytest.approx(up.min() + LET_GO_RISE, abs=1e-3)
    level = tips[sunk[0] : sunk[1]][up > up.max() - 1e-3]
    assert np.abs(np.diff(level[:, :2], axis=0)).max() < 0.2 * 0.02, "no faster than 0.2 m/s"


def test_a_policy_that_says_done_of_a_block_that_it_sees_stuck_is_not_believed() -> None:
    outcome, _ = run(Scripted(done_at=3, free=0.1))
    assert outcome.ending is not SkillEnd.DONE


def test_a_policy_that_is_never_done_ends_with_a_time_out() -> None:
    moving = iter(np.tile([[0.01, 0, 0], [-0.01, 0, 0]], (100, 1)))

    class Restless(Scripted):
        def __call__(self, pictures: np.ndarray, state: np.ndarray) -> Prediction:
            return replace(super().__call__(pictures, state), steps=np.tile(next(moving), (1, 8, 1)))

    outcome, _ = run(Restless())
    assert outcome.ending is SkillEnd.TIMEOUT


def test_the_hand_stays_in_the_box_whatever_the_policy_wants() -> None:
    _, world = run(Scripted(step=(0.0, 0.0, -0.03)))
    assert min(tip[2] for tip in world.tips) >= scenes.FLOOR + LOWEST_TIP - 2e-3
    _, world = run(Scripted(step=(0.03, 0.0, 0.0)))
    inside = [tip for tip in world.tips if tip[2] < 0.125]
    assert max(tip[0] for tip in inside) < scenes.BOX_X + scenes.INNER / 2


@pytest.mark.parametrize(
    ("policy", "world", "words"),
    [
        (Scripted(), {"black": "side"}, "camera 'side' is black"),
        (Scripted(), {"frozen": "front"}, "camera 'front' has given the same picture"),
        (Scripted(), {"late": 0.4}, "0.40 s old"),
        (Scripted(lean=0.99), {}, "the block leans by 82 degrees"),
        (Scripted(away=0.2), {}, "not beneath the hand any more"),
        (Scripted(step=(0.0, 0.0, 0.0)), {}, "has not moved"),
        (Scripted(step=(0.0, 0.09, 0.0)), {}, "wants a step of 90 mm"),
        (Scripted(step=(0.0, np.nan, 0.0)), {}, "numbers that are none"),
    ],
)
def test_what_cannot_be_right_ends_the_skill_with_a_reason(
    policy: Scripted, world: dict[str, object], words: str
) -> None:
    outcome, seeing = run(policy, **world)
    assert outcome.ending is SkillEnd.BLOCKED and words in outcome.reason
    assert seeing.tips[-1][2] >= travel_height(SCENE, None) - 1e-3, "the hand was left in the box"


@dataclass
class Rendered(Seeing):
    """Cameras that show a rendered world, as if `order` were their cables."""

    world: SimWorld | None = None
    order: tuple[int, ...] = (0, 1, 2)

    def look(self, name: str, window: Window, size: int) -> Cutout:
        assert self.world is not None
        self.world.built.set_configuration(self.arm, self.opening)
        shown = VIEWS[self.order[VIEWS.index(name)]]
        sensor = NoisySensor(int(1000 * self.time), RIG.camera(shown), tone=Tone.of(self.world.task.physics))
        colour = sensor.colour(self.world.render_window(shown, window, size, np.eye(4)).colour)
        return Cutout(name, colour, self.time)


@pytest.mark.parametrize("looks", LOOKS)
def test_every_exchange_of_cameras_is_noticed_before_the_policy_begins(looks: str) -> None:
    physics = draw_looks(np.random.default_rng(4), ("b0", "b1"), LOOKS[looks])
    task = scenes.scene({"b0": (scenes.CORNER, scenes.CORNER), "b1": (0.0, 0.0)}, **physics)
    world = SimWorld(task, RIG, rendered=True)
    for order in itertools.permutations(range(len(VIEWS))):
        policy = Scripted(done_at=1)
        seeing = Rendered(task.initial, world=world, order=order)
        skill = camera_recovery_skill("Recover", policy, RIG, SETTINGS, hues=BLOCK_HUES)
        outcome = run_skill(seeing, skill.ground((R, B0, THE_BOX)))
        if order == (0, 1, 2):
            assert outcome.done, looks
            continue
        first = next(i for i, j in enumerate(order) if i != j)
        words = f"the pictures of camera '{VIEWS[first]}' show what '{VIEWS[order[first]]}' must see"
        assert outcome.ending is SkillEnd.BLOCKED and outcome.reason == words, (looks, order)
        assert policy.asked == 0 and seeing.tips[-1][2] >= travel_height(SCENE, None) - 1e-3


def test_pictures_that_are_a_tenth_of_a_second_late_are_as_in_training() -> None:
    outcome, _ = run(Scripted(done_at=3), late=0.1)
    assert outcome.done


def test_a_world_without_cameras_is_said_to_be_one() -> None:
    skill = camera_recovery_skill("Recover", Scripted(), RIG, SETTINGS)
    outcome = run_skill(Follower(SCENE), skill.ground((R, B0, THE_BOX)))
    assert outcome.ending is SkillEnd.BLOCKED and "no camera" in outcome.reason


def test_a_block_on_the_table_is_refused() -> None:
    recover = camera_recovery_skill("Recover", Scripted(), RIG, SETTINGS)
    outcome = run_skill(Follower(scenes.scene(scenes.ON_THE_TABLE).initial), recover.ground((R, B0, THE_BOX)))
    assert outcome.ending is SkillEnd.REFUSED and "b0 is not in box" in outcome.reason


def test_something_between_the_pads_refuses_it() -> None:
    outcome, _ = run(Scripted(), between=0.05)
    assert outcome.ending is SkillEnd.REFUSED


def test_a_slow_policy_is_bridged_in_real_time_and_waited_for_in_simulation() -> None:
    # The follower's clock runs far faster than the policy thinks: every chunk but what must be is late.
    quick, slow = Scripted(done_at=5), Scripted(done_at=5, seconds=0.02)
    one, waited = run(quick)
    two, again = run(slow)
    assert one == two and len(waited.tips) == len(again.tips)
    outcome, bridged = run(Scripted(done_at=5, seconds=0.02), ready=Future.done)
    assert outcome.done and len(bridged.tips) > len(waited.tips)


def test_the_monitor_s_limits_can_be_set() -> None:
    strict = MonitorSettings(largest_step=0.005)
    skill = camera_recovery_skill("Recover", Scripted(), RIG, SETTINGS, strict)
    outcome = run_skill(Seeing(SCENE), skill.ground((R, B0, THE_BOX)))
    assert "wants a step of 10 mm" in outcome.reason


def test_no_two_attempts_begin_alike_and_all_over_the_block() -> None:
    starts = []
    for begun in (0.0, 7.3, 20.1):
        seeing = Seeing(SCENE, time=begun)
        skill = camera_recovery_skill("Recover", Scripted(step=(0.0, 0.0, 0.0), done_at=1), RIG, SETTINGS)
        assert run_skill(seeing, skill.ground((R, B0, THE_BOX))).done
        starts.append(min(seeing.tips, key=lambda tip: float(tip[2]))[:2])
    block = SCENE.get(B0, "x", "y")
    assert all(np.abs(start - block).max() < 0.005 for start in starts)
    assert min(np.linalg.norm(a - b) for a, b in itertools.pairwise(starts)) > 1e-4
