"""Faults of every recoverable kind, one after the other: nothing leaks, no stop is missed, the recording is whole."""

from __future__ import annotations

import gc
import os
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from resync_robot.core.episode import read_episode
from resync_robot.core.episode_records import EpisodeMeta
from resync_robot.core.episode_writer import EpisodeWriter
from resync_robot.core.joints import JointTarget
from resync_robot.core.rig import Rig
from resync_robot.hardware.base import Command, ProtectiveStopError, RobotError, RobotState
from resync_robot.hardware.emulator.controller import SafetyMode
from resync_robot.hardware.emulator.faults import FAULTS
from resync_robot.hardware.emulator.server import Emulator
from resync_robot.hardware.joint_moves import travel
from resync_robot.hardware.robotiq import Robotiq
from resync_robot.hardware.stream import Stream
from resync_robot.hardware.ur7e import Ur7e
from tests import emulators

pytestmark = pytest.mark.realtime

STOPS = (
    "protective-stop", "program-stop", "safeguard-stop", "enabling-stop", "freeze", "mute", "link-drop",
    "gripper-fault", "gripper-silent", "gripper-gone",
)  # fmt: skip
"""What must end the motion."""
OTHERS = ("slider", "reduced", "late", "object")
"""What must not."""


@dataclass(frozen=True)
class Footprint:
    """What this process holds: memory in MB, open files, threads, children."""

    memory: float
    files: int
    threads: int
    children: int

    @staticmethod
    def now() -> Footprint:
        gc.collect()
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        children = sum(len(f.read_text().split()) for f in Path("/proc/self/task").glob("*/children"))
        files = len(os.listdir("/proc/self/fd"))  # noqa: PTH208
        return Footprint(pages * os.sysconf("SC_PAGE_SIZE") / 1e6, files, threading.active_count(), children)


class Soak:
    """A robot that swings its first joint, and what befalls it."""

    def __init__(self, machine: Emulator, rig: Rig, writer: EpisodeWriter) -> None:
        self.machine, self.rig, self.writer = machine, rig, writer
        self.robot = Ur7e(rig, Robotiq(machine.address))
        self.recorded = 0
        self.late = 0

    def record(self, state: RobotState, command: Command) -> None:
        self.recorded += 1
        self.writer.joints(state.time, state.q, state.qd, state.opening, command.sent, command.requested)

    def swing(self, stream: Stream, seconds: float, opening: float = 0.1, pause: float = 0.0) -> None:
        for k in range(round(seconds / 0.05)):
            q = self.rig.arm.home.copy()
            q[0] += 0.15 * np.sin(2 * k * 0.05)
            stream.run(JointTarget(q, opening), 0.05)
            if pause and k % 10 == 5:
                time.sleep(pause)
        self.late += stream.late

    def on(self, action: Callable[[], object]) -> None:
        self.machine.call(action)

    def stream(self) -> Stream:
        """From wherever the arm stands, home."""
        stream = Stream(self.robot, self.rig, recorders=[self.record])
        travel(stream, self.rig.arm.home)
        return stream

    def stop(self, fault: str) -> None:
        """The motion ends with an error, the arm is still, and somebody mends it and goes on."""
        stream = self.stream()
        timer = threading.Timer(0.7, lambda: self.on(lambda: FAULTS[fault](self.machine)))
        timer.start()
        with pytest.raises(RobotError) as caught:
            self.swing(stream, 6.0)
        timer.join()
        machine, controller = self.machine, self.machine.controller
        machine.frozen = machine.mute = False
        deadline = time.monotonic() + 3.0
        while np.abs(controller.velocity).max() > 1e-9:
            assert time.monotonic() < deadline, f"the arm still moves after {fault}"
            time.sleep(0.01)
        if fault == "protective-stop":
            assert isinstance(caught.value, ProtectiveStopError)
            self.robot.acknowledge_stop()
            return
        self.robot.close()
        assert machine.gripper is not None
        machine.gripper.fault, machine.gripper.silent = 0, False
        if controller.safety_mode is not SafetyMode.NORMAL:
            self.on(lambda: controller.set_safety(SafetyMode.NORMAL))
        self.robot.connect()

    def bear(self, fault: str) -> None:
        """The motion goes on, slower or with a pause."""
        stream, arm = self.stream(), self.machine.controller.arm
        if fault in FAULTS:
            self.on(lambda: FAULTS[fault](self.machine))
        if fault == "object":
            arm.object_width = 0.05  # type: ignore[attr-defined]
        self.swing(stream, 1.0, opening=0.0 if fault == "object" else 0.1, pause=0.2 if fault == "late" else 0.0)
        self.on(lambda: setattr(self.machine.controller, "slider", 1.0))
        self.on(lambda: self.machine.controller.set_safety(SafetyMode.NORMAL))
        arm.object_width = 0.0  # type: ignore[attr-defined]
        self.swing(stream, 0.3)


@pytest.mark.parametrize("seconds", [0.0, pytest.param(600.0, marks=pytest.mark.slow)], ids=["once each", "10 minutes"])
def test_faults_of_every_kind_leave_nothing_behind(tmp_path: Path, seconds: float) -> None:
    emulators.need_client()
    rng = np.random.default_rng(7)
    with emulators.emulated() as machine:
        machine.controller.wire = None
        rig = emulators.rig_at(machine.address)
        meta = EpisodeMeta.of(rig, library_hash="", domain="", scenario="", goal="", seed=0, backend="ur7e")
        path, befell = tmp_path / "soak.mcap", 0
        with EpisodeWriter(path, meta) as writer:
            soak = Soak(machine, rig, writer)
            with soak.robot:
                soak.stop("program-stop")
                before, begin = Footprint.now(), time.monotonic()
                while befell == 0 or time.monotonic() - begin < seconds:
                    for fault in rng.permutation([*STOPS, *OTHERS]):
                        (soak.stop if fault in STOPS else soak.bear)(str(fault))
                        befell += 1
                after = Footprint.now()
            assert writer.error is None
        done = Footprint.now()
    assert soak.late > 0, "the late targets were not late"
    assert (after.files, after.threads, after.children) == (before.files, before.threads, before.children)
    assert done.children == 0
    assert after.memory - before.memory < 20 + 5 * seconds / 600
    episode = read_episode(path)
    assert episode.damage is None
    assert len(list(episode.joints())) == soak.recorded > 20 * befell
