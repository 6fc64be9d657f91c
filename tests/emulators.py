"""Emulated machines for tests: each on a loopback address of its own, so that they do not meet."""

from __future__ import annotations

import itertools
import os
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hardware.emulator.arm import KinematicArm
from hardware.emulator.controller import Controller, ControllerSettings
from hardware.emulator.gripper import EmulatedGripper
from hardware.emulator.server import Emulator
from resync_robot.core.rig import Rig, load_rig

RIG_FILE = Path(__file__).parents[1] / "hardware" / "emulated.toml"
_count = itertools.count(2)


def address() -> str:
    """A loopback address that no other test uses now."""
    return f"127.{1 + os.getpid() % 250}.{os.getpid() // 250 % 250}.{next(_count) % 250}"


def rig_at(where: str, **controller: object) -> Rig:
    """The emulated rig at that address; a busy machine gets more time than a lab would allow itself."""
    rig = load_rig(RIG_FILE)
    if rig.controller is None:
        raise LookupError("no [controller]")
    settings = {"freshness": 0.4, "lead": 0.06, "watchdog": 4.0} | controller
    return replace(rig, controller=replace(rig.controller, address=where, **settings))  # type: ignore[arg-type]


@contextmanager
def emulated(
    settings: ControllerSettings | None = None, gripper: EmulatedGripper | None = None, opening: float = 0.1
) -> Iterator[Emulator]:
    """A kinematic UR7e at the simulated rig's home, its gripper activated."""
    arm = KinematicArm(np.array(load_rig(RIG_FILE).arm.home), opening)
    controller = Controller(arm, settings)
    controller.wire = []
    with Emulator(controller, address(), gripper or EmulatedGripper(opening, activated=True)) as emulator:
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
