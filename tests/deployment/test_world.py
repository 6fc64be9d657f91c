"""What a skill may look at while it moves, and what the witness is told."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from resync_robot.core import spatial
from resync_robot.core.episode_records import Answer, Ask, Timing
from resync_robot.core.errors import InterruptedMotionError, PerceptionError, UnknownNameError
from resync_robot.core.rig import load_rig
from resync_robot.core.state import State
from resync_robot.core.vocabulary import BOX, TYPES
from resync_robot.core.world import Cutout, Window
from resync_robot.deployment.world import OracleWorld, walled
from resync_robot.hardware.base import ProtectiveStopError
from resync_robot.hardware.sim import SimRobot
from resync_robot.sim_training.physics.world import SimWorld
from tests import scenes
from tests.deployment.pretended import Told, Whole

RIG = load_rig()
WINDOW = Window(10.0, 20.0, 32.0, 32.0)


class Windowed(Whole):
    """One that gives parts for less."""

    def cut_out(self, window: Window, size: int) -> Cutout:
        self.asked.append(f"{window.left:.0f} {size}")
        return Cutout(self.name, np.zeros((size, size, 3), dtype=np.uint8), 2.5)


@pytest.fixture
def world() -> OracleWorld:
    simulated = SimWorld(scenes.scene({"b0": (0.0, 0.0)}), RIG)
    robot = SimRobot(simulated)
    robot.connect()
    cameras = {"front": Whole(), "side": Windowed("side"), "wrist": Whole("wrist", (640, 480))}
    return OracleWorld(robot, cameras, RIG, simulated.task.objects, simulated.perceive)


def test_a_part_is_cut_from_the_whole_or_taken_as_the_camera_gives_it(world: OracleWorld) -> None:
    look = world.observe().look
    assert look is not None
    cut = look("front", WINDOW, 16)
    assert cut.colour.shape == (16, 16, 3) and (cut.colour == 90).all()
    assert cut.time == 1.25
    assert look("side", WINDOW, 16).time == 2.5


def test_a_camera_that_is_not_there_or_mis_sized_is_named(world: OracleWorld) -> None:
    look = world.observe().look
    assert look is not None
    with pytest.raises(UnknownNameError, match="ceiling"):
        look("ceiling", WINDOW, 16)
    with pytest.raises(PerceptionError, match=r"'wrist'.*640 x 480"):
        look("wrist", WINDOW, 16)


def test_a_simulated_robot_waits_for_whoever_thinks(world: OracleWorld) -> None:
    with ThreadPoolExecutor(1) as thread:
        thought = thread.submit(time.sleep, 0.05)
        assert world.observe().ready(thought) and thought.done()
        broken = thread.submit(lambda: 1 / 0)
        assert world.observe().ready(broken)


def test_whatever_the_executive_is_told_the_witness_is_told_in_that_order(world: OracleWorld) -> None:
    answers: list[Answer] = []
    world._witness = Told(on_answer=answers.append)
    state = world.perceive()
    world.limit_effort(None)
    seen = world.observe()
    assert seen.look is not None
    seen.look("side", WINDOW, 16)
    with ThreadPoolExecutor(1) as thread:
        seen.ready(thread.submit(lambda: None))
    kinds = [Ask.MEASURE, Ask.TRUTH, Ask.REST, Ask.MEASURE, Ask.MEASURE, Ask.TRUTH, Ask.PART, Ask.THOUGHT]
    assert [a.ask for a in answers] == kinds
    assert State.from_json(answers[1].details["objects"], TYPES) == state
    np.testing.assert_array_equal(answers[4].details["arm"], seen.arm)
    assert answers[6].details["camera"] == "side" and answers[6].clock == 2.5
    assert answers[7].details["done"] is True
    np.testing.assert_array_equal(answers[2].target.arm, world.stream.target.arm)


def test_a_box_is_kept_free_of_all_but_the_hand() -> None:
    state = scenes.scene({"b0": (0.0, 0.0)}).initial
    box = next(o for o in state if o.type == BOX)
    inner_x, inner_y, wall, thickness = state.get(box, "inner_x", "inner_y", "wall_z", "wall_thickness")
    kept = walled(state, box)
    assert kept.name == box.name
    np.testing.assert_allclose(2 * kept.half, [inner_x + 2 * thickness, inner_y + 2 * thickness, wall])
    corner = kept.world_T_middle @ np.array([*kept.half, 1.0])
    floor = spatial.pose_from_features(state[box][:7])
    np.testing.assert_allclose(corner[2], floor[2, 3] + wall)
    np.testing.assert_allclose(kept.world_T_middle[:2, 3], floor[:2, 3])


def test_every_target_says_how_old_the_pictures_behind_it_are(world: OracleWorld) -> None:
    timings: list[Timing] = []
    world._witness = Told(on_timing=timings.append)
    look = world.observe().look
    assert look is not None
    look("side", WINDOW, 16)
    look("front", WINDOW, 16)
    world.act(world.stream.target, 0.02)
    world.act(world.stream.target, 0.02)
    assert [t.picture for t in timings] == [1.25, None]
    assert timings[0].asked <= timings[0].due < timings[1].due
    assert all(0 < t.computed < 1 for t in timings)


def stopping(*args: object) -> None:
    raise ProtectiveStopError("the robot made a protective stop")


def test_a_protective_stop_is_acknowledged_wherever_it_surfaces(
    world: OracleWorld, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[ProtectiveStopError] = []
    world._on_stop = asked.append
    monkeypatch.setattr(world.stream, "run", stopping)
    monkeypatch.setattr(world.stream, "stop", stopping)
    with pytest.raises(InterruptedMotionError):
        world.act(world.stream.target, 0.02)
    # The skill has ended, and nothing is interrupted.
    world.limit_effort(None)
    assert len(asked) == 2
    world._on_stop = None
    for move in (lambda: world.act(world.stream.target, 0.02), lambda: world.limit_effort(None)):
        with pytest.raises(ProtectiveStopError):
            move()


def test_pictures_behind_a_target_that_was_refused_are_not_counted_for_the_next(
    world: OracleWorld, monkeypatch: pytest.MonkeyPatch
) -> None:
    timings: list[Timing] = []
    world._witness = Told(on_timing=timings.append)
    look = world.observe().look
    assert look is not None
    look("side", WINDOW, 16)
    with monkeypatch.context() as m, pytest.raises(ProtectiveStopError):
        m.setattr(world.stream, "run", stopping)
        world.act(world.stream.target, 0.02)
    world.act(world.stream.target, 0.02)
    assert [t.picture for t in timings] == [None]
