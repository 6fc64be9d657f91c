"""Whom the hardware layer talks to, and that nothing it hears is run."""

from __future__ import annotations

import ast
import os
import socket
from pathlib import Path

import pytest

import resync_robot
from resync_robot.core.joints import JointTarget
from resync_robot.hardware.robotiq import Robotiq
from resync_robot.hardware.stream import Stream
from resync_robot.hardware.ur7e import Ur7e
from tests import emulators

LISTEN = "0A"
RUNS_WHAT_IT_READS = {
    "pickle", "_pickle", "dill", "cloudpickle", "joblib", "marshal", "shelve", "allow_pickle", "eval", "exec",
}  # fmt: skip


def sockets_of(process: int) -> list[tuple[str, str, str]]:
    """(local address, remote address, state) of each internet socket that a process holds, as the kernel has them."""
    links = [str(f.readlink()) for f in Path(f"/proc/{process}/fd").iterdir() if f.is_symlink()]
    held = {link[8:-1] for link in links if link.startswith("socket:[")}
    found = []
    for table in ("tcp", "tcp6", "udp", "udp6"):
        file = Path(f"/proc/{process}/net/{table}")
        for line in file.read_text().splitlines()[1:] if file.exists() else []:
            words = line.split()
            if words[9] in held:
                found.append((address_of(words[1]), address_of(words[2]), words[3]))
    return found


def address_of(word: str) -> str:
    """'0100007F:7532' is 127.0.0.1; anything but IPv4 stays as the kernel writes it."""
    digits = word.split(":")[0]
    return socket.inet_ntoa(bytes.fromhex(digits)[::-1]) if len(digits) == 8 else digits


@pytest.mark.realtime
def test_every_socket_belongs_to_the_configured_address(monkeypatch: pytest.MonkeyPatch) -> None:
    emulators.need_client()
    connected: list[str] = []
    connect = socket.create_connection

    def noticed(where: tuple[str, int], *args: float) -> socket.socket:
        connected.append(where[0])
        return connect(where, *args)

    monkeypatch.setattr(socket, "create_connection", noticed)
    before = sockets_of(os.getpid())
    with emulators.emulated() as machine:
        rig = emulators.rig_at(machine.address)
        with Ur7e(rig, Robotiq(machine.address)) as robot:
            Stream(robot, rig).run(JointTarget(rig.arm.home, 0.1), 0.1)
            assert robot._link is not None
            links = sockets_of(robot._link.process.pid)
            ours = [s for s in sockets_of(os.getpid()) if s not in before]
    # RTDE twice, and the script's port.
    assert len(links) >= 3
    assert {remote for _, remote, _ in links} == {machine.address}
    assert LISTEN not in {state for *_, state in links}
    # The dashboard and the gripper.
    assert len(connected) >= 2 and set(connected) == {machine.address}
    assert {local for local, _, state in ours if state == LISTEN} == {machine.address}
    assert all(machine.address in (local, remote) for local, remote, _ in ours)


def test_nothing_is_unpickled_or_evaluated() -> None:
    root = Path(resync_robot.__file__).resolve().parents[1]
    rooms = ("hardware", "resync_robot", "sim_training", "perception", "policies", "calibration")
    found = []
    for file in (f for room in rooms for f in (root / room).rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text())):
            names: list[str] = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                names = [node.module or ""]
            elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                names = [node.func.id]
            elif isinstance(node, ast.keyword):
                names = [node.arg or ""]
            # Training has workers of its own that hand each other pickles; nothing that has a wire may.
            never = RUNS_WHAT_IT_READS | ({"multiprocessing"} if file.is_relative_to(root / "hardware") else set())
            found += [f"{file}:{node.lineno}: {name}" for name in names if name.split(".")[0] in never]
    assert found == []
