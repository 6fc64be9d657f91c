"""Episodes of a recovery: the scenes that they are in, where they begin, and one action in each."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

from resync_robot.core.embodiment import TrainingSimulator
from resync_robot.core.errors import TrainingError
from resync_robot.core.state import State
from resync_robot.core.task import Task
from resync_robot.core.world import EffortLimited
from resync_robot.planning.skill_run import run_skill
from resync_robot.sim_training.recovery_problem import Problem, Start


@dataclass
class Scene:
    """One episode, or what is left of it.

    Attributes:
        run: what the recovery's interface remembers of it.
        state: now.
        rested: actions since the failed skill was run last.
        needed: the probability of its success from which on it can be over.
        way: snapshots along it.
    """

    task: Task
    simulator: TrainingSimulator[Any, Any]
    run: Any
    state: State
    steps: int = 0
    rested: int = 0
    needed: float = 0.0
    way: list[Any] = field(default_factory=list)


class Episodes:
    """Where episodes begin: in failures, in states between failure and freedom, and on the way of earlier successes.

    Args:
        starts: the failures that episodes begin in.
        easier: share of episodes that begin in the latter two, once there are any.
        kept: how many such states are kept of either kind, and scenes that nobody uses.
    """

    def __init__(
        self, problem: Problem, starts: Sequence[Start], rng: np.random.Generator, easier: float, kept: int
    ) -> None:
        self.problem, self._interface, self._rng, self._starts = problem, problem.interface, rng, starts
        self._easier, self._kept = easier, kept
        self._period = 1.0 / problem.interface.rate_hz
        self._idle: OrderedDict[int, list[tuple[Task, TrainingSimulator[Any, Any]]]] = OrderedDict()
        self._begun: dict[int, Any] = {}
        self.between: list[tuple[Task, Any]] = []
        self.passed: list[tuple[Task, Any]] = []

    def begin(self) -> Scene:
        """A new episode. Raises TrainingError: none can begin."""
        easier = [states for states in (self.between, self.passed) if states]
        if easier and self._rng.random() < self._easier:
            states = easier[int(self._rng.integers(len(easier)))]
            task, snapshot = states[int(self._rng.integers(len(states)))]
            simulator = self._simulator(task)
            simulator.restore(snapshot)
            return self._scene(task, simulator)
        for _ in range(10 * len(self._starts)):
            i = int(self._rng.integers(len(self._starts)))
            task = self._starts[i].task
            simulator = self._simulator(task)
            if i not in self._begun:
                self._begun[i] = simulator.save() if self._approached(simulator, self._starts[i].state) else None
            if self._begun[i] is not None:
                simulator.restore(self._begun[i])
                return self._scene(task, simulator)
            self._put_back(task, simulator)
        raise TrainingError(
            f"none of {len(self._starts)} states stands still in the simulator, or the recovery cannot begin",
            "check-domain tells more",
        )

    def begin_in(self, task: Task, state: State, approach: bool = True) -> Scene | None:
        """An episode in this state, once the robot is where the policy takes over; None where that fails.

        Args:
            approach: False where the robot is there already.
        """
        simulator = self._simulator(task)
        if self._approached(simulator, state) if approach else simulator.reset(state):
            return self._scene(task, simulator)
        self._put_back(task, simulator)
        return None

    def end(self, scene: Scene) -> None:
        """Its scene can be used again."""
        self._put_back(scene.task, scene.simulator)

    def see(self, scenes: Sequence[Scene]) -> Float[np.ndarray, "n d"]:
        """What the policy sees of them."""
        return self._interface.see([scene.run for scene in scenes], [scene.state for scene in scenes])

    def move(self, scenes: Sequence[Scene], actions: Float[np.ndarray, "n k"]) -> None:
        """One action, in [-1, 1], in each."""
        runs, states = [scene.run for scene in scenes], [scene.state for scene in scenes]
        for scene, action in zip(scenes, self._interface.act(runs, states, actions.clip(-1, 1)), strict=True):
            scene.simulator.act(action, self._period)
            scene.steps += 1
            scene.rested += 1
            scene.state = scene.simulator.perceive()

    def keep(self, states: list[tuple[Task, Any]], task: Task, snapshot: Any) -> None:
        """In `between` or `passed`, in place of another where they are full."""
        states.append((task, snapshot))
        if len(states) > self._kept:
            states.pop(int(self._rng.integers(len(states))))

    def limit(self, simulator: TrainingSimulator[Any, Any]) -> None:
        """Let an arm press no harder than the finished skill does; every skill that runs lifts that limit."""
        if isinstance(simulator, EffortLimited):
            simulator.limit_effort(self._interface.effort_limit)

    def _scene(self, task: Task, simulator: TrainingSimulator[Any, Any]) -> Scene:
        self.limit(simulator)
        state = simulator.perceive()
        return Scene(task, simulator, self._interface.begin(self.problem.objects, state, self._rng), state)

    def _approached(self, simulator: TrainingSimulator[Any, Any], state: State) -> bool:
        if not simulator.reset(state):
            return False
        approach = self._interface.approach
        return approach is None or run_skill(simulator, approach.ground(self.problem.objects)).done

    # Scenes are dear to build.

    def _simulator(self, task: Task) -> TrainingSimulator[Any, Any]:
        """One of the task that nobody uses, or a new one."""
        idle = self._idle.get(id(task), [])
        if not idle:
            return self.problem.embodiment.simulate(task)
        _, simulator = idle.pop()
        if not idle:
            del self._idle[id(task)]
        return simulator

    def _put_back(self, task: Task, simulator: TrainingSimulator[Any, Any]) -> None:
        # With the task, for as long as it lives no other has its id.
        self._idle.setdefault(id(task), []).append((task, simulator))
        self._idle.move_to_end(id(task))
        while len(self._idle) > self._kept:
            self._idle.popitem(last=False)
