"""A simulated robot in front of a board, its cameras off their places: what `calibrate --backend sim` runs against."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace

import numpy as np

from calibration.board import BoardSpec
from hardware.base import Camera, Robot
from hardware.sim import SimCamera, SimRobot
from resync_robot.backends import NoisyCamera
from resync_robot.calibration_settings import LookConfig
from resync_robot.core import spatial
from resync_robot.core.rig import CameraRig, Rig, load_rig
from sim_training.calibration_scene import CalibrationWorld, Poster, displaced, empty_task
from sim_training.sensor import NoisySensor

SHEET_PX = 60
"""Pixels a square of the simulated print."""


@dataclass(frozen=True)
class Machine:
    """A robot in front of a board. `truth` is the simulator's camera pose, for scoring only."""

    robot: Robot
    camera: Camera
    truth: np.ndarray
    world: CalibrationWorld


def with_board(rig: Rig, spec: BoardSpec) -> Rig:
    """The rig with a longer hand, so that the safety gate keeps the held board off the table too."""
    return replace(rig, gripper=replace(rig.gripper, tip_offset=rig.gripper.tip_offset + spec.size[1]))


@contextmanager
def open_simulated(config: LookConfig, camera: CameraRig, board: np.ndarray, draw: int) -> Iterator[Machine]:
    """A simulated machine whose cameras, and whose board, are not quite where anybody thinks.

    Args:
        draw: seed of the board's place and of the noise; the cameras' places follow from --seed alone.
    """
    reality = displaced(load_rig(None), config.seed)
    rng = np.random.default_rng([draw, 3])
    off = spatial.transform(spatial.rotation_from_vector(rng.normal(0, 0.03, 3)), np.zeros(3))
    if camera.mount == "flange":
        # Flat on the table, however it was put there.
        off = spatial.transform(
            spatial.rotation_about("z", rng.normal(0, 0.3)), np.array([*rng.normal(0, 0.01, 2), -0.001])
        )
    spec = config.board
    poster = Poster(spec.image(SHEET_PX), spec.size, "flange" if camera.mount == "world" else "world", board @ off)
    world = CalibrationWorld(empty_task(reality, config.seed), reality, poster)
    with ExitStack() as stack:
        robot = stack.enter_context(SimRobot(world))
        sensor = NoisySensor(draw, camera)
        device = stack.enter_context(NoisyCamera(SimCamera(world, camera.name), sensor))
        yield Machine(robot, device, reality.camera(camera.name).pose, world)


def standing(world: CalibrationWorld) -> tuple[np.ndarray, float]:
    """(6,) rad and the opening in m at which the arm stands now."""
    q, _, opening, _ = world.measure()
    return q, opening
