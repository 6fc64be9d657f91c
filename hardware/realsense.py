"""D435i cameras by serial number, through pyrealsense2.

A thread for each camera keeps its newest picture. A whole picture is one that was exposed after it was asked for, its
depth filtered in disparity and aligned to its colour, with the intrinsics that the device itself reports. A part of a
picture, for a skill that looks while it moves, is cut at once from the newest.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from resync_robot.core.rig import CameraRig
from resync_robot.core.world import CameraFrame, Cutout, Glimpse, Window
from resync_robot.hardware.base import Connected, RobotError, SkewError, StaleError
from resync_robot.hardware.crop import crop
from resync_robot.hardware.pauses import blaming_a_pause
from resync_robot.hardware.realsense_device import FrameSource, PipelineSource, Stream, load_pyrealsense2

WARM_UP_FRAMES = 30
"""Until exposure and white balance have settled."""
STALL_S = 1.0
"""Without a usable picture for so long, a whole picture is given up."""
FRESH_S = 0.1
"""The oldest that a part of a picture may be: three frames. As long is waited for one that is younger."""
POLL_S = 0.1
MOST_SKEW_S = 0.020
"""Between depth and colour of one picture; more, and one of the two streams lost a frame."""


@dataclass(frozen=True, slots=True)
class _Pair:
    """Attributes: the `frames`, when they were `exposed` (s since the epoch) and when they `arrived` (s, monotonic)."""

    frames: Any
    exposed: float
    arrived: float


class RealSense(Connected):
    """One camera of the rig; a `WindowedCamera`. Its methods may be called from any thread.

    Args:
        camera: name, serial number, mounting and calibrated intrinsics.
        world_T_cam: where the camera is now, (4, 4), from the rig and the arm.
        source: of frames; default: the device with that serial number.
        clock: s on the robot's clock now, in which the pictures' times are told.
        warm_up: frames that are thrown away first.
        fresh: go by the time of exposure; a recording's lies in the past, and so its time of arrival counts.
    """

    def __init__(
        self,
        camera: CameraRig,
        world_T_cam: Callable[[], Float[np.ndarray, "4 4"]],
        source: FrameSource | None = None,
        clock: Callable[[], float] = time.time,
        warm_up: int = WARM_UP_FRAMES,
        fresh: bool = True,
    ) -> None:
        self.name = camera.name
        self._camera, self._world_T_cam, self._clock = camera, world_T_cam, clock
        self._source = source or PipelineSource(camera.serial, (camera.width, camera.height))
        self._warm_up, self._fresh = warm_up, fresh
        self._stream: Stream | None = None
        self._filters: list[Any] = []
        self._align: Any = None
        self._filtering = threading.Lock()
        self._thread: threading.Thread | None = None
        self._news = threading.Condition()
        self._newest: _Pair | None = None
        self._complaint: RobotError | None = None
        self._complained = 0.0
        self._gone: RobotError | None = None
        self._closing = False
        self.dropped = 0
        """Framesets that could not be used: torn or skewed."""

    def connect(self) -> None:
        """Start it, and let it warm up.

        Raises:
            RobotError: no such camera, it does not start, delivers other pictures than the rig says, or goes by
                another clock than this computer's.
            StaleError: no pictures come.
        """
        rs = load_pyrealsense2()
        stream = self._source.start()
        self._stream, self._newest, self._gone, self._closing = stream, None, None, False
        try:
            expected = (self._camera.width, self._camera.height)
            if stream.size != expected:
                raise RobotError(
                    f"camera '{self.name}' delivers {stream.size[0]} x {stream.size[1]} pixels, the rig says "
                    f"{expected[0]} x {expected[1]}",
                    "calibrate at the size that is used, and put it into the rig file",
                )
            threshold = rs.disparity_transform(True), rs.spatial_filter(), rs.disparity_transform(False)
            self._filters, self._align = list(threshold), rs.align(rs.stream.color)
            for _ in range(self._warm_up):
                frames = self._source.wait(STALL_S)
                if frames is None:
                    raise self._stale("no picture came", STALL_S)
            if (
                self._warm_up
                and self._fresh
                and frames.get_frame_timestamp_domain() == rs.timestamp_domain.hardware_clock
            ):
                raise RobotError(
                    f"camera '{self.name}' ({self._camera.serial}) tells times of a clock of its own",
                    "update its firmware and driver: global time must be supported",
                )
            self._thread = threading.Thread(target=self._watch, name=f"camera {self.name}", daemon=True)
            self._thread.start()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        self._closing = True
        if self._thread is not None:
            self._thread.join(STALL_S + POLL_S)
            self._thread = None
        if self._stream is not None:
            self._stream = None
            self._source.stop()

    def capture(self) -> CameraFrame:
        """A picture exposed after this call.

        Raises:
            StaleError: none comes, or only old ones come.
            SkewError: depth and colour do not fit in time.
        """
        stream, asked, now = self._require_stream(), time.time(), time.monotonic()
        pair = self._wait(lambda p: p.arrived > now and (not self._fresh or p.exposed >= asked), STALL_S)
        pose = np.array(self._world_T_cam())
        frames = pair.frames
        with self._filtering:
            for step in self._filters:
                frames = step.process(frames).as_frameset()
            frames = self._align.process(frames)
        metres = np.asanyarray(frames.get_depth_frame().get_data()).astype(np.float64) * stream.depth_unit
        depth = np.clip(metres / CameraFrame.DEPTH_UNIT_M + 0.5, 0, 65535).astype(np.uint16)
        return CameraFrame(self.name, _colour(frames).copy(), depth, stream.intrinsics, pose, self._told(pair))

    def cut_out(self, window: Window, size: int) -> Cutout:
        """What lies in the window of the newest picture, no older than FRESH_S, scaled to (size, size).

        Raises:
            StaleError, SkewError: there is none so young, and none comes within FRESH_S.
            PerceptionError: the window lies outside of the picture.
        """
        self._require_stream()
        pair = self._wait(lambda p: self._age(p) <= FRESH_S, FRESH_S)
        return Cutout(self.name, crop(_colour(pair.frames), window, size), self._told(pair))

    def glimpse(self) -> Glimpse:
        """The colours of the newest picture, however old; nothing is waited for. Raises StaleError before the first."""
        self._require_stream()
        pair = self._newest
        if pair is None:
            raise self._stale("no picture came", 0.0)
        return Glimpse(self.name, _colour(pair.frames).copy(), self._told(pair))

    def _age(self, pair: _Pair) -> float:
        return time.time() - pair.exposed if self._fresh else time.monotonic() - pair.arrived

    def _told(self, pair: _Pair) -> float:
        return self._clock() - self._age(pair)

    def _watch(self) -> None:
        """Keep the newest pair, until closed."""
        while not self._closing:
            try:
                frames = self._source.wait(POLL_S)
            except RobotError as error:
                with self._news:
                    self._gone = error
                    self._news.notify_all()
                return
            if frames is None:
                continue
            found = self._judge(frames)
            with self._news:
                if isinstance(found, _Pair):
                    self._newest = found
                else:
                    self.dropped += 1
                    self._complaint, self._complained = found, time.monotonic()
                self._news.notify_all()

    def _judge(self, frames: Any) -> _Pair | RobotError:
        depth, colour = frames.get_depth_frame(), frames.get_color_frame()
        if not depth or not colour:
            return self._stale("depth or colour is missing in every one", STALL_S)
        times = depth.get_timestamp() / 1000, colour.get_timestamp() / 1000
        if abs(times[0] - times[1]) > MOST_SKEW_S:
            return SkewError(
                f"camera '{self.name}' ({self._camera.serial}): depth and colour were exposed "
                f"{1000 * abs(times[0] - times[1]):.0f} ms apart; allowed: {1000 * MOST_SKEW_S:.0f} ms",
                "give each camera a USB controller of its own",
            )
        return _Pair(frames, min(times), time.monotonic())

    def _wait(self, usable: Callable[[_Pair], bool], limit: float) -> _Pair:
        """The newest pair once it is usable. Raises what speaks against it when `limit` s have passed."""
        begin = time.monotonic()
        with self._news:
            while True:
                if self._gone is not None:
                    raise self._gone
                newest = self._newest
                if newest is not None and usable(newest):
                    return newest
                left = begin + limit - time.monotonic()
                if left <= 0:
                    break
                self._news.wait(left)
            if self._complaint is not None and self._complained >= begin:
                raise self._complaint
            if newest is None:
                raise self._stale("no picture came", limit)
            raise self._stale(f"the newest was exposed {self._age(newest):.2f} s ago", limit)

    def _stale(self, why: str, limit: float) -> StaleError:
        return StaleError(
            *blaming_a_pause(
                f"camera '{self.name}' ({self._camera.serial}) gave nothing usable for {limit:.1f} s: {why}",
                "check its cable; give each camera a USB controller of its own",
            )
        )

    def _require_stream(self) -> Stream:
        if self._stream is None:
            raise RobotError(f"camera '{self.name}' is not connected", "use it as `with RealSense(...) as camera:`")
        return self._stream


def _colour(frames: Any) -> UInt8[np.ndarray, "h w 3"]:
    return np.asanyarray(frames.get_color_frame().get_data())
