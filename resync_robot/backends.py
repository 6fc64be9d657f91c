"""What stands behind the robot and camera protocols. `sim` swaps the devices and nothing above them."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass

from hardware.base import Camera, Robot
from hardware.sim import SimCamera, SimRobot
from resync_robot.core.errors import ConfigError
from resync_robot.core.rig import Rig
from resync_robot.core.state import State
from resync_robot.core.task import Task
from resync_robot.core.world import CameraFrame
from sim_training.mine import is_at_rest
from sim_training.sensor import NoisySensor
from sim_training.world import SimWorld


@dataclass(frozen=True)
class Devices:
    """An opened backend. `truth` is the simulator's own state, for scoring and for labelled use only."""

    robot: Robot
    cameras: dict[str, Camera]
    truth: Callable[[], State]
    world: SimWorld


class NoisyCamera:
    """A simulated camera with the faults of a D435i."""

    def __init__(self, camera: SimCamera, sensor: NoisySensor) -> None:
        self._camera, self._sensor = camera, sensor
        self.name = camera.name

    def connect(self) -> None:
        self._camera.connect()

    def close(self) -> None:
        self._camera.close()

    def capture(self) -> CameraFrame:
        return self._sensor.apply(self._camera.capture())

    def __enter__(self) -> NoisyCamera:
        self.connect()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def open_simulated(task: Task, rig: Rig) -> AbstractContextManager[Devices]:
    """A simulated robot in the task's world, with noisy cameras.

    Raises:
        ConfigError: the task's scene does not stand still.
        RenderError: no device can render.
    """
    return _Simulated(task, rig)


class _Simulated(AbstractContextManager[Devices]):
    def __init__(self, task: Task, rig: Rig) -> None:
        self._task, self._rig, self._stack = task, rig, ExitStack()

    def __enter__(self) -> Devices:
        world = SimWorld(self._task, self._rig, rendered=True)
        if not is_at_rest(world):
            raise ConfigError(f"the scene of seed {self._task.seed} does not stand still", "take another --seed")
        robot = self._stack.enter_context(SimRobot(world))
        cameras: dict[str, Camera] = {}
        for i, camera in enumerate(self._rig.cameras):
            sensor = NoisySensor(self._task.seed * 10 + i, camera)
            cameras[camera.name] = self._stack.enter_context(NoisyCamera(SimCamera(world, camera.name), sensor))
        return Devices(robot, cameras, world.perceive, world)

    def __exit__(self, *error: object) -> None:
        self._stack.close()
