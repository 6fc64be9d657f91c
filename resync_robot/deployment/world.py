"""The world as a deployed robot has it: cameras, estimates, and a jerk-limited stream of setpoints.

Simulated or real, this is the same code; the robot and the cameras behind it are what differs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from resync_robot.core import spatial
from resync_robot.core.episode_records import Answer, Ask, Timing
from resync_robot.core.errors import InterruptedMotionError, PerceptionError, UnknownNameError
from resync_robot.core.joints import JointTarget
from resync_robot.core.rig import Rig
from resync_robot.core.state import State
from resync_robot.core.symbols import Atom, Object
from resync_robot.core.vocabulary import BLOCK, BOX, DRAWER, LID, ROBOT
from resync_robot.core.world import ArmObservation, CameraFrame, Cutout, Ready, Window, awaited
from resync_robot.deployment.hand_trace import HandTrace
from resync_robot.deployment.next_look import Chooser, Look, apart
from resync_robot.deployment.uncertain_atoms import SampledAbstraction, objects_in
from resync_robot.hardware.base import Camera, Motions, ProtectiveStopError, Robot, RobotState, WindowedCamera
from resync_robot.hardware.clearance import Obstacle
from resync_robot.hardware.joint_moves import travel
from resync_robot.hardware.stream import Stream
from resync_robot.perception.belief import Belief
from resync_robot.perception.crop import cut_out
from resync_robot.perception.naming import UnsettledSceneError
from resync_robot.perception.objects import SceneEstimator, catalogue_of
from resync_robot.perception.scan import Scan, viewpoints_for
from resync_robot.perception.segment import Segmenter

WRIST = "wrist"
"""The camera that scans."""
SAFE_TIP = 0.27
"""m; below this the hand is first lifted straight up before it travels to a viewpoint."""
MORE_LOOKS = 2
"""How often places in doubt are looked at again."""
MOST_PLACES = 3
"""Of one such look."""
LOOKED_AT = (BLOCK, LID, DRAWER)
"""Types of the things that are looked at again where an atom in doubt speaks of them."""


class Witness(Protocol):
    """Is told of what a deployed robot sees and sends, such as a recording."""

    def on_answer(self, answer: Answer) -> None:
        """Whatever the executive is told of the world, in the order in which it asks."""
        ...

    def on_picture(self, frame: CameraFrame) -> None:
        """A picture that was asked for, of a scan."""
        ...

    def on_scan(self, frames: Sequence[CameraFrame], state: State) -> None:
        """The pictures of a scan, all of them told of before, and the estimate from them."""
        ...

    def on_look(self, part: Cutout) -> None:
        """A part of a picture that a skill looked at while it moved."""
        ...

    def on_seen(self, state: State) -> None:
        """What is believed while something is carried, which moves with the hand."""
        ...

    def on_timing(self, timing: Timing) -> None:
        """When a target was asked for and sent, and how old the pictures were that were looked at before it."""
        ...

    def on_doubt(self, atoms: Mapping[Atom, float], looks: int) -> None:
        """Atoms still in doubt after so many looks: the share of pose samples in which each holds."""
        ...

    def on_unsettled(self, names: Sequence[str], words: str) -> None:
        """Objects whose place the looks did not settle, and why: their old or rough estimates are gone by."""
        ...


class DeployedWorld:
    """`core.world.World` over a robot and its cameras.

    Args:
        live_state: where a skill that follows the objects gets their poses from while it runs. A camera-only
            deployment has none, and such a skill then raises PerceptionError. The simulated backend may hand in the
            simulator's state, and says so.
        witness: told of what is seen and sent.
        abstraction: says which atoms hang on poses that are not known well; their objects are looked at again.
        segmenter: finds the blocks in pictures; by colour unless given.
        stream: what feeds the robot; a `Stream` of its own unless given.
        ready: whether what a skill thinks beside the motion is finished; it is waited for unless given.
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
        witness: Witness | None = None,
        on_stop: Callable[[ProtectiveStopError], None] | None = None,
        abstraction: SampledAbstraction | None = None,
        segmenter: Segmenter | None = None,
        stream: Motions | None = None,
        ready: Ready = awaited,
    ) -> None:
        self._live_state, self._witness, self._on_stop, self._abstraction = live_state, witness, on_stop, abstraction
        self._ready, self._now = ready, 0.0
        self._looked: list[float] = []
        self.robot, self.rig, self._cameras = robot, rig, cameras
        self.stream: Motions = Stream(robot, rig) if stream is None else stream
        fittings = [o for o in objects if o.type in (LID, DRAWER)]
        self.scan = Scan(rig, viewpoints_for([o.type for o in objects]))
        catalogue = catalogue_of(rig, furnished=bool(fittings))
        self._choose = Chooser(self.scan, rig, catalogue)
        self._robot_object = next(o for o in objects if o.type == ROBOT)
        self._box = next(o for o in objects if o.type == BOX)
        blocks = [o for o in objects if o.type == BLOCK]
        estimator = SceneEstimator(rig, catalogue, segmenter)
        self.belief = Belief(self._robot_object, self._box, blocks, rig, estimator, fittings)
        self._held: Object | None = None
        self._trace = HandTrace()
        self._before: State | None = None
        self.scans = 0
        self.missing: tuple[str, ...] = ()
        self._base_T_world = spatial.inverse(rig.arm.world_T_base)
        self._tip_T_flange = spatial.inverse(rig.gripper.flange_T_tip)

    def observe(self, live: bool = False) -> ArmObservation:
        measured = self._measure()
        features = self.rig.robot_features(measured.q, measured.opening)
        if live:
            if self._live_state is None:
                raise PerceptionError(
                    "this skill follows the objects while it moves, and no camera here tracks them",
                    "use --backend sim, or a library with a camera policy",
                )
            state = self._live(self._live_state)
        else:
            state = self.belief.state(features)
            if self._witness and self.belief.in_hand:
                self._witness.on_seen(state)
        return ArmObservation(
            time=measured.time,
            state=state,
            arm=measured.q,
            arm_velocity=measured.qd,
            opening=measured.opening,
            commanded_opening=self.stream.target.opening,
            tip_force=measured.tip_force,
            look=self._look,
            ready=self._thought_out,
        )

    def _tell(self, ask: Ask, clock: float | None = None, **details: Any) -> None:
        """Tell the witness what the executive was told, of `clock` (s on the robot's clock) or of the latest moment."""
        clock = self._now if clock is None else clock
        self._now = max(self._now, clock)
        if self._witness:
            self._witness.on_answer(Answer(ask, clock, self.stream.target, details))

    def _measure(self) -> RobotState:
        s = self.robot.state()
        self._tell(Ask.MEASURE, s.time, arm=s.q, velocity=s.qd, force=s.tip_force, opening=s.opening)
        return s

    def _live(self, live_state: Callable[[], State]) -> State:
        state = live_state()
        if self._witness:
            self._tell(Ask.TRUTH, objects=state.to_json())
        return state

    def _thought_out(self, thought: Future[Any]) -> bool:
        done = self._ready(thought)
        self._tell(Ask.THOUGHT, done=done)
        return done

    def _capture(self) -> CameraFrame:
        """A picture of the camera that scans."""
        frame = self._cameras[WRIST].capture()
        self._tell(Ask.PICTURE, frame.time, camera=frame.name)
        if self._witness:
            self._witness.on_picture(frame)
        return frame

    def _look(self, name: str, window: Window, size: int) -> Cutout:
        """What a camera sees now, for a skill that looks while it moves."""
        if name not in self._cameras:
            raise UnknownNameError("camera", name, list(self._cameras), self.rig.where)
        camera = self._cameras[name]
        if isinstance(camera, WindowedCamera):
            seen = camera.cut_out(window, size)
        else:
            seen = cut_out(camera.capture(), self.rig.camera(name), window, size)
        self._looked.append(seen.time)
        self._tell(Ask.PART, seen.time, camera=name)
        if self._witness:
            self._witness.on_look(seen)
        return seen

    def act(self, target: JointTarget, duration: float) -> None:
        looked, self._looked = self._looked, []
        self._trace.follow(self.rig.tip_pose(target.arm)[:3, 3], self.belief.in_hand)
        try:
            self.stream.run(target, duration)
        except ProtectiveStopError as error:
            self._resume(error)
            raise InterruptedMotionError("the robot made a protective stop, which was acknowledged") from error
        if self._witness and self.stream.timing is not None:
            self._witness.on_timing(replace(self.stream.timing, picture=min(looked, default=None)))

    def _resume(self, error: ProtectiveStopError) -> None:
        """Have the stop acknowledged, and begin again where the arm is measured. Raises it where nobody can."""
        self._tell(Ask.STOP, reason=error.what)
        if self._on_stop is None:
            raise error
        self._on_stop(error)
        self.stream.restart()
        self._tell(Ask.REST)

    def limit_effort(self, limit: tuple[float, ...] | None) -> None:
        try:
            self._limit_effort(limit)
        except ProtectiveStopError as error:
            self._resume(error)
            if limit is not None:
                self._limit_effort(limit)

    def _limit_effort(self, limit: tuple[float, ...] | None) -> None:
        self.stream.limit_effort(limit)
        self._tell(Ask.REST)
        # It has taken a while, and what comes next is to be told of its own moment.
        self._measure()

    def perceive(self) -> State:
        """Scan, unless the only news since the last look is that the hand closed on a thing it had seen, alone."""
        features = self._features()
        if self.scans:
            believed = self.belief.state(features)
            before, self._held = self._held, self.belief.held
            if before is None and self._held is not None and self.belief.grasp_is_certain:
                return believed
        try:
            return self._look_around()
        except ProtectiveStopError as stop:
            self._resume(stop)
            return self._look_around()

    def _look_around(self) -> State:
        """A round of pictures, or a few of what the hand may have moved, then more of what is in doubt; all of them
        together make the estimate."""
        self._lift()
        looks, look = 1, self._next_look()
        frames = self.scan(self._travel, self._capture, look.views if look else None)
        state, error, changed = self._take_in(frames, False, look.changed if look else None)
        while looks <= MORE_LOOKS and (again := self._where_to_look(state, error)):
            frames += self.scan(self._travel, self._capture, again)
            looks += 1
            state, error, changed = self._take_in(frames, True, changed)
        self.scans += 1
        if error is not None and not known_names(state).issuperset(error.names):
            # Whoever plans would have to leave it out, or to make it up.
            raise error
        # What was seen before and is out of sight now keeps its old place; the plan may still go on.
        self.missing = error.names if error else ()
        self._held, self._before = self.belief.held, state
        self._trace.clear()
        self.stream.keep_out(walled(state, self._box))
        if self._witness:
            self._witness.on_scan(frames, state)
            if error is not None:
                self._witness.on_unsettled(error.names, error.what)
            if tipped := self.belief.report.tipped:
                self._witness.on_unsettled(tipped, f"not standing upright: {', '.join(tipped)}")
            if self._abstraction and (doubtful := self._abstraction.doubtful(state)):
                self._witness.on_doubt(doubtful, looks)
        return state

    def _next_look(self) -> Look | None:
        """A few pictures of what may be elsewhere than at the last scan; None where everything is to be looked at."""
        if self._before is None or self.missing:
            return None
        state, covered = self.belief.state(self._features()), self.belief.report.covered
        unseen = [o for o in state if o.name in covered]
        return self._choose(self._trace, self._before, state, unseen, self.belief.in_hand, self.stream.target.arm)

    def _take_in(
        self, frames: list[CameraFrame], again: bool, changed: Sequence[Object] | None
    ) -> tuple[State, UnsettledSceneError | None, Sequence[Object] | None]:
        """The estimate from `frames`, what they leave open, and what of the scene they are about. Where those of a part
        of it leave anything open, a whole round is added to them."""
        if changed is not None:
            try:
                return self.belief.update_from_scan(frames, self._features(), again, changed), None, changed
            except UnsettledSceneError:
                # These pictures have been taken in.
                again = True
            except PerceptionError:
                pass
            frames += self.scan(self._travel, self._capture)
        features = self._features()
        try:
            return self.belief.update_from_scan(frames, features, again), None, None
        except UnsettledSceneError as error:
            return self.belief.state(features), error, None

    def _where_to_look(self, state: State, error: UnsettledSceneError | None) -> list[np.ndarray]:
        """Configurations for another look: at what atoms in doubt speak of, what is seen badly, or what is missing."""
        doubtful = objects_in(self._abstraction.doubtful(state)) if self._abstraction else ()
        # First what a plan may hang on.
        no_help = {*self.belief.in_hand, *(o for o in doubtful if o.name in self.belief.report.covered)}
        places = [state.get(o, "x", "y") for o in doubtful if o.type in LOOKED_AT and o not in no_help]
        places += self.belief.unclear_places()
        configurations = [q for place in apart(places)[:MOST_PLACES] for q in self.scan.towards(place)]
        if error is not None and not known_names(state).issuperset(error.names):
            # What nobody has ever seen may be anywhere.
            configurations += self.scan.configurations
        return configurations

    def _features(self) -> np.ndarray:
        measured = self._measure()
        return self.rig.robot_features(measured.q, measured.opening)

    def _lift(self) -> None:
        """Straight up along a vertical line of the tip, out of the box, before the arm travels in joint space."""
        q, opening = self.stream.target.arm, self.stream.target.opening
        tip = self.rig.tip_pose(q)
        if tip[2, 3] >= SAFE_TIP:
            return
        kinematics = self.rig.arm.kinematics
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
        self._measure()
        return self._live(self._live_state)

    def observe(self, live: bool = False) -> ArmObservation:
        return super().observe(live=True)


def known_names(state: State) -> set[str]:
    """Of the things that something is believed of."""
    return {o.name for o in state.objects}


def walled(state: State, box: Object) -> Obstacle:
    """The volume of an open box, walls and all: the hand works in there, the rest of the arm stays out."""
    inner = state.get(box, "inner_x", "inner_y")
    height, thickness = state.get(box, "wall_z", "wall_thickness")
    half = np.array([*(np.asarray(inner) / 2 + thickness), height / 2])
    middle = spatial.transform(None, np.array([0.0, 0.0, half[2]]))
    return Obstacle(box.name, spatial.pose_from_features(state[box][:7]) @ middle, half)
