"""A UR e-Series arm through the real ur-rtde, which has a process of its own, `resync_robot.hardware.ur_process`."""

from __future__ import annotations

import importlib.util
import logging
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float

from resync_robot.core.joints import JointTarget
from resync_robot.core.rig import ControllerRig, Rig
from resync_robot.hardware.base import (
    SERVO_PERIOD,
    Connected,
    Gripper,
    Halt,
    ProtectiveStopError,
    RobotError,
    RobotState,
    StaleError,
    StarvedError,
)
from resync_robot.hardware.dashboard import OTHER_SAFETY, Dashboard
from resync_robot.hardware.pauses import blaming_a_pause, pauses
from resync_robot.hardware.ur_memory import LONGEST_STOP, PLAYING, RING, STOPS, Fault, LinkMemory
from resync_robot.hardware.ur_process import LinkProcess
from resync_robot.hardware.ur_rig import rig_to_json, workspace_to_json
from resync_robot.hardware.workspace import Workspace

_log = logging.getLogger(__name__)

UNLOCK_AFTER_S = 5.5
"""The controller refuses to unlock a protective stop in its first 5 s."""
UNLOCK_TRIES_S = 3.0
"""Its clock may be slower than ours."""
LOOK = "look at the teach pendant, and start again"
INSTALL = "uv pip install -e '.[hardware]' -c constraints.txt"
SAFETY_NAMES = {
    2: "REDUCED", 3: "PROTECTIVE_STOP", 4: "RECOVERY", 5: "SAFEGUARD_STOP", 6: "SYSTEM_EMERGENCY_STOP",
    7: "ROBOT_EMERGENCY_STOP", 8: "VIOLATION", 9: "FAULT", 10: "AUTOMATIC_MODE_SAFEGUARD_STOP",
    11: "SYSTEM_THREE_POSITION_ENABLING_STOP",
}  # fmt: skip


class Ur7e(Connected):
    """A UR7e, or a sister of it, with the gripper it carries; a `RealtimeRobot`.

    Args:
        rig: with a [controller] section.
        gripper: the hand, connected and closed with the arm.

    Raises:
        RobotError: the rig says nothing of a controller.
    """

    def __init__(self, rig: Rig, gripper: Gripper) -> None:
        self._rig = rig
        self._controller = require_controller(rig)
        self.gripper = gripper
        self._world_R_base = rig.arm.world_T_base[:3, :3]
        self._link: LinkProcess | None = None
        self._stopped_at = 0.0
        self._opening = 0.0
        self._blocks = 0
        self._orders = 0
        self._workspace = Workspace(rig)
        self._last_heard = 0.0, time.monotonic()
        self._halt: Halt | None = None
        self._unreached = ""

    def connect(self) -> None:
        """Check the controller's state, start the link, verify payload and TCP. Nothing moves.

        Raises:
            ProtectiveStopError, RobotError: one sentence for what keeps the robot from being driven.
        """
        if self._link is not None:
            raise RobotError("the robot is connected already")
        for module in ("rtde_control", "rtde_receive"):
            if importlib.util.find_spec(module) is None:
                raise RobotError("the package ur-rtde is not installed", INSTALL)
        with Dashboard(self._controller.address) as dashboard:
            dashboard.require_ready()
            dashboard.require_arm(self._rig.arm.facts)
        self.gripper.connect()
        try:
            self._opening = self.gripper.state().opening
            self._stopped_at, self._blocks, self._orders, self._halt = 0.0, 0, 0, None
            pauses()
            self._link = LinkProcess(self._controller.address, self._settings(), self._stop_program)
        except BaseException:
            self.close()
            raise

    def halt(self) -> Halt | None:
        """Brake to rest, end the program, and let go of the arm; may be called twice.

        Returns:
            What is then known of the robot; None where no program was ever begun.
        """
        self.clock()
        link, self._link = self._link, None
        if link is not None:
            link.close()
            self._halt = link.halt
            if link.halt is Halt.UNKNOWN:
                why = f" ({self._unreached})" if self._unreached else ""
                _log.warning("%s%s", link.halt.value, why)
        return self._halt

    def close(self) -> None:
        """`halt`, and let go of the gripper; may be called twice."""
        try:
            self.halt()
        finally:
            self.gripper.close()

    def clock(self) -> float:
        """s on the controller's clock when it was last heard; goes on counting while it is silent."""
        if self._link is not None:
            now = self._link.memory.snapshot()
            self._last_heard = float(now["time"]), float(now["heard"])
        time_, heard = self._last_heard
        return time_ + max(0.0, time.monotonic() - heard)

    def state(self) -> RobotState:
        """The latest measurement. Raises StaleError when the controller has been silent for too long."""
        now = self._require_fresh()
        force = self._world_R_base @ now["force"][:3]
        opening = self.gripper.state().opening
        return RobotState(float(now["time"]), now["q"].copy(), now["qd"].copy(), force, opening)

    def speed_fraction(self) -> float:
        """See `RealtimeRobot`."""
        fraction = float(self._require_link().snapshot()["speed_fraction"])
        # What is not a number is no speed either.
        if not fraction >= 0.01:
            raise RobotError(f"the speed slider stands at {fraction:.2g}", "raise it on the teach pendant")
        return min(fraction, 1.0)

    def sent_at(self) -> Float[np.ndarray, " n"]:
        """When each of the last setpoints went out, s of the host's monotonic clock; 65 s of them at most."""
        w = self._require_link().words
        sent = int(w["sent"])
        return w["sent_at"][np.arange(max(0, sent - RING), sent) % RING]

    def last_sent(self) -> JointTarget:
        """See `RealtimeRobot`."""
        memory = self._require_link()
        sent = int(memory.words["sent"])
        q = memory.words["wire"][(sent - 1) % RING] if sent else memory.snapshot()["q"]
        return JointTarget(q.copy(), self._opening)

    def due(self) -> float:
        """See `RealtimeRobot`."""
        w = self._require_link().words
        return self.clock() + (int(w["write"]) - int(w["read"])) * SERVO_PERIOD

    def servo(self, q: Float[np.ndarray, "6"], opening: float) -> None:
        """One setpoint, from which the arm need not stop: for an arm at rest."""
        self.play(np.asarray(q, dtype=np.float64)[None], np.array([opening]), np.empty((0, 6)))

    def play(
        self,
        setpoints: Float[np.ndarray, "n 6"],
        openings: Float[np.ndarray, " n"],
        stop: Float[np.ndarray, "m 6"],
        after_each: Callable[[], None] | None = None,
    ) -> None:
        """See `RealtimeRobot`."""
        memory = self._require_link()
        self._require_running()
        w = memory.words
        epoch, write = int(w["epoch"]), int(w["write"])
        if int(w["link_epoch"]) != epoch:
            self._starved()
        if len(stop) > LONGEST_STOP or write - int(w["read"]) + len(setpoints) > RING:
            raise RobotError(f"a block of {len(setpoints)} setpoints and {len(stop)} to rest is too long")
        rows = np.arange(write, write + len(setpoints)) % RING
        w["ring"][rows], w["tags"][rows] = setpoints, epoch
        slot = w["stops"][self._blocks % STOPS]
        self._blocks += 1
        slot["count"] = 0
        slot["epoch"], slot["after"], slot["q"][: len(stop)] = epoch, write + len(setpoints), stop
        slot["count"] = len(stop)
        # Last: from here on the link may take it.
        w["write"] = write + len(setpoints)
        lead = max(1, round(self._controller.lead / SERVO_PERIOD))
        for i, opening in enumerate(openings.tolist()):
            self._move_gripper(opening)
            while int(w["read"]) < write + i + 1 - lead:
                self._require_running()
                if int(w["link_epoch"]) != epoch:
                    self._starved()
                time.sleep(SERVO_PERIOD / 2)
            if after_each is not None:
                after_each()
        if int(w["link_epoch"]) != epoch:
            self._starved()

    def limit_effort(self, limit: tuple[float, ...] | None) -> None:
        """Have the link's setpoints yield to what the arm feels: the controller has no such cap under servoing."""
        w = self._require_link().words
        if self._link is None:
            return
        self._orders += 1
        effort = None if limit is None else list(limit)
        self._link.order(number=self._orders, effort=effort, workspace=workspace_to_json(self._workspace))
        # It is taken when the last setpoint is out; what yielded comes to rest first.
        while int(w["orders"]) < self._orders:
            self._require_running()
            time.sleep(SERVO_PERIOD)

    def stay_in(self, workspace: Workspace) -> None:
        """See `RealtimeRobot`."""
        self._workspace = workspace

    def acknowledge_stop(self) -> None:
        """After a person has looked: unlock a protective stop once it is old enough, and connect anew.

        Raises:
            ProtectiveStopError: the controller keeps it locked.
            RobotError: the robot is in another state that forbids motion.
        """
        wait = self._stopped_at + UNLOCK_AFTER_S - time.monotonic()
        if wait > 0:
            time.sleep(wait)
        self.close()
        with Dashboard(self._controller.address) as dashboard:
            deadline, released = time.monotonic() + UNLOCK_TRIES_S, False
            while dashboard.safety() == "PROTECTIVE_STOP":
                late = time.monotonic() > deadline
                if released and late:
                    raise ProtectiveStopError(
                        "the controller says that it releases the protective stop, and stays locked",
                        "release it on the teach pendant, and start again",
                    )
                try:
                    if not released:
                        dashboard.unlock_protective_stop()
                        released = True
                except ProtectiveStopError:
                    if late:
                        raise
                time.sleep(0.1)
        self.connect()

    def _move_gripper(self, opening: float) -> None:
        if opening != self._opening:
            self._opening = opening
            self.gripper.move(opening)

    def _settings(self) -> dict[str, Any]:
        c = self._controller
        return {
            "freshness": c.freshness, "watchdog": c.watchdog, "payload": c.payload,
            "payload_centre": c.payload_centre.tolist(), "tcp": [0.0, 0.0, self._rig.gripper.tip_offset, 0.0, 0.0, 0.0],
            "rig": rig_to_json(self._rig),
        }  # fmt: skip

    def _require_link(self) -> LinkMemory:
        if self._link is None:
            raise RobotError("the robot is not connected", "use it as `with Ur7e(rig, gripper) as robot:`")
        return self._link.memory

    def _require_fresh(self) -> np.ndarray:
        """The latest snapshot. Raises StaleError where it is old, whoever is to blame: controller or link."""
        now = self._require_link().snapshot()
        self._require_process()
        silent = time.monotonic() - float(now["heard"])
        if silent > self._controller.freshness:
            raise _stale(
                f"the controller has said nothing for {1000 * silent:.0f} ms; allowed: "
                f"{1000 * self._controller.freshness:.0f} ms"
            )
        return now

    def _require_process(self, wait: float = 0.0) -> None:
        end = "" if self._link is None else self._link.ended(wait)
        if end:
            raise _stale(f"the link to the robot was lost (its process ended with {end})")

    def _require_running(self) -> None:
        """Raise whatever keeps the link from sending setpoints."""
        memory = self._require_link()
        fault = Fault(int(memory.words["fault"]))
        if fault is Fault.NONE:
            # A link that hangs sends nothing and reports no fault either.
            self._require_fresh()
            return
        self._require_process()
        if fault is Fault.LINK_LOST:
            # It leaves at once; its exit says the rest.
            self._require_process(1.0)
        self.state()
        safety = SAFETY_NAMES.get(int(memory.snapshot()["safety_mode"]), "")
        if safety == "PROTECTIVE_STOP":
            self._stopped_at = self._stopped_at or time.monotonic()
            raise ProtectiveStopError(
                "the robot made a protective stop", "look why, and clear the way; then acknowledge it"
            )
        if safety and safety != "REDUCED":
            raise RobotError(f"the robot stopped: {safety}", OTHER_SAFETY.get(safety, "look at the teach pendant"))
        if fault is Fault.STALE:
            raise _stale("the controller fell silent for a moment, and was sent no more setpoints")
        if int(memory.snapshot()["runtime"]) == PLAYING:
            raise RobotError("the robot's control program took no more setpoints", LOOK)
        raise RobotError(*blaming_a_pause("the robot's control program was stopped", LOOK))

    def _starved(self) -> None:
        """Wait until the arm rests where the link braked it to, take over from there, and say so."""
        w = self._require_link().words
        while not w["resting"]:
            self._require_running()
            time.sleep(SERVO_PERIOD)
        w["epoch"] = int(w["link_epoch"])
        felt = float(w["felt"])
        raise StarvedError(w["held"].copy(), None if felt == 0.0 else felt)

    def _stop_program(self) -> Halt:
        """The link is gone; whatever it uploaded must not go on."""
        try:
            with Dashboard(self._controller.address, timeout=1.0) as dashboard:
                stopped = dashboard.stop_program()
            self._unreached = "" if stopped else "its program still runs"
        except RobotError as error:
            stopped, self._unreached = False, error.what
        self._halt = Halt.STOPPED if stopped else Halt.UNKNOWN
        return self._halt


def _stale(what: str) -> StaleError:
    return StaleError(*blaming_a_pause(what, "check the cable and the controller, look at the robot, and start again"))


def require_controller(rig: Rig) -> ControllerRig:
    """The rig's controller. Raises RobotError where it has none."""
    if rig.controller is None:
        raise RobotError(
            f"the rig '{rig.name}' has no [controller]: it says nothing of a real or emulated machine",
            "give one with --rig FILE.toml, or --rig emulated",
        )
    return rig.controller
