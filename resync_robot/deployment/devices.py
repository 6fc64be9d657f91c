"""What stands behind the robot and camera protocols with --backend sim: only the devices are others, all else stays.

`hardware.devices` has those of a machine and of a recording.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass
from functools import partial

from resync_robot.core.errors import ConfigError
from resync_robot.core.rig import Rig
from resync_robot.core.state import State
from resync_robot.core.task import Task
from resync_robot.hardware.base import Camera
from resync_robot.hardware.devices import Devices, films
from resync_robot.hardware.sim import SimCamera, SimRobot
from resync_robot.sim_training.physics.camera_noise import NoisySensor, Tone
from resync_robot.sim_training.physics.motion_blur import Motion, camera_motion
from resync_robot.sim_training.physics.noisy_camera import NoisyCamera
from resync_robot.sim_training.physics.world import SimWorld

SIMULATED_FILM_HZ = 2.0
"""Of cameras each of whose pictures has to be rendered while the simulation waits: three of them take 0.16 s of a
processor, so that an episode becomes a fifth longer."""


@dataclass(frozen=True, kw_only=True)
class SimulatedDevices(Devices):
    """Those of a simulator, which always knows the truth."""

    truth: Callable[[], State]


def open_simulated(task: Task, rig: Rig) -> AbstractContextManager[SimulatedDevices]:
    """A simulated robot in the task's world, with noisy cameras.

    Raises:
        ConfigError: the task's scene does not stand still.
        RenderError: no device can render.
    """
    return _Simulated(task, rig)


class _Simulated(AbstractContextManager[SimulatedDevices]):
    def __init__(self, task: Task, rig: Rig) -> None:
        self._task, self._rig, self._stack = task, rig, ExitStack()

    def __enter__(self) -> SimulatedDevices:
        world = SimWorld(self._task, self._rig, rendered=True)
        if not world.settles():
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
            film=films(cameras),
            film_hz=SIMULATED_FILM_HZ,
        )

    def _motion(self, world: SimWorld, camera: str) -> Motion | None:
        q, qd, _, _ = world.measure()
        return camera_motion(self._rig, camera, q, qd)

    def __exit__(self, *error: object) -> None:
        self._stack.close()
