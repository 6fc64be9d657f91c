"""What a skill may look at while it moves: parts of pictures, of whichever camera gives them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest

from hardware.sim import SimRobot
from resync_robot.core import spatial
from resync_robot.core.episode import Timing
from resync_robot.core.errors import PerceptionError, UnknownNameError
from resync_robot.core.rig import load_rig
from resync_robot.core.vocabulary import BOX
from resync_robot.core.world import CameraFrame, Cutout, Window
from resync_robot.deployed_world import OracleWorld, walled
from sim_training.world import SimWorld
from tests import scenes

RIG = load_rig()
WINDOW = Window(10.0, 20.0, 32.0, 32.0)


@dataclass
class Whole:
    """A camera that gives whole pictures only."""

    name: str = "front"
    size: tuple[int, int] = (424, 240)
    asked: list[str] = field(default_factory=list)

    def connect(self) -> None: ...

    def close(self) -> None: ...

    def capture(self) -> CameraFrame:
        width, height = self.size
        colour = np.full((height, width, 3), 90, dtype=np.uint8)
        return CameraFrame(self.name, colour, np.zeros((height, width), np.uint16), np.eye(3), np.eye(4), 1.25)


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
    assert not world.observe().realtime


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
    world._on_timing = timings.append
    look = world.observe().look
    assert look is not None
    look("side", WINDOW, 16)
    look("front", WINDOW, 16)
    world.act(world.stream.target, 0.02)
    world.act(world.stream.target, 0.02)
    assert [t.picture for t in timings] == [1.25, None]
    assert timings[0].asked <= timings[0].due < timings[1].due
    assert all(0 < t.computed < 1 for t in timings)
