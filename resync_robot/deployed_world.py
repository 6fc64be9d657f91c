"""The world as a deployed robot has it: cameras, estimates, and a jerk-limited stream of setpoints.

Simulated or real, this is the same code; the robot and the cameras behind it are what differs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress

import numpy as np

from hardware.base import Camera, ProtectiveStopError, RealtimeRobot, Robot, WindowedCamera
from hardware.stream import Stream
from hardware.travel import travel
from perception.belief import Belief
from perception.cutout import cut_out
from perception.naming import UnsettledSceneError
from perception.scan import Scan
from resync_robot.core import kinematics, spatial
from resync_robot.core.errors import InterruptedMotionError, PerceptionError, UnknownNameError
from resync_robot.core.joints import JointTarget
from resync_robot.core.rig import Rig
from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.core.vocabulary import BLOCK, BOX, ROBOT
from resync_robot.core.world import CameraFrame, Cutout, Observation, Window

WRIST = "wrist"
"""The camera that scans."""
SAFE_TIP = 0.27
"""m; below this the hand is first lifted straight up before it travels to a viewpoint."""

Scanned = Callable[[Sequence[CameraFrame], State], None]


class DeployedWorld:
    """`core.world.World` over a robot and its cameras.

    Args:
        live_state: where a skill that follows the objects gets their poses from while it runs. A camera-only
            deployment has none, and such a skill then raises PerceptionError. The simulated backend may hand in the
            simulator's state, and says so.
        on_scan: called with the pictures and the estimate of every scan.
        on_stop: called when the robot has made a protective stop; it asks a person, and returns when the robot may
            go on, or raises. Without it a protective stop ends the episode.
    """

    def __init__(
        self,
        robot: Robot,
        cameras: Mapping[str, Camera],
        rig: Rig,
        objects: Sequence[Object],
        live_state: Callable[[], State] | None = None,
        on_scan: Scanned | None = None,
        on_stop: Callable[[ProtectiveStopError], None] | None = None,
    ) -> None:
        self._on_stop = on_stop
        self.robot, self.rig, self._cameras = robot, rig, cameras
        self.stream = Stream(robot, rig)
        self.scan = Scan(rig)
        self._robot_object = next(o for o in objects if o.type == ROBOT)
        box = next(o for o in objects if o.type == BOX)
        self.belief = Belief(self._robot_object, box, [o for o in objects if o.type == BLOCK], rig)
        self._live_state, self._on_scan = live_state, on_scan
        self._held: Object | None = None
        self.scans = 0
        self.missing: tuple[str, ...] = ()
        self._base_T_world = spatial.inverse(rig.arm.world_T_base)
        self._tip_T_flange = spatial.inverse(rig.gripper.flange_T_tip)

    def observe(self, live: bool = False) -> Observation:
        measured = self.robot.state()
        features = self.rig.robot_features(measured.q, measured.opening)
        if live:
            if self._live_state is None:
                raise PerceptionError(
                    "this skill follows the objects while it moves, and no camera here tracks them",
                    "use --backend sim, or a library with a camera policy",
                )
            state = self._live_state()
        else:
            state = self.belief.state(features)
        return Observation(
            measured.time,
            measured.q,
            measured.qd,
            measured.opening,
            measured.tip_force,
            state,
            look=self._look,
            realtime=isinstance(self.robot, RealtimeRobot),
        )

    def _look(self, name: str, window: Window, size: int) -> Cutout:
        """What a camera sees now, for a skill that looks while it moves."""
        if name not in self._cameras:
            raise UnknownNameError("camera", name, list(self._cameras))
        camera = self._cameras[name]
        if isinstance(camera, WindowedCamera):
            return camera.cut_out(window, size)
        return cut_out(camera.capture(), self.rig.camera(name), window, size)

    def act(self, target: JointTarget, duration: float) -> None:
        try:
            self.stream.run(target, duration)
        except ProtectiveStopError as error:
            self._resume(error)

    def _resume(self, error: ProtectiveStopError) -> None:
        """Have the stop acknowledged, and begin again where the arm is measured. Raises, whatever happens."""
        if self._on_stop is None:
            raise error
        self._on_stop(error)
        self.stream.restart()
        raise InterruptedMotionError("the robot made a protective stop, which was acknowledged") from error

    def limit_effort(self, limit: tuple[float, ...] | None) -> None:
        self.robot.limit_effort(limit)
        if limit is None:
            # A capped arm may stand off its last command; begin again from where it is.
            self.stream.stop()

    def perceive(self) -> State:
        """Scan, unless the only news since the last look is that the hand closed on a block it had seen, alone."""
        features = self._features()
        if self.scans:
            believed = self.belief.state(features)
            before, self._held = self._held, self.belief.held
            if before is None and self._held is not None and self.belief.grasp_is_certain:
                return believed
        try:
            frames = self._look_around()
        except ProtectiveStopError as stop:
            with suppress(InterruptedMotionError):
                self._resume(stop)
            frames = self._look_around()
        self.scans += 1
        features = self._features()
        try:
            state = self.belief.update_from_scan(frames, features)
            self.missing = ()
        except UnsettledSceneError as error:
            if self.scans == 1:
                raise
            # What was seen before and is out of sight now keeps its old place; the plan may still go on.
            state, self.missing = self.belief.state(features), error.names
        self._held = self.belief.held
        if self._on_scan:
            self._on_scan(frames, state)
        return state

    def _look_around(self) -> list[CameraFrame]:
        self._lift()
        return self.scan(self._travel, self._cameras[WRIST].capture)

    def _features(self) -> np.ndarray:
        measured = self.robot.state()
        return self.rig.robot_features(measured.q, measured.opening)

    def _lift(self) -> None:
        """Straight up along a vertical line of the tip, out of the box, before the arm travels in joint space."""
        q, opening = self.stream.target.arm, self.stream.target.opening
        tip = self.rig.tip_pose(q)
        if tip[2, 3] >= SAFE_TIP:
            return
        branch = kinematics.branch_of(q)
        for z in np.arange(tip[2, 3], SAFE_TIP + 0.002, 0.002):
            lifted = tip.copy()
            lifted[2, 3] = z
            q = kinematics.inverse_along(self._base_T_world @ lifted @ self._tip_T_flange, q, branch)
            self.stream.run(JointTarget(q, opening), 0.02)

    def _travel(self, q: np.ndarray) -> None:
        travel(self.stream, q)


class OracleWorld(DeployedWorld):
    """The same robot and stream, with the simulator's state in place of estimates: what perception costs."""

    def perceive(self) -> State:
        if self._live_state is None:
            raise PerceptionError("there is no simulator to ask for poses", "use --perception camera")
        return self._live_state()

    def observe(self, live: bool = False) -> Observation:
        return super().observe(live=True)
