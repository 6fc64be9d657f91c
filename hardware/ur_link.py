"""The process that holds the ur-rtde client: it sends a setpoint every 2 ms, and watches the controller.

While an effort limit is set, what it sends yields to what the arm feels (`resync_robot.hardware.yielding`). Without one
it brakes by itself when the tip feels more than the rig's force limit: it sees every state, its driver one in a piece.

Why a process of its own: when the link drops, ur-rtde 1.6.5 can end its process by SIGSEGV. Why the script is uploaded
by hand: given the task, the client uploads it again with every reconnection, and the robot would run a program
that nobody steers. So this process leaves at the first sign of a lost link, and nothing resumes by itself.

It reads its settings as one line of JSON on standard input, and ends when that is closed: the driver has died.
"""

from __future__ import annotations

import json
import math
import os
import sys
import threading
import time
import traceback
from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np

from resync_robot.hardware.generator import Generator
from resync_robot.hardware.ur_memory import PLAYING, RING, SNAPSHOT, STOPS, Fault, LinkMemory
from resync_robot.hardware.ur_rig import rig_from_json, workspace_from_json
from resync_robot.hardware.yielding import Yielding

PERIOD = 0.002
KICK_S = 0.02
"""How often a resting arm's watchdog hears from us."""
VARIABLES = (
    "timestamp", "actual_q", "actual_qd", "actual_TCP_force", "robot_mode", "safety_mode", "runtime_state",
    "robot_status_bits", "safety_status_bits", "speed_scaling", "target_speed_fraction", "payload",
    "payload_cog",
)  # fmt: skip
LOOKAHEAD, GAIN = 0.1, 300.0
"""s and the proportional gain of servoj: the smoothest that the controller offers without lagging more."""
LINK_LOST, STILL_RUNNING = 3, 4
"""Exit codes. After any but 0 the driver ends the robot's program, if one was uploaded: 0 says that the controller has
said that it does not run."""
WHY_S = 0.05
"""How long the reason of a stop may come after it."""
END_S = 2.0
"""How long the client may take to end the program; it waits for ever for a controller that is gone."""


def say(**content: Any) -> None:
    """One line of JSON to the driver."""
    sys.stdout.write(json.dumps(content) + "\n")
    sys.stdout.flush()


def apart(one: Sequence[float], other: Sequence[float]) -> float:
    """The largest difference."""
    return max(abs(a - b) for a, b in zip(one, other, strict=True))


class Link:
    """The client's two interfaces, and the loop."""

    def __init__(self, settings: dict[str, Any], memory: LinkMemory) -> None:
        from rtde_control import RTDEControlInterface
        from rtde_receive import RTDEReceiveInterface

        self._memory, self._words = memory, memory.words
        self._freshness = float(settings["freshness"])
        self._now = np.zeros((), SNAPSHOT)
        self._driver_gone = threading.Event()
        self._braking: deque[np.ndarray] = deque()
        self._rig = rig_from_json(settings["rig"])
        self._orders: deque[dict[str, Any]] = deque()
        self._yielding: Yielding | None = None
        self._past: np.ndarray | None = None
        self.stopped = False
        """Whether the controller has said, since the program began, that it does not run; nothing begins it again."""
        controller = self._rig.controller
        self._most_force = np.inf if controller is None else controller.force_limit
        self._generator = Generator(self._rig.arm, 1.0)
        self.receive = RTDEReceiveInterface(settings["address"], 1 / PERIOD, list(VARIABLES))
        # Without FLAG_UPLOAD_SCRIPT, see above.
        self.control = RTDEControlInterface(settings["address"], 1 / PERIOD, int(RTDEControlInterface.FLAG_NO_WAIT))

    def begin(self, settings: dict[str, Any]) -> None:
        """Upload the program, and set and verify what has to be right before anything moves."""
        self._words["uploaded"] = 1
        if not self.control.reuploadScript():
            raise RuntimeError("the controller did not take the control program")
        limit = time.monotonic() + 3.0
        while self.receive.getRuntimeState() != PLAYING:
            if time.monotonic() > limit:
                raise RuntimeError("the controller does not run the control program")
            time.sleep(0.005)
        # The client's own view of the program lags the controller's by a few packets.
        while not self.control.isProgramRunning():
            if time.monotonic() > limit:
                raise RuntimeError("the client does not see the control program run")
            time.sleep(0.005)
        payload, centre, tcp = settings["payload"], settings["payload_centre"], settings["tcp"]
        if not self.control.setPayload(payload, centre) or not self.control.setTcp(tcp):
            raise RuntimeError("the controller did not take payload and TCP")
        got = self.control.getTCPOffset()
        if apart(got, tcp) > 1e-6:
            raise RuntimeError(f"the controller has the TCP {got} instead of {tcp}")
        wanted, limit = [payload, *centre], time.monotonic() + 1.0
        while apart(got := [self.receive.getPayload(), *self.receive.getPayloadCog()], wanted) > 1e-3:
            if time.monotonic() > limit:
                raise RuntimeError(
                    f"the controller has the payload {got} instead of {wanted} (kg, and its centre in m)"
                )
            time.sleep(0.005)
        if not self.control.setWatchdog(settings["watchdog"]):
            raise RuntimeError("the controller did not take the watchdog")

    def watch_driver(self) -> None:
        """Take its orders until the driver closes our standard input."""
        while line := sys.stdin.readline():
            self._orders.append(json.loads(line))
        self._driver_gone.set()

    def look(self) -> Fault:
        """Publish the robot's state; what speaks against another setpoint."""
        now, r = self._now, self.receive
        host = time.monotonic()
        stamp = r.getTimestamp()
        if stamp != now["time"] and math.isfinite(stamp):
            now["time"], now["heard"] = stamp, host
            now["q"], now["qd"], now["force"] = r.getActualQ(), r.getActualQd(), r.getActualTCPForce()
            now["robot_mode"], now["safety_mode"] = r.getRobotMode(), r.getSafetyMode()
            now["runtime"] = r.getRuntimeState()
            now["speed_fraction"] = r.getSpeedScaling()
            self.stopped |= bool(now["runtime"] != PLAYING)
            self._memory.publish(now)
        if not r.isConnected() or not self.control.isConnected():
            return Fault.LINK_LOST
        if host - float(now["heard"]) > self._freshness:
            return Fault.STALE
        if now["runtime"] != PLAYING:
            return Fault.STOPPED
        return Fault.NONE

    def run(self) -> Fault:
        """Send setpoints until something speaks against it, or the driver wants to end at rest."""
        w = self._words
        due, kick = time.monotonic(), 0.0
        while True:
            due = self._wait_for(due + PERIOD)
            fault = self.look()
            if fault is not Fault.NONE:
                return fault
            q = self._yielded(self._next_setpoint())
            if q is not None:
                kick, at = due + KICK_S, time.monotonic()
                if not self.control.servoJ(q.tolist(), 0.0, 0.0, PERIOD, LOOKAHEAD, GAIN):
                    return Fault.STOPPED if self.receive.isConnected() else Fault.LINK_LOST
                row = int(w["sent"]) % RING
                w["wire"][row], w["sent_at"][row] = q, at
                w["sent"] += 1
            elif self._driver_gone.is_set() or w["finish"]:
                return Fault.DRIVER_GONE
            elif due >= kick:
                kick = due + KICK_S
                self.control.kickWatchdog()

    def _yielded(self, path: np.ndarray | None) -> np.ndarray | None:
        """What is sent where the arm is asked to be at `path`, or to stay where it is; carries out orders then."""
        ending = False
        if path is None:
            ending = bool(self._orders) or self._driver_gone.is_set() or bool(self._words["finish"])
        arm = self._yielding
        if arm is None:
            if path is None and self._orders:
                self._begin(self._orders.popleft())
            return path
        if not ending:
            return arm.follow(arm.position if self._past is None else self._past[-1], self._now["q"], self._wrench())
        if not arm.at_rest:
            return arm.brake()
        # Wherever that is, the driver begins from there.
        self._yielding, self._past = None, np.tile(arm.position, (3, 1))
        self._take_over(arm.position, resting=True)
        return None

    def _begin(self, order: dict[str, Any]) -> None:
        if order["effort"] is not None:
            workspace = workspace_from_json(self._rig, order["workspace"])
            here = self._now["q"].copy() if self._past is None else self._past[-1]
            self._yielding = Yielding(self._rig, workspace, order["effort"], here, self._wrench())
        self._words["orders"] = order["number"]

    def _wrench(self) -> np.ndarray:
        """Of the world on the tip, N and N m, world axes; the controller gives it in those of the base."""
        return (self._now["force"].reshape(2, 3) @ self._rig.arm.world_T_base[:3, :3].T).ravel()

    def _wait_for(self, due: float) -> float:
        """Sleep until then; the time by which the next is counted. Held up, later ones are later, never closer."""
        pause = due - time.monotonic()
        if pause > 0:
            time.sleep(pause)
        elif pause < -PERIOD:
            return time.monotonic()
        return due

    def _next_setpoint(self) -> np.ndarray | None:
        """The next of the way to rest under way, else of the ring, else of the way to rest from the ring's end."""
        q = self._next_of_the_way() if self._braking else self._next_of_the_ring()
        if q is not None:
            self._past = np.tile(q, (3, 1)) if self._past is None else np.concatenate([self._past[1:], q[None]])
        elif self._past is not None:
            self._past[:] = self._past[-1]
        return q

    def _next_of_the_ring(self) -> np.ndarray | None:
        w = self._words
        read, write, epoch = int(w["read"]), int(w["write"]), int(w["link_epoch"])
        while read < write and w["tags"][read % RING] != epoch:
            read += 1
        felt = math.hypot(*self._now["force"][:3].tolist())
        w["read"] = min(read + 1, write)
        if read == write:
            way, felt = self._way_to_rest(read, epoch), 0.0
        # An arm that yields answers by itself.
        elif felt <= self._most_force or self._yielding is not None:
            return w["ring"][read % RING].copy()
        else:
            past = w["ring"][read % RING][None].repeat(3, 0) if self._past is None else self._past
            way = self._generator.halt(past)
        if way is None:
            return None
        self._braking.extend(way)
        self._take_over(way[-1], felt=felt)
        return self._next_of_the_way()

    def _next_of_the_way(self) -> np.ndarray:
        q: np.ndarray = self._braking.popleft()
        if not self._braking:
            self._words["resting"] = 1
        return q

    def _take_over(self, held: np.ndarray, resting: bool = False, felt: float = 0.0) -> None:
        """From here on the driver's setpoints are void, until it begins anew from where the arm comes to rest."""
        w = self._words
        w["held"], w["felt"], w["resting"] = held, felt, resting
        w["link_epoch"] += 1

    def _way_to_rest(self, read: int, epoch: int) -> np.ndarray | None:
        """Once only: while it is under way the link is an epoch ahead of every slot."""
        for i in range(STOPS):
            slot = self._words["stops"][i]
            if slot["epoch"] == epoch and slot["after"] == read and slot["count"]:
                return slot["q"][: int(slot["count"])].copy()
        return None

    def learn_why(self) -> None:
        """Wait for two states that came after the stop, or `WHY_S`: one read while it came may name no reason yet."""
        limit, seen = time.monotonic() + WHY_S, 0
        while seen < 2 and time.monotonic() < limit:
            before = float(self._now["time"])
            time.sleep(PERIOD)
            if self.look() is Fault.LINK_LOST:
                return
            seen += float(self._now["time"]) != before

    def watch_after(self) -> None:
        """Send nothing, publish what the robot says, until the driver lets go or the link is lost."""
        while not self._driver_gone.is_set():
            if self.look() is Fault.LINK_LOST:
                return
            time.sleep(PERIOD)

    def end_program(self) -> None:
        """Stop servoing and end the program, in order; returns when the controller says that it has ended."""
        timer = threading.Timer(END_S, leave, [STILL_RUNNING])
        timer.daemon = True
        timer.start()
        self.control.servoStop(10.0)
        self.control.stopScript()
        while not self.stopped:
            time.sleep(PERIOD)
            self.look()


def main() -> None:
    settings = json.loads(sys.stdin.readline())
    memory = LinkMemory(int(settings["memory"]))
    try:
        link = Link(settings, memory)
        link.begin(settings)
        link.look()
    # The client raises whatever its libraries do; the driver makes one sentence of it.
    except Exception as error:
        say(error=str(error).strip() or type(error).__name__)
        leave(STILL_RUNNING)
    try:
        threading.Thread(target=link.watch_driver, daemon=True).start()
        say(ready=True)
        # Nobody reads on: what the client's library prints from here on must not fill the pipe, and hold up the loop.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        leave(serve(link, memory))
    except Exception as error:
        memory.words["why"] = (" ".join(str(error).split()) or type(error).__name__).encode()
        traceback.print_exc()
        leave(STILL_RUNNING)


def serve(link: Link, memory: LinkMemory) -> int:
    """Send setpoints to the end; the exit code."""
    fault = link.run()
    if fault is Fault.STOPPED:
        link.learn_why()
    memory.words["fault"] = int(fault)
    if fault is Fault.LINK_LOST:
        memory.words["why"] = b"the connection to the controller broke off"
        return LINK_LOST
    if fault is Fault.DRIVER_GONE:
        link.end_program()
        return 0
    link.watch_after()
    return 0 if link.stopped else STILL_RUNNING


def leave(code: int) -> None:
    """Without the clients' own clean-up, which talks to the controller again and may crash on a lost link."""
    sys.stdout.flush()
    os._exit(code)
