"""Whether the libraries of several training seeds hold the same operators, up to the names of what they discovered.

    python tests/benchmarks/same_model.py LIBRARY LIBRARY ...

Each is compared with the first one. Where no renaming makes all operators equal, those that differ under the best one
are printed, with the names of the first library. The code is 1 then.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from itertools import permutations
from pathlib import Path

from resync_robot.core.library import load_library
from resync_robot.core.symbols import Operator, Predicate
from resync_robot.library_models import known_concepts
from resync_robot.planning.pddl import operator_to_pddl
from resync_robot.sim_training.domains import find_domain

Model = dict[str, Operator]


def model_of(folder: Path) -> tuple[Model, list[Predicate]]:
    """The operators of a library, and the predicates that it discovered."""
    library = load_library(folder)
    domain = find_domain(library.domain)
    concepts = known_concepts(domain, library)
    return {o.name: o for o in concepts.operators}, sorted(set(concepts.predicates) - set(domain.predicates))


def renamings(own: list[Predicate], first: list[Predicate]) -> Iterator[dict[str, Predicate]]:
    """Every way to call discovered predicates as the first library calls those of the same types."""
    for chosen in permutations(first) if len(own) == len(first) else ():
        if all(a.types == b.types for a, b in zip(own, chosen, strict=True)):
            yield dict(zip((p.name for p in own), chosen, strict=True))


def differences(own: tuple[Model, list[Predicate]], first: tuple[Model, list[Predicate]]) -> list[str]:
    """The names of the operators that differ, and both of each, in PDDL; empty where none does."""
    found: list[tuple[int, list[str]]] = []
    for names in renamings(own[1], first[1]):
        model = {n: o.renamed(names) for n, o in own[0].items()}
        differ = sorted(n for n in {*model, *first[0]} if model.get(n) != first[0].get(n))
        lines = [operator_to_pddl(m[n]) if n in m else f"no {n}" for n in differ for m in (first[0], model)]
        found.append((len(differ), lines))
    return min(found)[1] if found else ["other predicates were discovered, by number or types"]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("libraries", type=Path, nargs="+")
    folders = parser.parse_args().libraries
    first, same = model_of(folders[0]), 1
    for folder in folders[1:]:
        found = differences(model_of(folder), first)
        same += not found
        for line in found:
            print(f"{folder}: {line}")
    print(f"the same operators up to names: {same} of {len(folders)}")
    return int(same < len(folders))


if __name__ == "__main__":
    sys.exit(main())
