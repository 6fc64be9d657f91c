"""Emulated machines for tests: each on a loopback address of its own, so that they do not meet."""

from __future__ import annotations

import itertools
import os
import re
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from resync_robot.core import spatial
from resync_robot.core.kinematics import WORK_BRANCH
from resync_robot.core.machines import ARMS
from resync_robot.core.rig import Rig, load_rig
from resync_robot.hardware.emulator.arm import KinematicArm
from resync_robot.hardware.emulator.controller import Controller, ControllerSettings
from resync_robot.hardware.emulator.gripper import EmulatedGripper
from resync_robot.hardware.emulator.server import Emulator

RIG_FILE = Path(__file__).parents[1] / "hardware" / "emulated.toml"
_count = itertools.count(2)


def address() -> str:
    """A loopback address that no other test uses now."""
    return f"127.{1 + os.getpid() % 250}.{os.getpid() // 250 % 250}.{next(_count) % 250}"


def sister_text(model: str) -> str:
    """The emulated rig's file as a lab with another arm and a 2F-85 writes it."""
    text, rig, arm = RIG_FILE.read_text(), load_rig(RIG_FILE), ARMS[model]
    front, low, tip_offset = 0.5 * arm.reach, 0.2 * arm.reach, 0.174
    # Over the middle of its reach, the tool down as at home.
    tip = rig.tip_pose(rig.arm.home)
    tip[:3, 3] = (front, 0.0, low)
    flange = spatial.inverse(rig.arm.world_T_base) @ tip @ spatial.transform(None, np.array([0.0, 0.0, -tip_offset]))
    home = arm.kinematics.inverse_branch(flange, WORK_BRANCH).tolist()
    for name, value in {
        "model": f'"{model}"', "home": home, "velocity_limit": [*arm.speed], "tip_offset": tip_offset,
        "workspace_low": [-0.1, -arm.reach, 0.0], "workspace_high": [arm.reach, arm.reach, arm.reach],
        "gripper_table": [[3, 0.085], [230, 0.0]], "max_opening": 0.085,
    }.items():  # fmt: skip
        text, count = re.subn(rf"(?m)^{name} = .*$", f"{name} = {value}", text, count=1)
        assert count == 1, name
    return text.replace('model = "2f-140"', 'model = "2f-85"')


def sister(model: str) -> Rig:
    """The rig of that file."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "rig.toml"
        path.write_text(sister_text(model), encoding="utf-8")
        return load_rig(path)


def rig_at(where: str, rig: Rig | None = None, **controller: object) -> Rig:
    """The emulated rig, or that one, at that address; a busy machine gets more time than a lab would allow itself."""
    rig = rig or load_rig(RIG_FILE)
    if rig.controller is None:
        raise LookupError("no [controller]")
    settings = {"freshness": 0.4, "lead": 0.06, "watchdog": 4.0} | controller
    return replace(rig, controller=replace(rig.controller, address=where, **settings))  # type: ignore[arg-type]


@contextmanager
def emulated(
    settings: ControllerSettings | None = None,
    gripper: EmulatedGripper | None = None,
    opening: float = 0.1,
    rig: Rig | None = None,
) -> Iterator[Emulator]:
    """The kinematic arm of the emulated rig, or of that one, at its home, the gripper activated."""
    rig = rig or load_rig(RIG_FILE)
    arm = KinematicArm(rig.arm.home, opening)
    controller = Controller(arm, settings or ControllerSettings(model=rig.arm.facts))
    controller.wire = []
    with Emulator(controller, address(), gripper or EmulatedGripper(opening, True, rig.gripper.facts)) as emulator:
        yield emulator


def rig_file(folder: Path) -> Path:
    """The emulated rig's file, with an address of its own."""
    path = folder / "lab.toml"
    path.write_text(RIG_FILE.read_text().replace('"127.0.0.1"', f'"{address()}"'))
    return path


@contextmanager
def lab(folder: Path, *faults: str) -> Iterator[Path]:
    """`resync-robot emulate` in a process of its own; its rig file."""
    with lab_process(folder, *faults) as (rig, _):
        yield rig


@contextmanager
def lab_process(folder: Path, *faults: str) -> Iterator[tuple[Path, subprocess.Popen[str]]]:
    """The same, and the process."""
    need_client()
    rig = rig_file(folder)
    words = [sys.executable, "-m", "resync_robot", "emulate", "--rig", str(rig)]
    words += ["--fault", *faults] if faults else []
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None and "stands at" in process.stdout.readline()
            yield rig, process
        finally:
            process.terminate()


@contextmanager
def stranger(reply: bytes, then_close: bool = False) -> Iterator[int]:
    """A server that sends `reply` to everybody; its port."""
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def serve() -> None:
            try:
                peer, _ = listener.accept()
                with peer:
                    peer.sendall(reply)
                    while not then_close and peer.recv(1024):
                        peer.sendall(reply)
            except OSError:
                pass

        threading.Thread(target=serve, daemon=True).start()
        yield listener.getsockname()[1]


def need_client() -> None:
    """Skip where ur-rtde is not installed."""
    pytest.importorskip("rtde_control", reason="the extra 'hardware' is not installed")
