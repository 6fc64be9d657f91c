"""Many recovery scenes stepped by a few worker processes: lean numpy in, lean numpy out.

ManiSkill's CPU environment spends nine tenths of its time outside physics; here a step is drive targets in, joint
positions and block poses out, through shared memory.
"""

from __future__ import annotations

import multiprocessing as mp
import signal
from collections.abc import Sequence
from contextlib import suppress
from multiprocessing.connection import Connection
from multiprocessing.shared_memory import SharedMemory
from typing import Any

import numpy as np

from resync_robot.core.rig import Rig
from resync_robot.core.symbols import Object
from resync_robot.core.task import Task

CONTROL_PERIOD = 0.1
"""s of one control step of the recovery policy."""
RECOVERY_TORQUE = (40.0, 40.0, 40.0, 12.0, 12.0, 12.0)
"""N m while a learned skill runs: without the cap a policy learns to flick the block with 200 N."""
_SETTLE = 0.02
"""s."""


class RecoveryScenes:
    """`count` scenes, each holding one task; the block and the arm can be put anywhere.

    Args:
        tasks: worlds to draw from; scene i begins with tasks[i % len(tasks)].
        block: the object that the policy moves.
        workers: processes; 0 steps in this one.
    """

    def __init__(self, tasks: Sequence[Task], block: Object, rig: Rig, count: int, workers: int) -> None:
        self.tasks, self.block, self.count = tasks, block, count
        self._columns = 6 + 7
        parts = np.array_split(np.arange(count), max(1, workers))
        self._memory = SharedMemory(create=True, size=count * (self._columns + 7) * 8)
        self._state, self._target = _views(self._memory, count, self._columns)
        self._connections: list[Connection] = []
        self._processes: list[Any] = []
        self._local: _Worker | None = None
        self._owner = {int(i): w for w, part in enumerate(parts) for i in part}
        if workers == 0:
            self._local = _Worker(self._memory, count, self._columns, parts[0], tasks, block, rig)
            return
        context = mp.get_context("forkserver")
        for part in parts:
            here, there = context.Pipe()
            process = context.Process(
                target=_serve,
                args=(there, self._memory.name, count, self._columns, part, list(tasks), block, rig),
                daemon=True,
            )
            process.start()
            there.close()
            self._connections.append(here)
            self._processes.append(process)
        for connection in self._connections:
            connection.recv()

    @property
    def joints(self) -> np.ndarray:
        """(count, 6) measured joint positions."""
        return self._state[:, :6]

    @property
    def blocks(self) -> np.ndarray:
        """(count, 7) poses of the block."""
        return self._state[:, 6:13]

    def step(self, q: np.ndarray, opening: float = 0.0) -> None:
        """Drive all arms to (count, 6) over one control step."""
        self._target[:, :6], self._target[:, 6] = q, opening
        self._all("step")

    def reset(self, resets: Sequence[tuple[int, int, np.ndarray, np.ndarray]]) -> None:
        """Begin anew: (scene, task index, (7,) block pose, (6,) joints) each; another task rebuilds the scene."""
        if self._local is not None:
            self._local.reset(list(resets))
            return
        shares: dict[int, list[Any]] = {}
        for item in resets:
            shares.setdefault(self._owner[item[0]], []).append(item)
        for worker, share in shares.items():
            self._connections[worker].send(("reset", share))
        for worker in shares:
            self._connections[worker].recv()

    def close(self) -> None:
        for connection in self._connections:
            # A signal to all processes may have ended it already.
            with suppress(OSError):
                connection.send(("close", None))
        for process in self._processes:
            process.join(timeout=5)
        self._local = None
        del self._state, self._target
        self._memory.close()
        self._memory.unlink()

    def __enter__(self) -> RecoveryScenes:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _all(self, command: str) -> None:
        if self._local is not None:
            self._local.step()
            return
        for connection in self._connections:
            connection.send((command, None))
        for connection in self._connections:
            connection.recv()


def _views(memory: SharedMemory, count: int, columns: int) -> tuple[np.ndarray, np.ndarray]:
    whole = np.ndarray((count, columns + 7), dtype=np.float64, buffer=memory.buf)
    return whole[:, :columns], whole[:, columns:]


class _Worker:
    """Owns some of the scenes."""

    def __init__(
        self,
        memory: SharedMemory,
        count: int,
        columns: int,
        mine: np.ndarray,
        tasks: Sequence[Task],
        block: Object,
        rig: Rig,
    ) -> None:
        self.state, self.target = _views(memory, count, columns)
        self.tasks, self.block, self.rig = tasks, block, rig
        self.scenes: dict[int, Any] = {}
        self.held: dict[int, int] = {}
        self.last = np.zeros((count, 6))
        for i in mine:
            self._build(int(i), int(i) % len(tasks))
            self._read(int(i))

    def _build(self, scene: int, task: int) -> None:
        from resync_robot.sim_training.physics.scene import build_scene

        built = build_scene(self.tasks[task], self.rig, rendered=False)
        built.set_torque_limits(RECOVERY_TORQUE)
        self.scenes[scene], self.held[scene] = built, task

    def _read(self, scene: int) -> None:
        built = self.scenes[scene]
        pose = built.rigid[self.block].entity_pose
        row = self.state[scene]
        row[:6] = built.robot.qpos[built.arm_index]
        row[6:9], row[9:13] = pose.p, pose.q

    def step(self) -> None:
        for scene, built in self.scenes.items():
            goal, opening = self.target[scene, :6], float(self.target[scene, 6])
            built.approach(self.last[scene].copy(), goal, opening, CONTROL_PERIOD)
            self.last[scene] = goal
            self._read(scene)

    def reset(self, resets: list[tuple[int, int, np.ndarray, np.ndarray]]) -> None:
        import sapien

        for scene, task, pose, q in resets:
            if task != self.held[scene]:
                self._build(scene, task)
            built = self.scenes[scene]
            body = built.rigid[self.block]
            body.entity.set_pose(sapien.Pose(pose[:3], pose[3:]))
            body.linear_velocity, body.angular_velocity = np.zeros(3), np.zeros(3)
            body.wake_up()
            built.set_configuration(q, 0.0)
            self.last[scene] = q
            for _ in range(built.solver.steps(_SETTLE)):
                built.scene.step()
            self._read(scene)


def _serve(
    connection: Connection,
    memory_name: str,
    count: int,
    columns: int,
    mine: np.ndarray,
    tasks: list[Task],
    block: Object,
    rig: Rig,
) -> None:
    # A Ctrl-C at the terminal is for the parent, which ends its workers.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    memory = SharedMemory(name=memory_name)
    worker = _Worker(memory, count, columns, mine, tasks, block, rig)
    connection.send("ready")
    while True:
        try:
            command, argument = connection.recv()
        except EOFError:
            return
        if command == "close":
            return
        if command == "step":
            worker.step()
        else:
            worker.reset(argument)
        connection.send("done")
