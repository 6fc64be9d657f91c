"""What stands behind the robot and camera protocols. `sim` swaps the devices and nothing above them."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np

from resync_robot.core import spatial
from resync_robot.core.episode import Episode
from resync_robot.core.errors import ConfigError
from resync_robot.core.rig import CameraRig, Rig
from resync_robot.core.state import State
from resync_robot.core.task import Task
from resync_robot.core.world import CameraFrame, Cutout, Glimpse, Ready, Window, awaited
from resync_robot.hardware.answers import Answers
from resync_robot.hardware.base import Camera, FilmedCamera, Halt, Motions, Robot
from resync_robot.hardware.emulator.camera import EmulatedCamera
from resync_robot.hardware.emulator.lab import LabClient
from resync_robot.hardware.realsense import RealSense
from resync_robot.hardware.replay import ReplayArm, ReplayCamera, ReplayTruth, replay_ready
from resync_robot.hardware.robotiq import Robotiq
from resync_robot.hardware.sim import SimCamera, SimRobot
from resync_robot.hardware.ur7e import Ur7e, require_controller
from resync_robot.sim_training.mine import is_at_rest
from resync_robot.sim_training.motion import Motion, camera_motion
from resync_robot.sim_training.sensor import NoisySensor, Tone
from resync_robot.sim_training.world import SimWorld

_log = logging.getLogger(__name__)


FILM_HZ = 10.0
"""Of cameras that stream anyway."""
SIMULATED_FILM_HZ = 2.0
"""Of cameras each of whose pictures has to be rendered while the simulation waits: three of them take 0.16 s of a
processor, so that an episode becomes a fifth longer."""
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
class SimulatedDevices(Devices):
    """Those of a simulator, which always knows the truth."""

    truth: Callable[[], State]


@dataclass(frozen=True, kw_only=True)
class ReplayedDevices(Devices):
    """Those of a recording.

    Attributes:
        answers: what was told then, and how much of it has been told again.
    """

    answers: Answers


class NoisyCamera:
    """A simulated camera with the faults of a D435i.

    Args:
        motion: of the camera now; by default it always rests. Cut-outs stay sharp, as those are that the camera policy
            learns from.
    """

    def __init__(
        self, camera: SimCamera, sensor: NoisySensor, motion: Callable[[], Motion | None] = lambda: None
    ) -> None:
        self._camera, self._sensor, self._motion = camera, sensor, motion
        self.name = camera.name

    def connect(self) -> None:
        self._camera.connect()

    def close(self) -> None:
        self._camera.close()

    def capture(self) -> CameraFrame:
        return self._sensor.apply(self._camera.capture(), self._motion())

    def cut_out(self, window: Window, size: int) -> Cutout:
        # Here the camera stands off its believed place, there the belief is off: for what is seen it is the same.
        error = spatial.inverse(self._sensor.pose_error())
        seen = self._camera.cut_out(window, size, error)
        return replace(seen, colour=self._sensor.colour(seen.colour, seen.time))

    def glimpse(self) -> Glimpse:
        seen = self._camera.glimpse()
        return replace(seen, colour=self._sensor.glimpse(seen.colour, seen.time))

    def __enter__(self) -> NoisyCamera:
        self.connect()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


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


def open_simulated(task: Task, rig: Rig) -> AbstractContextManager[SimulatedDevices]:
    """A simulated robot in the task's world, with noisy cameras.

    Raises:
        ConfigError: the task's scene does not stand still.
        RenderError: no device can render.
    """
    return _Simulated(task, rig)


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
            film=_films(cameras),
            film_hz=EMULATED_FILM_HZ if controller.emulated else FILM_HZ,
        )

    def __exit__(self, *error: object) -> None:
        self._stack.close()


def _films(cameras: Mapping[str, Camera]) -> tuple[Callable[[], Glimpse], ...]:
    return tuple(camera.glimpse for camera in cameras.values() if isinstance(camera, FilmedCamera))


def _pose_now(rig: Rig, camera: CameraRig, robot: Robot) -> np.ndarray:
    return rig.camera_pose(camera, robot.state().q)


class _Simulated(AbstractContextManager[SimulatedDevices]):
    def __init__(self, task: Task, rig: Rig) -> None:
        self._task, self._rig, self._stack = task, rig, ExitStack()

    def __enter__(self) -> SimulatedDevices:
        world = SimWorld(self._task, self._rig, rendered=True)
        if not is_at_rest(world):
            raise ConfigError(f"the scene of seed {self._task.seed} does not stand still", "take another --seed")
        robot = self._stack.enter_context(SimRobot(world))
        cameras: dict[str, Camera] = {}
        for i, camera in enumerate(self._rig.cameras):
            tone = Tone.of(self._task.physics)
            sensor = NoisySensor(self._task.seed * 10 + i, camera, tone=tone, steady=True)
            device = NoisyCamera(SimCamera(world, camera.name), sensor, partial(self._motion, world, camera.name))
            cameras[camera.name] = self._stack.enter_context(device)
        return SimulatedDevices(
            robot=robot,
            cameras=cameras,
            clock=lambda: world.time,
            truth=world.perceive,
            live=world.perceive,
            film=_films(cameras),
            film_hz=SIMULATED_FILM_HZ,
        )

    def _motion(self, world: SimWorld, camera: str) -> Motion | None:
        q, qd, _, _ = world.measure()
        return camera_motion(self._rig, camera, q, qd)

    def __exit__(self, *error: object) -> None:
        self._stack.close()
