"""What `calibrate` runs against: a simulated robot whose cameras are off their places, or the UR7e of the rig file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from resync_robot.calibrating.settings import LookConfig
from resync_robot.calibration.board import BoardSpec
from resync_robot.console import say
from resync_robot.core import spatial
from resync_robot.core.errors import ConfigError
from resync_robot.core.files import check_folder
from resync_robot.core.rig import CameraRig, Rig
from resync_robot.core.runs import default_folder
from resync_robot.hardware.base import Camera, Robot
from resync_robot.hardware.devices import open_ur7e
from resync_robot.hardware.emulator.lab_client import LabClient
from resync_robot.hardware.sim import SimCamera, SimRobot
from resync_robot.hardware.ur7e import require_controller
from resync_robot.sim_training.physics.camera_noise import NoisySensor
from resync_robot.sim_training.physics.noisy_camera import NoisyCamera
from resync_robot.sim_training.scenes.calibration import Bench, CalibrationWorld, Poster, displaced

SHEET_PX = 60
"""Pixels a square of the simulated print."""


@dataclass(frozen=True)
class Machine:
    """A robot with the cameras that look, and what it reports wrong.

    Attributes:
        truth: (4, 4) where cameras really are, by name: for scoring only, and empty at a real robot.
        joint_noise: rad by which the simulated arm misreports each joint.
    """

    robot: Robot
    cameras: Mapping[str, Camera]
    truth: Mapping[str, np.ndarray] = field(default_factory=dict)
    joint_noise: float = 0.0


def picture_folder(config: LookConfig) -> Path:
    """Where pictures and overlays go. Raises ConfigError or DiskError where nothing can be written."""
    folder = config.out or default_folder(f"calibrate-{config.camera}")
    check_folder(folder)
    return folder


def poster_of(spec: BoardSpec, camera: CameraRig, board: np.ndarray, draw: int) -> Poster:
    """The board (4, 4), on the table or in the hand, not quite where anybody thinks."""
    rng = np.random.default_rng([draw, 3])
    off = spatial.transform(spatial.rotation_from_vector(rng.normal(0, 0.03, 3)), np.zeros(3))
    if camera.mount == "flange":
        # Flat on the table, however it was put there.
        off = spatial.transform(
            spatial.rotation_about("z", rng.normal(0, 0.3)), np.array([*rng.normal(0, 0.01, 2), -0.001])
        )
    mount: Literal["world", "flange"] = "flange" if camera.mount == "world" else "world"
    return Poster(spec.image(SHEET_PX), spec.size, mount, board @ off)


@contextmanager
def open_machine(
    backend: Literal["sim", "ur7e"],
    rig: Rig,
    design: Rig,
    bench: Bench,
    cameras: Sequence[CameraRig],
    draw: int,
    joint_noise: float = 0.0,
    task_for_a_person: str = "",
) -> Iterator[Machine]:
    """The robot with these cameras, and with `bench` before it where it is a simulated or an emulated one.

    Args:
        design: the rig that a simulated machine was built after, its cameras then knocked by `bench.seed`.
        draw: seed of the simulated noise.
        joint_noise: rad, of a simulated arm.
        task_for_a_person: what somebody must do before a real robot moves; it waits for that.

    Raises:
        RobotError: no machine answers, or it must not move.
        ConfigError: nobody is there to do what a person must.
    """
    with ExitStack() as stack:
        if backend == "sim":
            reality = displaced(design, bench.seed)
            world = CalibrationWorld(bench.task(reality), reality, bench.poster)
            robot = stack.enter_context(SimRobot(world))
            devices: dict[str, Camera] = {}
            for i, camera in enumerate(cameras):
                device = NoisyCamera(SimCamera(world, camera.name), NoisySensor(draw + i, camera))
                devices[camera.name] = stack.enter_context(device)
            yield Machine(robot, devices, {c.name: c.pose for c in reality.cameras}, joint_noise)
            return
        preparation = _BenchInLab(bench)
        if task_for_a_person and not require_controller(rig).emulated:
            _wait_for(task_for_a_person)
        opened = stack.enter_context(open_ur7e(preparation, rig, cameras))
        yield Machine(opened.robot, opened.cameras, preparation.truth)


@dataclass
class _BenchInLab:
    bench: Bench
    truth: dict[str, np.ndarray] = field(default_factory=dict)

    def lay_out(self, lab: LabClient) -> None:
        self.truth = lab.lay_out_bench(self.bench.to_json())


def _wait_for(words: str) -> None:
    say(words)
    try:
        input("Press Enter when that is done: ")
    except EOFError:
        raise ConfigError(f"nobody is there to do this: {words}", "run it in a terminal") from None
