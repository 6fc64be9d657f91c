"""What learning is fed: attempts of skills, grouped into trajectories, successful or not."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from resync_robot.core.damage import Shape, check_shape, reading
from resync_robot.core.errors import ResyncError
from resync_robot.core.files import read_text, whole
from resync_robot.core.state import State
from resync_robot.core.symbols import Atom, Atoms, Object, Predicate, Type

STEP: Shape = {"skill": str, "objects": [str], "succeeded": bool, "before": dict, "after": dict}
LINE: Shape = {"goal": [[str]], "solved": bool, "source": str, "transitions": [STEP]}
"""The fields of a trajectory in a file."""


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
    """One JSON object a line, and a last line that counts them; whole or not at all.

    Raises:
        OSError: what was there before is untouched.
    """
    count = 0
    with whole(path) as beside, beside.open("w", encoding="utf-8") as out:
        for t in trajectories:
            out.write(json.dumps(t.to_json()) + "\n")
            count += 1
        out.write(json.dumps({"trajectories": count}) + "\n")


def read_trajectories(path: Path, types: Mapping[str, Type], predicates: Mapping[str, Predicate]) -> list[Trajectory]:
    """The trajectories of a file written by `write_trajectories`. Raises TrainingError where it is not whole."""
    found: list[Trajectory] = []
    with reading(path):
        lines = read_text(path).splitlines()
        count = None
        for number, line in enumerate(lines, 1):
            try:
                data = json.loads(line)
                if number == len(lines) and isinstance(data, dict) and set(data) == {"trajectories"}:
                    count = data["trajectories"]
                    continue
                check_shape(data, LINE)
                found.append(Trajectory.from_json(data, types, predicates))
            except (KeyError, TypeError, ValueError, ResyncError) as error:
                # What JSON says of the place counts within the line.
                raise ValueError(f"line {number}: {getattr(error, 'msg', error)}") from error
        if count != len(found):
            raise ValueError(f"it holds {len(found)} trajectories and no last line that counts them: it was cut off")
    return found
