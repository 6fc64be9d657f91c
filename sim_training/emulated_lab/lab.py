"""An emulated lab: the simulated world behind the emulated controller, and pictures of it from a process of its own.

Pictures are rendered elsewhere because a software renderer takes a tenth of a second, in which a controller ticks
fifty times.
"""

from __future__ import annotations

import json
import logging
import os
import socketserver
import subprocess
import sys
import threading
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import resync_robot
from resync_robot.core.errors import ConfigError, ResyncError
from resync_robot.core.rig import Rig
from resync_robot.core.task import Task
from resync_robot.hardware.base import RobotError
from resync_robot.hardware.emulator.arm import SimulatedArm
from resync_robot.hardware.emulator.controller import Controller, ControllerSettings
from resync_robot.hardware.emulator.faults import FaultPlan
from resync_robot.hardware.emulator.gripper import EmulatedGripper
from resync_robot.hardware.emulator.lab_client import MAX_LINE, PORT
from resync_robot.hardware.emulator.server import Emulator
from resync_robot.sim_training.domains import find_domain, world_task
from resync_robot.sim_training.physics.world import SimWorld
from resync_robot.sim_training.scenes.calibration import Bench, displaced

_log = logging.getLogger(__name__)
LAYOUT_LIMIT_S = 60.0


class Lab:
    """A simulated arm, its gripper and its cameras, behind the protocols of real ones.

    Args:
        rig: with a [controller] section that says it is emulated.
        faults: what goes wrong, and when.
        rig_path: the rig's file, for the process that renders.

    Raises:
        RobotError: a port is taken, or the rig's address is not loopback.
    """

    def __init__(self, rig: Rig, rig_path: Path, faults: FaultPlan | None = None) -> None:
        if rig.controller is None or not rig.controller.emulated:
            raise ConfigError(
                f"the rig '{rig.name}' is not an emulated one",
                "give --rig emulated, or a copy of hardware/emulated.toml",
            )
        self.rig = rig
        self._task = self._scene({"domain": "cornered-insertion-s", "scenario": "s1", "seed": 0, "episode": 0})
        self.world = SimWorld(self._task, rig)
        settings = ControllerSettings(world_T_base=rig.arm.world_T_base, model=rig.arm.facts)
        self.controller = Controller(SimulatedArm(self.world), settings)
        self.gripper = EmulatedGripper(rig.gripper.max_opening, activated=True, model=rig.gripper.facts)
        self.emulator = Emulator(self.controller, rig.controller.address, self.gripper)
        if faults is not None:
            self.emulator.every_tick.append(faults)
        self._pictures = PictureProcess(rig_path)
        self._server = _Server((rig.controller.address, PORT), self)

    def __enter__(self) -> Self:
        self.emulator.start()
        threading.Thread(target=self._server.serve_forever, name="lab", daemon=True).start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.shutdown()
        self._server.server_close()
        self.emulator.close()
        self._pictures.close()

    def answer(self, question: dict[str, Any]) -> tuple[dict[str, Any], bytes]:
        """What the side door answers. Raises ResyncError, KeyError, TypeError or ValueError on nonsense."""
        do = question.get("do")
        if do == "lay out":
            self.emulator.call(lambda: self._lay_out(self._scene(question)), LAYOUT_LIMIT_S)
            self._pictures.lay_out({k: v for k, v in question.items() if k != "do"})
            if "bench" not in question:
                return {}, b""
            cameras = displaced(self.rig, Bench.from_json(question["bench"]).seed).cameras
            return {"cameras": {c.name: c.pose.tolist() for c in cameras}}, b""
        if do == "truth":
            return {"objects": self.emulator.call(self._truth).to_json()}, b""
        if do == "picture":
            name = self.rig.camera(str(question["camera"])).name
            time, poses = self.emulator.call(lambda: (self.controller.time, self._poses()))
            part: dict[str, Any] = {k: question[k] for k in ("window", "size", "film") if k in question}
            head, body = self._pictures.take({"camera": name, "time": time, **part, **poses})
            return head | {"time": time}, body
        raise ConfigError(f"the side door does not know '{do}'", "it knows: lay out, truth, picture")

    def _scene(self, question: dict[str, Any]) -> Task:
        if "bench" in question:
            return Bench.from_json(question["bench"]).task(self.rig)
        domain = find_domain(str(question["domain"]))
        domain.scenario(str(question["scenario"]))
        return world_task(domain, str(question["scenario"]), int(question["seed"]), int(question["episode"]))

    def _lay_out(self, task: Task) -> None:
        self._task, self.world = task, SimWorld(task, self.rig)
        if not self.world.settles():
            raise ConfigError(f"the scene of seed {task.seed} does not stand still", "take another --seed")
        self.controller.install(SimulatedArm(self.world))
        self.gripper.lay_open(self.controller.opening)

    def _truth(self) -> Any:
        return self.world.perceive()

    def _poses(self) -> dict[str, Any]:
        q, qd, opening, _ = self.world.measure()
        state = self.world.state(q, opening)
        return {
            "q": q.tolist(),
            "qd": qd.tolist(),
            "opening": opening,
            "objects": {o.name: state[o][:7].tolist() for o in state},
        }


class PictureProcess:
    """The process that renders; it starts with the first scene and restarts with the next, should it have died."""

    def __init__(self, rig_path: Path) -> None:
        self._rig_path = rig_path
        self._process: subprocess.Popen[bytes] | None = None
        self._lock = threading.Lock()

    def lay_out(self, scene: dict[str, Any]) -> None:
        with self._lock:
            if self._process is None or self._process.poll() is not None:
                root = str(Path(resync_robot.__file__).parents[1])
                path = os.pathsep.join([root, *(p for p in sys.path if p)])
                self._process = subprocess.Popen(
                    [sys.executable, "-m", "resync_robot.sim_training.emulated_lab.pictures", str(self._rig_path)],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    env=os.environ | {"PYTHONPATH": path},
                    # A Ctrl-C at the terminal is for the lab, which ends it.
                    start_new_session=True,
                )
            self._ask({"scene": scene})

    def take(self, request: dict[str, Any]) -> tuple[dict[str, Any], bytes]:
        """Size and bytes of a picture: colour, then depth."""
        with self._lock:
            return self._ask(request)

    def close(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None

    def _ask(self, request: dict[str, Any]) -> tuple[dict[str, Any], bytes]:
        process = self._process
        if process is None or process.stdin is None or process.stdout is None:
            raise RobotError("no scene has been laid out yet")
        try:
            process.stdin.write(json.dumps(request).encode() + b"\n")
            process.stdin.flush()
            head = json.loads(process.stdout.readline())
            if "error" in head:
                raise RobotError(str(head["error"]))
            return head, process.stdout.read(int(head.get("bytes", 0)))
        except (OSError, ValueError) as error:
            raise RobotError(f"the emulated cameras have died: {error}", "resync-robot doctor") from None


class _Server(socketserver.ThreadingTCPServer):
    allow_reuse_address, daemon_threads = True, True

    def __init__(self, where: tuple[str, int], lab: Lab) -> None:
        self.lab = lab
        try:
            super().__init__(where, _Visitor)
        except OSError as error:
            raise RobotError(f"cannot listen on {where[0]}:{where[1]}: {error.strerror}") from None


class _Visitor(socketserver.StreamRequestHandler):
    def handle(self) -> None:
        server = self.server
        if not isinstance(server, _Server):
            return
        while line := self.rfile.readline(MAX_LINE):
            try:
                question = json.loads(line)
                if not isinstance(question, dict):
                    raise ValueError("no JSON object")
                head, body = server.lab.answer(question)
            except (ResyncError, ValueError, KeyError, TypeError) as error:
                head, body = {"error": getattr(error, "what", str(error))}, b""
            try:
                self.wfile.write(json.dumps(head | {"bytes": len(body)}).encode() + b"\n" + body)
            except OSError:
                return
