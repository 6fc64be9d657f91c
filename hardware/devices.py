"""What stands behind the robot and camera protocols: a recording, or a machine, real or emulated."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np

from resync_robot.core.episode import Episode
from resync_robot.core.rig import CameraRig, Rig
from resync_robot.core.state import State
from resync_robot.core.world import Glimpse, Ready, awaited
from resync_robot.hardware.answers import Answers
from resync_robot.hardware.base import Camera, FilmedCamera, Halt, Motions, Robot
from resync_robot.hardware.emulator.camera import EmulatedCamera
from resync_robot.hardware.emulator.lab_client import LabClient
from resync_robot.hardware.realsense import RealSense
from resync_robot.hardware.replay import ReplayArm, ReplayCamera, ReplayTruth, replay_ready
from resync_robot.hardware.robotiq import Robotiq
from resync_robot.hardware.ur7e import Ur7e, require_controller

FILM_HZ = 10.0
"""Of cameras that stream anyway."""


EMULATED_FILM_HZ = 1.0
"""The same where nothing waits, and whoever asks for a picture gets it after the one that is being rendered."""


@dataclass(frozen=True, kw_only=True)
class Devices:
    """An opened backend.

    Attributes:
        clock: s on the robot's clock now.
        truth: the simulator's own state, for scoring and for labelled use only; None at a real robot.
        live: the same, where a skill asks for it that follows the objects; None at a real robot.
        resume: what to do once a person has acknowledged a protective stop; None where there are none.
        halt: lets go of the robot, and says what is then known of it; None where nothing moves by itself.
        stream: what feeds the robot, where that is no `Stream` over it.
        ready: whether what a skill thinks beside the motion is finished.
        film: what each camera sees by the way.
        film_hz: how often that may be asked without holding up anything.
    """

    robot: Robot
    cameras: dict[str, Camera]
    clock: Callable[[], float]
    truth: Callable[[], State] | None
    live: Callable[[], State] | None = None
    resume: Callable[[], None] | None = None
    halt: Callable[[], Halt | None] | None = None
    stream: Motions | None = None
    ready: Ready = awaited
    film: tuple[Callable[[], Glimpse], ...] = ()
    film_hz: float = FILM_HZ


@dataclass(frozen=True, kw_only=True)
class ReplayedDevices(Devices):
    """Those of a recording.

    Attributes:
        answers: what was told then, and how much of it has been told again.
    """

    answers: Answers


def open_replay(episode: Episode) -> AbstractContextManager[ReplayedDevices]:
    """A recorded episode in place of a robot. Raises EpisodeError where it holds too little."""
    return _Replay(episode)


class _Replay(AbstractContextManager[ReplayedDevices]):
    def __init__(self, episode: Episode) -> None:
        self._episode, self._answers = episode, Answers(episode)
        self._arm = ReplayArm(episode, self._answers)
        self._truth = ReplayTruth(episode, self._answers, self._arm)

    def __enter__(self) -> ReplayedDevices:
        self._arm.connect()
        answers, truth = self._answers, self._truth
        names = sorted({*self._episode.cameras, "wrist"})
        return ReplayedDevices(
            robot=self._arm,
            cameras={name: ReplayCamera(self._episode, name, answers, self._arm) for name in names},
            clock=lambda: answers.clock,
            truth=truth.recorded if truth.known else None,
            live=truth.told,
            # Whoever acknowledged a stop did so then.
            resume=lambda: None,
            stream=self._arm,
            ready=replay_ready(answers),
            answers=answers,
        )

    def __exit__(self, *error: object) -> None:
        self._arm.close()


@dataclass(frozen=True)
class Layout:
    """Which scene an emulated lab is asked to lay out; a person does so at a real one."""

    domain: str
    scenario: str
    seed: int
    episode: int

    def lay_out(self, lab: LabClient) -> None:
        lab.lay_out(self.domain, self.scenario, self.seed, self.episode)


class Preparation(Protocol):
    """Has an emulated lab put something before its robot."""

    def lay_out(self, lab: LabClient) -> None: ...


def open_ur7e(
    layout: Preparation, rig: Rig, cameras: Sequence[CameraRig] | None = None
) -> AbstractContextManager[Devices]:
    """The UR7e of the rig, with its gripper and cameras (all, or those), real or emulated.

    Raises:
        RobotError: no machine answers, or it must not move: one sentence, and what to do.
    """
    return _Ur7eLab(layout, rig, rig.cameras if cameras is None else cameras)


class _Ur7eLab(AbstractContextManager[Devices]):
    def __init__(self, layout: Preparation, rig: Rig, cameras: Sequence[CameraRig]) -> None:
        self._layout, self._rig, self._cameras, self._stack = layout, rig, cameras, ExitStack()

    def __enter__(self) -> Devices:
        try:
            return self._open()
        except BaseException:
            self._stack.close()
            raise

    def _open(self) -> Devices:
        rig, controller = self._rig, require_controller(self._rig)
        cameras: dict[str, Camera] = {}
        truth: Callable[[], State] | None = None
        gripper = Robotiq(
            controller.address, controller.gripper_table, force=controller.gripper_force, model=rig.gripper.facts
        )
        robot = Ur7e(rig, gripper)
        if controller.emulated:
            lab = self._stack.enter_context(LabClient(controller.address))
            self._layout.lay_out(lab)
            truth = lab.truth
            self._stack.enter_context(robot)
            for camera in self._cameras:
                cameras[camera.name] = self._stack.enter_context(EmulatedCamera(lab, rig, camera, robot))
        else:
            self._stack.enter_context(robot)
            for camera in self._cameras:
                pose = partial(_pose_now, rig, camera, robot)
                cameras[camera.name] = self._stack.enter_context(RealSense(camera, pose, clock=robot.clock))
        return Devices(
            robot=robot,
            cameras=cameras,
            clock=robot.clock,
            truth=truth,
            live=truth,
            resume=robot.acknowledge_stop,
            halt=robot.halt,
            ready=Future.done,
            film=films(cameras),
            film_hz=EMULATED_FILM_HZ if controller.emulated else FILM_HZ,
        )

    def __exit__(self, *error: object) -> None:
        self._stack.close()


def films(cameras: Mapping[str, Camera]) -> tuple[Callable[[], Glimpse], ...]:
    return tuple(camera.glimpse for camera in cameras.values() if isinstance(camera, FilmedCamera))


def _pose_now(rig: Rig, camera: CameraRig, robot: Robot) -> np.ndarray:
    return rig.camera_pose(camera, robot.state().q)
