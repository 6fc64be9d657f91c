"""The sockets and the clock of an emulated machine: one thread, one loop, 500 ticks a second."""

from __future__ import annotations

import ipaddress
import logging
import select
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeout
from types import TracebackType
from typing import Protocol, Self, TypeVar

from resync_robot.hardware.base import SERVO_PERIOD, RobotError
from resync_robot.hardware.emulator.controller import Controller
from resync_robot.hardware.emulator.dashboard import BANNER, DashboardClient
from resync_robot.hardware.emulator.gripper import EmulatedGripper, GripperClient
from resync_robot.hardware.emulator.rtde import ProtocolError, RtdeClient
from resync_robot.hardware.emulator.script import ScriptClient
from resync_robot.hardware.emulator.variables import Value

T = TypeVar("T")
_log = logging.getLogger(__name__)

RTDE_PORT, SCRIPT_PORT, DASHBOARD_PORT, GRIPPER_PORT = 30004, 30003, 29999, 63352
"""Fixed in the clients. Several emulators stand side by side on addresses 127.0.0.x."""
MOST_BEHIND_S = 0.05
"""How much time the loop makes up for after it was held up; what is more is lost from its clock."""
MOST_CLIENTS = 32
MOST_UNSENT = 1 << 20
"""Bytes that a client may leave unread before its connection ends."""


class Conversation(Protocol):
    def feed(self, data: bytes) -> bytes: ...


class Connection:
    """A client's socket, what is still to be sent to it, and the protocol's side of it."""

    def __init__(self, sock: socket.socket, talk: Conversation) -> None:
        self.sock, self.talk = sock, talk
        self.unsent = bytearray()


class Emulator:
    """A controller and its gripper behind their ports.

    Args:
        controller: the machine.
        address: IPv4 address to listen on.
        gripper: on its own port, where there is one.
        anywhere: allow an address other than loopback.

    Raises:
        RobotError: the address is not loopback, or a port is taken.
    """

    def __init__(
        self,
        controller: Controller,
        address: str = "127.0.0.1",
        gripper: EmulatedGripper | None = None,
        anywhere: bool = False,
    ) -> None:
        try:
            loopback = ipaddress.IPv4Address(address).is_loopback
        except ValueError:
            raise RobotError(f"'{address}' is no IPv4 address", "give one such as 127.0.0.1") from None
        if not loopback and not anywhere:
            raise RobotError(
                f"the emulator does not listen on {address}: it has no protection against strangers",
                "give a loopback address such as 127.0.0.1",
            )
        self.controller, self.gripper, self.address = controller, gripper, address
        self.frozen = False
        """The clock stands and nothing is answered; connections stay open."""
        self.mute = False
        """The clock runs and inputs are obeyed, but no data is sent."""
        self.behind_s = 0.0
        """How much time was lost so far because this machine was too busy."""
        self.malformed = 0
        """Connections that were ended because of what they sent."""
        self.every_tick: list[Callable[[Emulator], None]] = []
        """Called on the emulator's thread."""
        self._calls: deque[Callable[[], None]] = deque()
        self._reserved: dict[str, RtdeClient] = {}
        self._connections: list[Connection] = []
        self._listeners: dict[socket.socket, Callable[[], Conversation]] = {}
        self._thread: threading.Thread | None = None
        self._stop = False
        self._listen(RTDE_PORT, self._rtde_client)
        self._listen(SCRIPT_PORT, lambda: ScriptClient(controller))
        self._listen(DASHBOARD_PORT, lambda: DashboardClient(controller))
        if gripper is not None:
            self._listen(GRIPPER_PORT, lambda: GripperClient(gripper))

    def _listen(self, port: int, make: Callable[[], Conversation]) -> None:
        listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((self.address, port))
            listener.listen(8)
        except OSError as error:
            listener.close()
            self.close()
            raise RobotError(
                f"cannot listen on {self.address}:{port}: {error.strerror}",
                "end the other emulator, or take another address such as 127.0.0.2",
            ) from None
        listener.setblocking(False)
        self._listeners[listener] = make

    def start(self) -> None:
        """Run in a thread of its own."""
        self._thread = threading.Thread(target=self.run, name="emulator", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread and close every socket; may be called twice."""
        self._stop = True
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(5.0)
        for sock in [*self._listeners, *(c.sock for c in self._connections)]:
            sock.close()
        self._listeners, self._connections = {}, []

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def call(self, action: Callable[[], T], limit: float = 5.0) -> T:
        """What `action` returns, run on the emulator's own thread between two ticks.

        Raises:
            RobotError: it did not come to an end within `limit` s.
        """
        answer: Future[T] = Future()

        def run() -> None:
            try:
                answer.set_result(action())
            # Whatever it is belongs to the caller, not to the loop.
            except Exception as error:
                answer.set_exception(error)

        self._calls.append(run)
        try:
            return answer.result(limit)
        except FutureTimeout:
            raise RobotError(f"the emulator did not answer within {limit} s") from None

    def drop_link(self) -> None:
        """Cut every RTDE connection, as a pulled cable does; call it through `call`."""
        self._drop_all(RtdeClient)

    def drop_gripper(self) -> None:
        """Cut every connection to the gripper, as a URCap that ends does; call it through `call`."""
        self._drop_all(GripperClient)

    def _drop_all(self, kind: type[Conversation]) -> None:
        for connection in list(self._connections):
            if isinstance(connection.talk, kind):
                self._drop(connection)

    def run(self) -> None:
        """Serve until closed."""
        due = time.monotonic()
        while not self._stop:
            while self._calls:
                self._calls.popleft()()
            now = time.monotonic()
            if now < due:
                self._serve(due - now)
                continue
            if now - due > MOST_BEHIND_S:
                self.behind_s += now - due
                due = now
            due += SERVO_PERIOD
            if self.frozen:
                time.sleep(SERVO_PERIOD)
                continue
            # Whatever has arrived takes effect in this tick, even where the loop never gets to wait.
            self._serve(0.0)
            if self.gripper is not None:
                self.controller.opening = self.gripper.tick(self.controller.measured.opening)
            self.controller.tick()
            self._send_data()
            for hook in self.every_tick:
                hook(self)

    def _rtde_client(self) -> RtdeClient:
        return RtdeClient(self.controller.settings.version, self._reserve, self.controller.on_input)

    def _reserve(self, client: RtdeClient, names: tuple[str, ...]) -> bool:
        """An input belongs to the first client that asks for it, until it leaves."""
        if any(self._reserved.get(n, client) is not client for n in names):
            return False
        self._reserved |= dict.fromkeys(names, client)
        return True

    def _serve(self, timeout: float) -> None:
        writers = [c.sock for c in self._connections if c.unsent]
        readers = [*self._listeners, *(c.sock for c in self._connections)]
        readable, writable, _ = select.select(readers, writers, [], timeout)
        if self.frozen:
            return
        for listener in readable:
            if listener in self._listeners:
                self._accept(listener)
        by_socket = {c.sock: c for c in self._connections}
        for sock in readable:
            if sock in by_socket:
                self._read(by_socket[sock])
        for sock in writable:
            if sock in by_socket and by_socket[sock] in self._connections:
                self._flush(by_socket[sock])

    def _accept(self, listener: socket.socket) -> None:
        try:
            sock, _ = listener.accept()
        except OSError:
            return
        if len(self._connections) >= MOST_CLIENTS:
            sock.close()
            return
        sock.setblocking(False)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection = Connection(sock, self._listeners[listener]())
        self._connections.append(connection)
        if isinstance(connection.talk, DashboardClient):
            self._send(connection, BANNER)

    def _read(self, connection: Connection) -> None:
        try:
            data = connection.sock.recv(65536)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._drop(connection)
            return
        try:
            answer = connection.talk.feed(data)
        except ProtocolError as error:
            _log.warning("a client is cut off: %s", error)
            self.malformed += 1
            self._drop(connection)
            return
        if answer:
            self._send(connection, answer)
        if getattr(connection.talk, "ended", False):
            self._drop(connection)

    def _send_data(self) -> None:
        clients = [(c, c.talk) for c in self._connections if isinstance(c.talk, RtdeClient) and c.talk.started]
        if not clients or self.mute:
            return
        values: dict[str, Value] = self.controller.outputs()
        for connection, client in clients:
            data = client.data(self.controller.ticks, values)
            if data:
                self._send(connection, data)

    def _send(self, connection: Connection, data: bytes) -> None:
        connection.unsent += data
        if len(connection.unsent) > MOST_UNSENT:
            self._drop(connection)
        else:
            self._flush(connection)

    def _flush(self, connection: Connection) -> None:
        try:
            sent = connection.sock.send(connection.unsent)
            del connection.unsent[:sent]
        except BlockingIOError:
            pass
        except OSError:
            self._drop(connection)

    def _drop(self, connection: Connection) -> None:
        if connection in self._connections:
            self._connections.remove(connection)
        connection.sock.close()
        self._reserved = {n: c for n, c in self._reserved.items() if c is not connection.talk}
