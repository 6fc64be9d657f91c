"""A robot on a rail that pushes a slider. Its skill Grip succeeds where the slider stands clear of both ends."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from resync_robot.core.embodiment import Embodiment, Stage
from resync_robot.core.skill import Skill, SkillEnd, SkillOutcome
from resync_robot.core.state import State
from resync_robot.core.symbols import Atoms, Object, Predicate, Type
from resync_robot.core.task import Domain, Task
from resync_robot.sim_training.failure_mining import Explanation
from resync_robot.sim_training.recovery_problem import Direct, Judge, Problem, Start

PUSHER, SLIDER, STOP = Type("pusher", ("x",)), Type("slider", ("x", "held")), Type("stop", ("x",))
P, S, END = PUSHER("p"), SLIDER("s"), STOP("end")
HELD = Predicate("Held", (SLIDER,))
CLEAR = (0.5, 0.8)
"""m from the end, between which a slider can be gripped."""


class Rail:
    """Everything moves along one line; the pusher moves what it meets, to the right only."""

    def __init__(self, task: Task) -> None:
        self.task, self.time = task, 0.0
        self.reset(task.initial)

    def reset(self, state: State) -> bool:
        self.x = np.array([state[P][0], state[S][0], state[S][1]])
        return 0 <= self.x[0] <= self.x[1] <= 1

    def save(self) -> Any:
        return self.x.copy()

    def restore(self, snapshot: Any) -> None:
        self.x = snapshot.copy()

    def perceive(self) -> State:
        return State({P: self.x[:1].copy(), S: self.x[1:].copy(), END: np.zeros(1)})

    def observe(self, live: bool = False) -> Any:
        return _Observation(self.perceive())

    def act(self, target: Any, duration: float) -> None:
        if target is GRIP:
            self.x[2] = float(CLEAR[0] < self.x[1] < CLEAR[1])
            return
        self.x[0] = np.clip(self.x[0] + target[0], 0, 1)
        self.x[1] = np.clip(max(self.x[1], self.x[0]), 0, 1)

    def limit_effort(self, limit: tuple[float, ...] | None) -> None: ...

    def contacts(self) -> Mapping[Object, float]:
        return MappingProxyType({})


class _Observation:
    def __init__(self, state: State) -> None:
        self.state = state


GRIP = object()


class _Once:
    """Takes one action."""

    def __init__(self, action: Any) -> None:
        self._left = [action]

    def step(self, observation: Any) -> Any:
        return self._left.pop() if self._left else SkillOutcome(SkillEnd.DONE)


GRIP_SKILL = Skill("Grip", (PUSHER, SLIDER), lambda objects, observation: _Once(GRIP), 10.0, 1.0)
ONWARD = 0.1
"""m that a pusher coasts."""
COAST_SKILL = Skill("Coast", (PUSHER, SLIDER), lambda objects, observation: _Once(np.array([ONWARD])), 10.0, 1.0)
EMBODIMENT = Embodiment(actions={"dx": (-0.1, 0.1)}, rate_hz=10, simulate=Rail, skills=lambda: (GRIP_SKILL,))


def task_at(pusher: float, slider: float) -> Task:
    initial = State({P: np.array([pusher]), S: np.array([slider, 0.0]), END: np.zeros(1)})
    return Task((P, S, END), initial, frozenset({HELD(S)}), {}, 0)


def true_atoms(state: State) -> Atoms:
    return frozenset({HELD(S)} if state[S][1] > 0.5 else ())


def see(state: State) -> np.ndarray:
    """(2,) how far the slider is from the end, and the pusher from the slider."""
    return np.array([state[S][0] - state[END][0], state[S][0] - state[P][0]])


class _View:
    """`see`, as the interface of a stage asks for it."""

    def each(self, states: Sequence[State]) -> np.ndarray:
        return np.stack([see(state) for state in states])


JUDGE = Judge(GRIP_SKILL.ground((P, S)), frozenset(), frozenset({HELD(S)}), true_atoms)


def problem(starts: Sequence[Start]) -> Problem:
    """To bring the slider to where it can be gripped, in 20 actions."""
    domain = Domain("rail", (PUSHER, SLIDER, STOP), (HELD,), {}, (), {}, (STAGE,), EMBODIMENT)
    explanation = Explanation("Grip", (P, S), S, (END,))
    return Problem(domain, EMBODIMENT, STAGE, explanation, tuple(starts), JUDGE, Direct(_View(), 2, EMBODIMENT))


STAGE = Stage(recovery="Slide", scenario="rail", horizon=20)


def attempts(starts: Sequence[Start]) -> tuple[np.ndarray, np.ndarray]:
    """What a run of Grip from each start begins with, and whether it succeeds."""
    rails = [Rail(start.task) for start in starts]
    return np.stack([see(rail.perceive()) for rail in rails]), np.array(
        [JUDGE(rail, rail.perceive()) for rail in rails]  # type: ignore[arg-type]
    )  # type: ignore[arg-type]
