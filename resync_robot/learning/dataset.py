"""Trajectories as concept learning reads them: moments, the steps between them, and attempts that failed.

A moment is a point of a trajectory at which no symbol can have changed: the state after a skill and the state before
the next one are the same moment, and so are the states around a failed attempt that a recovery then followed.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from resync_robot.core.errors import TrainingError
from resync_robot.core.state import State
from resync_robot.core.symbols import Atoms, Object, Type
from resync_robot.core.trajectory import Trajectory, Transition

ATTEMPT = "attempt"
"""Source of trajectories that try one skill and aim at nothing."""


@dataclass(frozen=True)
class StageData:
    """What one stage adds to the data.

    Attributes:
        recovery, recovery_types: name and signature of the skill that it learned.
        failed_skill: the skill whose failure the recovery mends.
        trajectories: dreams (successful and failed attempts) and single attempts (`source` "attempt").
    """

    recovery: str
    recovery_types: tuple[Type, ...]
    failed_skill: str
    trajectories: Sequence[Trajectory]


@dataclass(frozen=True, slots=True)
class Step:
    """One attempt of a skill, between two moments (indices into `Dataset.moments`).

    Attributes:
        mended_by: of a failed attempt the recovery that mended it: it followed at once and said that it is done, and
            the next such attempt succeeded. Empty where none did.
    """

    skill: str
    objects: tuple[Object, ...]
    before: int
    after: int
    mended_by: str = ""


@dataclass(frozen=True, slots=True)
class Run:
    """One trajectory.

    Attributes:
        steps: successful attempts in order; where the trajectory is solved they are the demonstration.
        failures: attempts that failed (`after` is the moment that followed).
        first: the moment the trajectory starts from.
        stage: whose data it belongs to, from 1.
    """

    steps: tuple[Step, ...]
    failures: tuple[Step, ...]
    first: int
    goal: Atoms
    solved: bool
    source: str
    objects: tuple[Object, ...]
    stage: int


@dataclass(frozen=True)
class Dataset:
    """All states, moments and runs.

    Attributes:
        moments: for each moment the states (indices) it was seen in; the first stands for it.
        signatures: skill name -> types of its objects.
    """

    states: tuple[State, ...]
    moments: tuple[tuple[int, ...], ...]
    runs: tuple[Run, ...]
    signatures: Mapping[str, tuple[Type, ...]]

    def state_at(self, moment: int) -> State:
        return self.states[self.moments[moment][0]]


def merged_dataset(
    stages: Sequence[Sequence[Trajectory]], recoveries: Collection[str], signatures: Mapping[str, tuple[Type, ...]]
) -> Dataset:
    """The default view: a failed attempt and the recovery after it are one use of the recovery skill.

    The recovery then means "approach until the failure detector fires, then recover", it starts from the state in
    which the attempt began, and no symbol is spent on failing on purpose. Failed attempts stay as labels.
    """
    builder = _Builder(signatures, recoveries)
    for stage, t in _numbered(stages):
        builder.add(t, [(x, x.skill) for x in t.transitions], stage)
    return builder.dataset()


def variant_dataset(
    stages: Sequence[Sequence[Trajectory]], recoveries: Collection[str], signatures: Mapping[str, tuple[Type, ...]]
) -> Dataset:
    """The published view: a failed attempt that a recovery follows is a skill of its own, `FAILED_RECOVERY`.

    Only solved trajectories count, and attempts that failed for good are left out.
    """
    known = dict(signatures)
    builder = _Builder(known, recoveries)
    for stage, t in _numbered(stages):
        if not t.solved or t.source == ATTEMPT:
            continue
        named: list[tuple[Transition, str]] = []
        for x, following in zip(t.transitions, [*t.transitions[1:], None], strict=True):
            if x.succeeded:
                named.append((x, x.skill))
            elif following is not None and following.skill in recoveries and following.succeeded:
                variant = variant_name(x.skill, following.skill)
                known[variant] = known[x.skill]
                named.append((Transition(x.before, variant, x.objects, x.after, True), variant))
        builder.add(Trajectory(tuple(x for x, _ in named), t.goal, True, t.source), named, stage)
    return builder.dataset()


def variant_name(failed_skill: str, recovery: str) -> str:
    """The published view's name for an attempt that this recovery follows."""
    return f"{failed_skill}_{recovery}"


def without_unclear(dataset: Dataset) -> Dataset:
    """The same without failures that may have any of several causes.

    From the second stage on a dream has the causes of several failures. What failed there, and no recovery mended, does
    not say of what; an attempt, which has the causes of one, does.
    """

    def clear(run: Run) -> tuple[Step, ...]:
        if run.stage == 1 or run.source == ATTEMPT:
            return run.failures
        return tuple(f for f in run.failures if f.mended_by)

    return replace(dataset, runs=tuple(replace(run, failures=clear(run)) for run in dataset.runs))


def _numbered(stages: Sequence[Sequence[Trajectory]]) -> Iterator[tuple[int, Trajectory]]:
    return ((n, t) for n, trajectories in enumerate(stages, start=1) for t in trajectories)


class _Builder:
    def __init__(self, signatures: Mapping[str, tuple[Type, ...]], recoveries: Collection[str]) -> None:
        self.signatures, self.recoveries = signatures, recoveries
        self.states: list[State] = []
        self.moments: list[list[int]] = []
        self.runs: list[Run] = []

    def add(self, t: Trajectory, transitions: Sequence[tuple[Transition, str]], stage: int) -> None:
        if not transitions:
            return
        steps: list[Step] = []
        failures: list[Step] = []
        first = now = self._moment(transitions[0][0].before)
        for i, (x, skill) in enumerate(transitions):
            if tuple(o.type for o in x.objects) != tuple(self.signatures.get(skill, ())):
                names = ", ".join(f"{k}({', '.join(t.name for t in v)})" for k, v in sorted(self.signatures.items()))
                raise TrainingError(f"a trajectory ({t.source}) uses {skill}{x.objects}; known skills: {names}")
            self._seen(now, x.before)
            if x.succeeded:
                after = self._moment(x.after)
                steps.append(Step(skill, x.objects, now, after))
                now = after
                continue
            recovery = next((s for y, s in transitions[i + 1 : i + 2] if s in self.recoveries and y.succeeded), "")
            # That it is done is the recovery's own word: it may have pushed what was not in the way.
            again = next((y.succeeded for y, s in transitions[i + 2 :] if (s, y.objects) == (skill, x.objects)), False)
            after = now if recovery else self._moment(x.after)
            failures.append(Step(skill, x.objects, now, after, recovery if again else ""))
            now = after
        self.runs.append(Run(tuple(steps), tuple(failures), first, t.goal, t.solved, t.source, t.objects, stage))

    def _moment(self, state: State) -> int:
        self.moments.append([])
        self._seen(len(self.moments) - 1, state)
        return len(self.moments) - 1

    def _seen(self, moment: int, state: State) -> None:
        if not any(self.states[i] == state for i in self.moments[moment]):
            self.states.append(state)
            self.moments[moment].append(len(self.states) - 1)

    def dataset(self) -> Dataset:
        if not self.runs:
            raise TrainingError(
                "concept learning was given no trajectory it can use", "dream more, or check the dreams"
            )
        return Dataset(
            tuple(self.states), tuple(tuple(m) for m in self.moments), tuple(self.runs), dict(self.signatures)
        )
