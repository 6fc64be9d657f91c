"""What learning is fed: attempts of skills, grouped into trajectories, successful or not."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from resync_robot.core.state import State
from resync_robot.core.symbols import Atom, Atoms, Object, Predicate, Type


@dataclass(frozen=True)
class Transition:
    """One attempt of a ground skill: (x, C, x') and whether the skill did what its operator promises."""

    before: State
    skill: str
    objects: tuple[Object, ...]
    after: State
    succeeded: bool


@dataclass(frozen=True)
class Trajectory:
    """Attempts in order towards one goal.

    Attributes:
        solved: the goal held at the end.
        source: where it came from, e.g. 'before@b1' for a dream with o^F resampled as before the
            recovery around b1, or 'training', 'attempt'.
    """

    transitions: tuple[Transition, ...]
    goal: Atoms
    solved: bool
    source: str

    @property
    def objects(self) -> tuple[Object, ...]:
        return self.transitions[0].before.objects if self.transitions else ()

    def to_json(self) -> dict[str, Any]:
        return {
            "goal": [[a.predicate.name, *(o.name for o in a.args)] for a in sorted(self.goal)],
            "solved": self.solved,
            "source": self.source,
            "transitions": [
                {
                    "skill": t.skill,
                    "objects": [o.name for o in t.objects],
                    "succeeded": t.succeeded,
                    "before": t.before.to_json(),
                    "after": t.after.to_json(),
                }
                for t in self.transitions
            ],
        }

    @staticmethod
    def from_json(
        data: Mapping[str, Any], types: Mapping[str, Type], predicates: Mapping[str, Predicate]
    ) -> Trajectory:
        transitions = []
        named: dict[str, Object] = {}
        for t in data["transitions"]:
            before, after = State.from_json(t["before"], types), State.from_json(t["after"], types)
            named = {o.name: o for o in before}
            transitions.append(
                Transition(before, t["skill"], tuple(named[n] for n in t["objects"]), after, bool(t["succeeded"]))
            )
        goal = frozenset(Atom(predicates[p], tuple(named[n] for n in args)) for p, *args in data["goal"])
        return Trajectory(tuple(transitions), goal, bool(data["solved"]), str(data["source"]))


def write_trajectories(path: Path, trajectories: Iterable[Trajectory]) -> None:
    """One JSON object a line, written beside and renamed, so that a kill leaves the old file or the new one."""
    beside = path.with_suffix(".part")
    with beside.open("w") as out:
        for t in trajectories:
            out.write(json.dumps(t.to_json()) + "\n")
    beside.replace(path)


def read_trajectories(
    path: Path, types: Mapping[str, Type], predicates: Mapping[str, Predicate]
) -> Iterator[Trajectory]:
    """The trajectories of a file written by `write_trajectories`."""
    with path.open() as lines:
        for line in lines:
            yield Trajectory.from_json(json.loads(line), types, predicates)
