"""Writing an episode: one MCAP file, channels as listed in `core.episode`, every message one of ROS 2.

A thread of its own packs and writes, so that a slow disk never holds up a robot. Chunks are small and closed every
second of the episode, so that a killed process loses about a second.
"""

from __future__ import annotations

import json
import logging
import math
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, fields, replace
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from types import TracebackType
from typing import Any, Self

import numpy as np
from jaxtyping import Float, UInt8

from resync_robot.core import ros_messages
from resync_robot.core.episode import FORMAT
from resync_robot.core.episode_records import Answer, EpisodeMeta, EventKind, Timing, plain
from resync_robot.core.episode_schemas import SCHEMAS
from resync_robot.core.errors import DiskError, EpisodeError, ResyncError
from resync_robot.core.files import disk_fault, unwritable
from resync_robot.core.joints import JointTarget
from resync_robot.core.mcap_file import STRING, begin_file, offer
from resync_robot.core.robot_description import JOINTS, WORLD, RobotDescription, camera_frame
from resync_robot.core.ros_definitions import DEFINITIONS
from resync_robot.core.solids import scene_markers
from resync_robot.core.state import State
from resync_robot.core.world import CameraFrame

FLUSH_S = 1.0
MOST_WAITING = 20_000
"""Messages in memory at which the disk is given up as too slow; minutes of them."""
LATCHED = ("/meta", "/robot_description", "/tf_static")
BELIEF, TRUTH = (0.94, 0.59, 0.16, 0.8), (0.24, 0.71, 0.35, 1.0)
"""Colours of what is believed, orange and solid, and of what is true, green and outlined."""
LEVELS = {EventKind.STOP: 40, EventKind.GIVE_UP: 40, EventKind.MAY_MOVE: 40, EventKind.REPLAN: 30}
_log = logging.getLogger(__name__)


class EpisodeWriter:
    """Writes one episode. Recording must not stop a robot: every method returns at once, and after the first failed
    write the error is logged once, kept in `error`, and the rest is dropped. Whoever ends the episode looks at `error`,
    after `close`: the file then holds only what came before it.

    Args:
        path: a file that does not exist yet; its folder is made.
        meta: what the episode is about, and at which date it began.
        begin: s on the robot's clock at that date, from which the episode counts. A controller has been counting since
            it was switched on. Every method takes times on the robot's clock; what was before the beginning is told as
            then.

    Raises:
        EpisodeError: the file exists or cannot be created. Raised at once, before anything moves.
        DiskError: the same, where the disk is to blame.
    """

    def __init__(self, path: Path, meta: EpisodeMeta, begin: float = 0.0) -> None:
        self.path, self._begin = path, begin
        self.error: ResyncError | None = None
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._plan: tuple[list[str], int | None, str] | None = None
        self._latest, self._last_flush = 0.0, -math.inf
        self._closed = False
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("xb")
        except OSError as error:
            if not path.is_file():
                raise unwritable(
                    f"the recording {path}", error, "give another folder with --out", EpisodeError
                ) from None
            raise EpisodeError(
                f"{path} exists already; recordings are never overwritten", "give another name"
            ) from None
        self._writer = begin_file(self._file)
        self._began_ns, self._robot = meta.began_ns, RobotDescription(meta.rig) if meta.rig else None
        self._frames = {child for _, child, _ in self._robot.fixed} if self._robot else set()
        self._jobs: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._work, name="recording", daemon=True)
        self._thread.start()
        self._meta = {"format": FORMAT, **{f.name: getattr(meta, f.name) for f in fields(meta)}}
        self._describe(0.0)

    def joints(
        self,
        time: float,
        measured: Float[np.ndarray, "6"],
        velocity: Float[np.ndarray, "6"],
        opening: float,
        sent: JointTarget,
        requested: JointTarget,
    ) -> None:
        """One moment of the arm and the hand: rad, rad/s, m."""
        time = self._since(time)
        content = {
            "measured": measured,
            "velocity": velocity,
            "opening": opening,
            "sent": sent.arm,
            "sent_opening": sent.opening,
            "requested": requested.arm,
            "requested_opening": requested.opening,
        }
        self._json("/joints", time, content)
        # Each finger makes half of the opening; how fast, nobody measures.
        q = np.array([*measured, opening / 2, opening / 2])
        command = np.array([*sent.arm, sent.opening / 2, sent.opening / 2])
        qd = np.array([*velocity, math.nan, math.nan])
        self.defer(lambda: self._draw_joints(time, q, qd, command))

    def tip_force(self, time: float, force: Float[np.ndarray, "3"]) -> None:
        """Force of the world on the hand, N, world frame."""
        time = self._since(time)
        self._json("/tip_force", time, {"force": force})
        self._ros(
            "/wrench",
            "geometry_msgs/msg/WrenchStamped",
            time,
            partial(ros_messages.wrench, self._stamp(time), WORLD, force),
        )

    def state(self, time: float, state: State) -> None:
        """The belief about the objects."""
        time = self._since(time)
        self._json("/state", time, {"objects": state.to_json()})
        self.defer(lambda: self._draw_scene("/belief_markers", time, state, BELIEF, outlined=False))

    def truth(self, time: float, state: State) -> None:
        """What a simulator knows about the objects; for comparison only."""
        time = self._since(time)
        self._json("/truth", time, {"objects": state.to_json()})
        self.defer(lambda: self._draw_scene("/truth_markers", time, state, TRUTH, outlined=True))

    def atoms(self, time: float, atoms: Mapping[Any, float]) -> None:
        """Atoms, or their texts, with the probability that each holds."""
        time = self._since(time)
        content = {str(atom): float(p) for atom, p in atoms.items()}
        self._json("/atoms", time, {"atoms": content})
        lines = "\n".join(f"{p:.2f} {atom}" for atom, p in sorted(content.items()))
        self._ros("/atoms_text", "std_msgs/msg/String", time, partial(ros_messages.string, lines))

    def plan(self, time: float, steps: Sequence[Any], current: int | None, reason: str = "") -> None:
        """A new plan, or the step of it that is under way now."""
        time = self._since(time)
        texts = [str(s) for s in steps]
        self._json("/plan", time, {"steps": texts, "current": current, "reason": reason})
        self._plan = texts, current, reason
        self._plan_text(time, ">")

    def _plan_text(self, time: float, mark: str) -> None:
        """The plan for people, with `mark` at the step that was under way last."""
        if self._plan is None:
            return
        texts, current, reason = self._plan
        lines = "\n".join(f"{mark if i == current else ' '} {text}" for i, text in enumerate(texts))
        self._ros("/plan_text", "std_msgs/msg/String", time, partial(ros_messages.string, f"{reason}\n{lines}"))

    def event(self, time: float, kind: EventKind, text: str = "", **details: Any) -> None:
        """Something that happened; `details` must be plain JSON values or arrays."""
        time = self._since(time)
        self._json("/event", time, {"kind": kind.value, "text": text, "details": details}, flush=True)
        line = partial(ros_messages.log, self._stamp(time), LEVELS.get(kind, 20), kind.value, text)
        self._ros("/rosout", "rcl_interfaces/msg/Log", time, line)
        if kind is EventKind.SKILL_END:
            self._plan_text(time, "+" if details.get("ending") == "done" else "x")

    def answer(self, answer: Answer) -> None:
        """What the executive was told of the world, on the robot's clock as everything here."""
        content = {
            "ask": answer.ask.name,
            "clock": answer.clock,
            "target": answer.target.arm,
            "target_opening": answer.target.opening,
            "details": answer.details,
        }
        self._json("/answer", self._since(answer.clock), content)

    def timing(self, timing: Timing) -> None:
        """When a target was asked for, and when its first setpoint was due."""
        picture, due = timing.picture, self._since(timing.due)
        told = None if picture is None else self._since(picture)
        self._json("/timing", due, asdict(replace(timing, picture=told, asked=self._since(timing.asked), due=due)))
        if picture is not None:
            self._ros("/latency", "std_msgs/msg/Float64", due, partial(ros_messages.number, timing.due - picture))

    def picture(self, frame: CameraFrame, colour: bytes, depth: bytes) -> None:
        """A frame whose pictures the caller has encoded: `colour` as PNG or JPEG, `depth` as 16-bit PNG."""
        height, width = frame.depth.shape
        info = {
            "intrinsics": frame.intrinsics,
            "world_T_cam": frame.world_T_cam,
            "width": width,
            "height": height,
            "depth_unit_m": CameraFrame.DEPTH_UNIT_M,
        }
        root, where, time = f"/camera/{frame.name}", camera_frame(frame.name), self._since(frame.time)
        stamp = self._stamp(time)
        self._json(f"{root}/info", time, info)

        def draw() -> None:
            if where not in self._frames:
                # A camera that the rig does not name stands where it stood when it took its first picture.
                self._frames.add(where)
                self._place(time, [(WORLD, where, frame.world_T_cam)])
            millimetres = np.round(frame.depth * (1000 * CameraFrame.DEPTH_UNIT_M)).astype(np.uint16)
            for topic, kind, data in (
                (
                    f"{root}/camera_info",
                    "sensor_msgs/msg/CameraInfo",
                    ros_messages.camera_info(stamp, where, frame.intrinsics, width, height),
                ),
                (
                    f"{root}/colour",
                    "sensor_msgs/msg/CompressedImage",
                    ros_messages.compressed_image(stamp, where, _format(colour), colour),
                ),
                (
                    f"{root}/depth",
                    "sensor_msgs/msg/CompressedImage",
                    ros_messages.compressed_image(stamp, where, "png", depth),
                ),
                (f"{root}/depth_mm", "sensor_msgs/msg/Image", ros_messages.depth_image(stamp, where, millimetres)),
            ):
                self._write(topic, kind, time, data)

        self.defer(draw)

    def window(self, camera: str, time: float, png: bytes) -> None:
        """A part of a picture that a skill looked at, as PNG."""
        self._image("window", camera, time, png)

    def film(self, camera: str, time: float, jpeg: bytes) -> None:
        """What a camera saw while nobody asked, as JPEG."""
        self._image("film", camera, time, jpeg)

    def _image(self, kind: str, camera: str, time: float, data: bytes) -> None:
        time = self._since(time)
        pack = partial(ros_messages.compressed_image, self._stamp(time), camera_frame(camera), _format(data), data)
        self._ros(f"/camera/{camera}/{kind}", "sensor_msgs/msg/CompressedImage", time, pack)

    def points(self, time: float, xyz: Float[np.ndarray, "n 3"], rgb: UInt8[np.ndarray, "n 3"]) -> None:
        """A point cloud in the world frame, m; thin it before (10,000 points are 160 kB)."""
        time = self._since(time)
        pack = partial(ros_messages.point_cloud, self._stamp(time), WORLD, np.array(xyz), np.array(rgb))
        self._ros("/points", "sensor_msgs/msg/PointCloud2", time, pack)

    def defer(self, job: Callable[[], None]) -> None:
        """Run `job` on the recording's own thread, after all that was written before; it may write itself.

        For work that would hold up the robot. Whatever it raises ends the recording.
        """
        if threading.current_thread() is self._thread:
            job()
        elif self._closed:
            self._fail(ValueError("the recording is closed"))
        elif self._jobs.qsize() > MOST_WAITING:
            self._fail(OSError("the disk is too slow"))
        elif self.error is None:
            self._jobs.put(job)

    def flush(self) -> None:
        """Return when everything so far is in the file, for a reader that comes in between."""
        done = threading.Event()

        def flush() -> None:
            try:
                self._writer.flush()
            finally:
                done.set()

        self._jobs.put(flush)
        while not done.wait(0.1) and self._thread.is_alive():
            pass

    def close(self) -> None:
        """Finish the file; may be called twice."""
        if self._closed:
            return
        # Once more, so that a recording damaged at its start still says what it is about.
        self.defer(lambda: self._describe(self._latest))
        self._closed = True
        self._jobs.put(None)
        self._thread.join()
        try:
            if self.error is None:
                self._writer.finish()
            self._file.close()
        except OSError as error:
            self._fail(error)
        if self.error is not None and self._last_flush == -math.inf:
            # Nothing of it can be read.
            self.path.unlink(missing_ok=True)

    def _work(self) -> None:
        while (job := self._jobs.get()) is not None:
            # Whatever the encoder or the disk may raise, the arm in motion matters more.
            try:
                job()
            except Exception as error:
                self._fail(error)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _since(self, time: float) -> float:
        return max(0.0, time - self._begin)

    def _stamp(self, time: float) -> int:
        """ns since the epoch, of s of the episode. Whole numbers: a float of both together would round."""
        return self._began_ns + round(time * 1e9)

    def _json(self, topic: str, time: float, content: Mapping[str, Any], flush: bool = False) -> None:
        # A copy: what the caller gave may change before the thread comes to it.
        copy = plain(content)

        def write() -> None:
            text = ros_messages.string(json.dumps(copy, allow_nan=False))
            self._write(topic, STRING, time, text, flush)

        self.defer(write)

    def _ros(self, topic: str, kind: str, time: float, pack: Callable[[], bytes]) -> None:
        self.defer(lambda: self._write(topic, kind, time, pack()))

    def _describe(self, time: float) -> None:
        """What the episode is about, and the robot in it."""
        self._json("/meta", time, self._meta, flush=True)
        if self._robot is not None:
            fixed, urdf = self._robot.fixed, self._robot.urdf
            self._ros("/robot_description", STRING, time, partial(ros_messages.string, urdf))
            self.defer(lambda: self._place(time, fixed))

    def _place(self, time: float, poses: list[tuple[str, str, np.ndarray]]) -> None:
        """Frames that do not move."""
        self._write("/tf_static", "tf2_msgs/msg/TFMessage", time, ros_messages.transforms(self._stamp(time), poses))

    def _draw_joints(self, time: float, q: np.ndarray, qd: np.ndarray, command: np.ndarray) -> None:
        """For viewers: measured and commanded joints, and where the links are."""
        kind, stamp = "sensor_msgs/msg/JointState", self._stamp(time)
        self._write("/joint_states", kind, time, ros_messages.joint_state(stamp, JOINTS, q, qd))
        self._write("/joint_commands", kind, time, ros_messages.joint_state(stamp, JOINTS, command, np.empty(0)))
        if self._robot is not None:
            self._write("/tf", "tf2_msgs/msg/TFMessage", time, ros_messages.transforms(stamp, self._robot.moving(q)))

    def _draw_scene(
        self, topic: str, time: float, state: State, colour: tuple[float, float, float, float], outlined: bool
    ) -> None:
        shown = ros_messages.markers(self._stamp(time), WORLD, scene_markers(state, colour, outlined))
        self._write(topic, "visualization_msgs/msg/MarkerArray", time, shown)

    def _write(self, topic: str, kind: str, time: float, data: bytes, flush: bool = False) -> None:
        """On the recording's thread. `kind` is a message of ROS 2."""
        if self.error is not None:
            return
        if topic not in self._channels:
            self._channels[topic] = self._register(topic, kind)
        stamp = self._stamp(time)
        self._latest = max(self._latest, time)
        self._writer.add_message(self._channels[topic], log_time=stamp, data=data, publish_time=stamp)
        if flush or time >= self._last_flush + FLUSH_S:
            self._writer.flush()
            self._last_flush = time

    def _register(self, topic: str, kind: str) -> int:
        if kind not in self._schemas:
            self._schemas[kind] = self._writer.register_schema(kind, "ros2msg", DEFINITIONS[kind].encode())
        about, name = offer(topic in LATCHED), topic.rsplit("/", 1)[-1]
        if kind == STRING and name in SCHEMAS:
            about["json_schema"] = json.dumps(SCHEMAS[name])
        return self._writer.register_channel(topic, "cdr", self._schemas[kind], about)

    def _fail(self, error: Exception) -> None:
        if self.error is not None:
            return
        kind = DiskError if disk_fault(error) else EpisodeError
        why = (isinstance(error, OSError) and error.strerror) or error
        self.error = kind(f"the recording {self.path} stopped: {why}", "free disk space, or record elsewhere")
        _log.error("%s", self.error)


def _format(picture: bytes) -> str:
    return "png" if picture.startswith(b"\x89PNG") else "jpeg"
