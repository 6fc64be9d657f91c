"""Writing an episode: one MCAP file, channels as listed in `core.episode`.

JSON messages carry a JSON schema; pictures and points are plain bytes. Chunks are small and closed every second of
the episode, so that a killed process loses about a second.
"""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from jaxtyping import Float, UInt8
from mcap.writer import CompressionType, Writer

from resync_robot.core.episode import FORMAT, POINT, EpisodeMeta, EventKind, plain
from resync_robot.core.errors import EpisodeError
from resync_robot.core.joints import JointTarget
from resync_robot.core.state import State
from resync_robot.core.world import CameraFrame

CHUNK_BYTES = 128 * 1024
FLUSH_S = 1.0
_log = logging.getLogger(__name__)


class EpisodeWriter:
    """Writes one episode. Recording must not stop a robot: after the first failed write, the error is logged once,
    kept in `error`, and the rest is dropped.

    Args:
        path: a file that does not exist yet; its folder is made.
        meta: what the episode is about.

    Raises:
        EpisodeError: the file exists or cannot be created. Raised at once, before anything moves.
    """

    def __init__(self, path: Path, meta: EpisodeMeta) -> None:
        self.path = path
        self.error: EpisodeError | None = None
        self._channels: dict[str, int] = {}
        self._last_flush = -math.inf
        self._closed = False
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("xb")
        except OSError as error:
            if not path.is_file():
                raise EpisodeError(
                    f"cannot write the recording {path}: {error.strerror}", "give another folder"
                ) from None
            raise EpisodeError(
                f"{path} exists already; recordings are never overwritten", "give another name"
            ) from None
        self._writer = Writer(self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(profile="", library="resync-robot")
        content = {f.name: getattr(meta, f.name) for f in fields(meta)}
        self._json("/meta", 0.0, {"format": FORMAT, **content}, flush=True)

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

    def tip_force(self, time: float, force: Float[np.ndarray, "3"]) -> None:
        """Force of the world on the hand, N, world frame."""
        self._json("/tip_force", time, {"force": force})

    def state(self, time: float, state: State) -> None:
        """The belief about the objects."""
        self._json("/state", time, {"objects": state.to_json()})

    def truth(self, time: float, state: State) -> None:
        """What a simulator knows about the objects; for comparison only."""
        self._json("/truth", time, {"objects": state.to_json()})

    def atoms(self, time: float, atoms: Mapping[Any, float]) -> None:
        """Atoms, or their texts, with the probability that each holds."""
        self._json("/atoms", time, {"atoms": {str(atom): float(p) for atom, p in atoms.items()}})

    def plan(self, time: float, steps: Sequence[Any], current: int | None, reason: str = "") -> None:
        """A new plan, or the step of it that is under way now."""
        self._json("/plan", time, {"steps": [str(s) for s in steps], "current": current, "reason": reason})

    def event(self, time: float, kind: EventKind, text: str = "", **details: Any) -> None:
        """Something that happened; `details` must be plain JSON values or arrays."""
        self._json("/event", time, {"kind": kind.value, "text": text, "details": details}, flush=True)

    def picture(self, frame: CameraFrame, colour: bytes, depth: bytes) -> None:
        """A frame whose pictures the caller has encoded: `colour` as JPEG, `depth` as 16-bit PNG."""
        height, width = frame.depth.shape
        info = {
            "intrinsics": frame.intrinsics,
            "world_T_cam": frame.world_T_cam,
            "width": width,
            "height": height,
            "depth_unit_m": CameraFrame.DEPTH_UNIT_M,
        }
        self._json(f"/camera/{frame.name}/info", frame.time, info)
        self._bytes(f"/camera/{frame.name}/colour", "image/jpeg", frame.time, colour)
        self._bytes(f"/camera/{frame.name}/depth", "image/png", frame.time, depth)

    def points(self, time: float, xyz: Float[np.ndarray, "n 3"], rgb: UInt8[np.ndarray, "n 3"]) -> None:
        """A point cloud in the world frame, m; thin it before (10,000 points are 150 kB)."""
        cloud = np.empty(len(xyz), POINT)
        cloud["xyz"], cloud["rgb"] = xyz, rgb
        self._bytes("/points", "xyz32f-rgb8u", time, cloud.tobytes())

    def close(self) -> None:
        """Finish the file; may be called twice."""
        if self._closed:
            return
        self._closed = True
        try:
            if self.error is None:
                self._writer.finish()
            self._file.close()
        except OSError as error:
            self._fail(error)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _json(self, topic: str, time: float, content: Mapping[str, Any], flush: bool = False) -> None:
        if self.error is not None:
            return
        try:
            data = json.dumps(plain(content), allow_nan=False).encode()
        except (TypeError, ValueError) as error:
            return self._fail(error)
        self._bytes(topic, "json", time, data, flush)

    def _bytes(self, topic: str, encoding: str, time: float, data: bytes, flush: bool = False) -> None:
        if self.error is not None:
            return
        # Whatever the encoder or the disk may raise, the arm in motion matters more.
        try:
            if self._closed:
                raise ValueError("the recording is closed")
            if topic not in self._channels:
                self._channels[topic] = self._register(topic, encoding)
            stamp = round(time * 1e9)
            self._writer.add_message(self._channels[topic], log_time=stamp, data=data, publish_time=stamp)
            if flush or time >= self._last_flush + FLUSH_S:
                self._writer.flush()
                self._last_flush = time
        except Exception as error:
            self._fail(error)

    def _register(self, topic: str, encoding: str) -> int:
        schema = 0
        if encoding == "json":
            kind = topic.rsplit("/", 1)[-1]
            data = json.dumps(_SCHEMAS[kind]).encode()
            schema = self._writer.register_schema(f"resync_robot.{kind}", "jsonschema", data)
        return self._writer.register_channel(topic, encoding, schema)

    def _fail(self, error: Exception) -> None:
        if self.error is not None:
            return
        self.error = EpisodeError(f"the recording {self.path} stopped: {error}", "free disk space, or record elsewhere")
        _log.error("%s", self.error)


def _object(**properties: Any) -> dict[str, Any]:
    return {"type": "object", "properties": properties, "required": sorted(properties)}


def _array(items: Any, length: int | None = None) -> dict[str, Any]:
    bounds = {} if length is None else {"minItems": length, "maxItems": length}
    return {"type": "array", "items": items, **bounds}


_TEXT, _ANY, _NUMBER, _COUNT = {"type": "string"}, {"type": "object"}, {"type": ["number", "null"]}, {"type": "integer"}
_SIX, _OBJECTS = _array(_NUMBER, 6), _object(objects=_ANY)
_SCHEMAS = {
    "meta": _object(
        format=_COUNT, rig_hash=_TEXT, rig=_ANY, library_hash=_TEXT, domain=_TEXT, scenario=_TEXT, goal=_TEXT,
        seed=_COUNT, backend=_TEXT, versions=_ANY, frames=_ANY,
    ),
    "joints": _object(
        measured=_SIX, velocity=_SIX, opening=_NUMBER, sent=_SIX, sent_opening=_NUMBER, requested=_SIX,
        requested_opening=_NUMBER,
    ),
    "tip_force": _object(force=_array(_NUMBER, 3)),
    "state": _OBJECTS,
    "truth": _OBJECTS,
    "atoms": _object(atoms={"type": "object", "additionalProperties": _NUMBER}),
    "plan": _object(steps=_array(_TEXT), current={"type": ["integer", "null"]}, reason=_TEXT),
    "event": _object(kind=_TEXT, text=_TEXT, details=_ANY),
    "info": _object(
        intrinsics=_array(_array(_NUMBER, 3), 3), world_T_cam=_array(_array(_NUMBER, 4), 4), width=_COUNT,
        height=_COUNT, depth_unit_m=_NUMBER,
    ),
}  # fmt: skip
