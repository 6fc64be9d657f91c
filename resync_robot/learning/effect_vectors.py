"""Effect vectors of known predicates: as a library keeps them, as operators state them, and as data show them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from resync_robot.core.damage import check_shape
from resync_robot.core.symbols import Atoms, Operator, Predicate, Type
from resync_robot.learning.dataset import Dataset
from resync_robot.learning.effects import Attempts, Candidate, Effect, Slots, affected, attempted, slots

USUAL = 0.5
"""A skill has an effect on a known predicate where more than this share of its successes change the atoms so."""


def effects_to_json(effects: Iterable[Effect]) -> dict[str, list[list[Any]]]:
    """Skill -> [slots, sign] of each of its effects."""
    by_skill: dict[str, list[list[Any]]] = {}
    for effect in effects:
        by_skill.setdefault(effect.skill, []).append([list(effect.slots), effect.sign])
    return by_skill


def candidate_to_json(candidate: Candidate) -> dict[str, Any]:
    """`effects` and, where attempts label the predicate, `attempts`; `candidate_from_json` is the inverse."""
    data: dict[str, Any] = {"effects": effects_to_json(candidate.effects)}
    if candidate.attempts is not None:
        data["attempts"] = {"skill": candidate.attempts.skill, "slots": list(candidate.attempts.slots)}
    return data


def candidate_from_json(
    data: Mapping[str, Any], types: tuple[Type, ...], signatures: Mapping[str, Sequence[Type]]
) -> Candidate:
    """The candidate that a predicate was learned as.

    Args:
        types: of the predicate.
        signatures: skill name -> types of its objects.

    Raises:
        ValueError: `data` holds no effect vector over these skills.
    """
    check_shape(data, {"effects": dict})

    def where(skill: Any, chosen: Any, ways_of: Callable[..., list[Slots]] = slots) -> Slots:
        ways = ways_of(types, signatures.get(skill, ()))
        if not isinstance(chosen, list) or tuple(chosen) not in ways:
            raise ValueError(f"{chosen} are no parameters of {skill} for the arguments of the predicate")
        return tuple(chosen)

    effects: list[Effect] = []
    for skill, entries in data["effects"].items():
        check_shape(entries, [list], f"effects.{skill}")
        for entry in entries:
            if len(entry) != 2 or entry[1] not in (1, -1):
                raise ValueError(f"an effect of {skill} is {entry}, and should be parameters and a sign, 1 or -1")
            effects.append(Effect(skill, where(skill, entry[0]), int(entry[1])))
    if data.get("attempts") is None:
        return Candidate(types, tuple(effects))
    check_shape(data, {"attempts": {"skill": str, "slots": list}})
    skill = data["attempts"]["skill"]
    return Candidate(types, tuple(effects), Attempts(skill, where(skill, data["attempts"]["slots"], attempted)))


def stated_effects(predicate: Predicate, operators: Iterable[Operator]) -> list[Effect]:
    """The effects on a predicate that operators state."""
    return [
        Effect(op.name, tuple([v.name for v in op.parameters].index(a.name) for a in atom.args), sign)
        for op in operators
        for atoms, sign in ((op.add, 1), (op.delete, -1))
        for atom in sorted(atoms)
        if atom.predicate == predicate
    ]


def measured_effects(dataset: Dataset, truth: Sequence[Atoms], predicate: Predicate, skill: str) -> list[Effect]:
    """What a skill usually does to a known predicate: its entries of the effect vector, as the data show them.

    Args:
        truth: for each moment the atoms that hold.
    """
    steps = [(step, run.objects) for run in dataset.runs for step in run.steps if step.skill == skill]
    found: list[Effect] = []
    for where in slots(predicate.types, dataset.signatures[skill]):
        changes = [
            int(predicate(*args) in truth[step.after]) - int(predicate(*args) in truth[step.before])
            for step, objects in steps
            for args in affected(step, where, predicate.types, objects)
        ]
        found += [Effect(skill, where, sign) for sign in (1, -1) if changes.count(sign) > USUAL * len(changes)]
    return found
