"""A model as a graph: which skill makes what true for which, in layers from what holds anyway to what comes last."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

from resync_robot.core.symbols import Operator

SWEEPS = 8
"""How often neighbours are brought closer to each other, down and up in turn."""


@dataclass(frozen=True, order=True)
class Node:
    """A predicate, whoever it is about (the table of the model says about whom), or a skill."""

    name: str
    skill: bool
    learned: bool


@dataclass(frozen=True)
class ModelGraph:
    """Layers of predicates and of skills in turn, and edges from what is needed to the skill, and from the skill to
    what it makes true. Most edges lead down; where one leads up, a skill brings back what an earlier one ended."""

    layers: tuple[tuple[Node, ...], ...]
    edges: tuple[tuple[Node, Node], ...]

    def places(self) -> Mapping[Node, tuple[float, int]]:
        """Of each node its place in its layer, from left to right with 0 in the middle, and the number of the layer."""
        return {n: (i - (len(layer) - 1) / 2, k) for k, layer in enumerate(self.layers) for i, n in enumerate(layer)}


def graph_of(operators: Iterable[Operator], learned: Collection[str]) -> ModelGraph:
    """The graph of a model.

    Args:
        learned: names of the predicates, and of the skills, that were not given.
    """
    needs: dict[Node, set[Node]] = {}
    makes: dict[Node, set[Node]] = {}
    for operator in sorted(operators, key=lambda o: o.name):
        skill = Node(operator.name, True, operator.name in learned)
        for found, atoms in ((needs, operator.preconditions), (makes, operator.add)):
            names = {atom.predicate.name for atom in atoms}
            found.setdefault(skill, set()).update(Node(name, False, name in learned) for name in names)
    edges = [(p, s) for s in needs for p in sorted(needs[s])] + [(s, p) for s in makes for p in sorted(makes[s])]
    return ModelGraph(_without_crossings(_layers(needs, makes), edges), tuple(edges))


def _layers(needs: Mapping[Node, set[Node]], makes: Mapping[Node, set[Node]]) -> list[list[Node]]:
    """First the predicates that no skill makes true, then the skills that need nothing else, then what these make true,
    and so on. Where that ends, what most of the others need is taken to hold as well, as an empty hand does."""
    left = list(needs)
    held = set().union(*needs.values()) - set().union(*makes.values())
    layers, new = [], sorted(held)
    while left:
        ready = [skill for skill in left if needs[skill] <= held]
        if not ready:
            missing = Counter(p for skill in left for p in needs[skill] - held)
            new.append(min(missing, key=lambda p: (-missing[p], p)))
            held.add(new[-1])
            continue
        layers += [new, ready] if new else [ready]
        left = [skill for skill in left if skill not in ready]
        new = sorted(set().union(*(makes[skill] for skill in ready)) - held)
        held.update(new)
    return [*layers, new] if new else layers


def _without_crossings(layers: list[list[Node]], edges: list[tuple[Node, Node]]) -> tuple[tuple[Node, ...], ...]:
    """With few: each node goes to the mean place of its neighbours in the layers above, then below, again and again."""
    beside: dict[Node, list[Node]] = {}
    for a, b in edges:
        beside.setdefault(a, []).append(b)
        beside.setdefault(b, []).append(a)
    level = {node: i for i, layer in enumerate(layers) for node in layer}
    place = {node: float(i) - (len(layer) - 1) / 2 for layer in layers for i, node in enumerate(layer)}

    def wanted(node: Node, above: bool) -> float:
        there = [place[n] for n in beside.get(node, ()) if (level[n] < level[node]) == above]
        return sum(there) / len(there) if there else place[node]

    for sweep in range(SWEEPS):
        above = sweep % 2 == 0
        for layer in layers if above else reversed(layers):
            layer.sort(key=lambda node: (wanted(node, above), node))
            place.update({node: i - (len(layer) - 1) / 2 for i, node in enumerate(layer)})
    return tuple(tuple(layer) for layer in layers)
