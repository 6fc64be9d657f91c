"""Action costs: what a step costs, by the success that attempts like it came to.

Preconditions are sharp and experience is not: a skill whose preconditions hold still fails now and then, and more often
in some circumstances than in others. A step costs -log of its probability of success, so a cheapest plan is one that
most likely works as a whole.
"""

from __future__ import annotations

import math
import random
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from resync_robot.core.symbols import Atom, GroundOperator, Object, Predicate
from resync_robot.planning.abstract import Exists, ForAll

Count = tuple[int, int]
"""(successes, attempts)."""
WORTH_A_STEP = 1.0
"""What saves less of a step than this share of what any step costs is not brought about for its own sake. So a plan is
dearer than the cheapest by no more than that for each step."""
JITTER = 0.05
"""By how much of its cost a step is made dearer, at most, to break ties between plans."""


@dataclass(frozen=True)
class Tally:
    """How the attempts of a skill went whose preconditions held, by an atom about some of its arguments, or about all
    there is.

    The tallies of one skill count the same attempts.

    Attributes:
        predicate: of some arguments, or of none.
        arguments: positions of these among those of the skill.
        held: the attempts before which the atom held.
        otherwise: the rest.
        form: what `predicate` follows from where the model does not know it: "it holds something", "all are ready".
    """

    predicate: Predicate
    arguments: tuple[int, ...]
    held: Count
    otherwise: Count
    form: Exists | ForAll | None = None

    def atom(self, step: GroundOperator) -> Atom:
        return self.predicate(*(step.objects[i] for i in self.arguments))

    @property
    def total(self) -> Count:
        return self.held[0] + self.otherwise[0], self.held[1] + self.otherwise[1]


@dataclass(frozen=True, kw_only=True)
class CostSettings:
    """What is expected of a step before there is experience, and what a step costs beside its risk."""

    prior: float = 0.9
    """Probability that a step succeeds which nobody has tried."""
    weight: float = 5.0
    """How many attempts this expectation counts for; twice as many does the skill's success in all circumstances
    together where some of them are judged."""
    untried: float = 0.95
    """Probability of success where nobody tried, as a share of how the skill does on the whole."""
    step: float = 0.1
    """Cost of any step, beside its risk: one more step is worth it where it makes success more likely by a tenth."""


class OutcomeCosts:
    """Costs of steps from tallies.

    Args:
        tallies: skill name -> its tallies. Steps of skills without any cost all the same.
    """

    def __init__(
        self, tallies: Mapping[str, Sequence[Tally]] | None = None, settings: CostSettings | None = None
    ) -> None:
        self._tallies, self._settings = dict(tallies or {}), settings or CostSettings()
        self._forms = tuple(dict.fromkeys(t.form for of in self._tallies.values() for t in of if t.form is not None))
        self._sides: dict[tuple[str, tuple[Object, ...]], list[tuple[Atom, float, float]]] = {}

    def atoms(self, step: GroundOperator) -> list[Atom]:
        """What its success hangs on beside its preconditions."""
        return [atom for atom, _, _ in self._judged(step)]

    @property
    def bases(self) -> frozenset[Predicate]:
        """The predicates that `circumstances` derives others from."""
        return frozenset(form.base for form in self._forms)

    def circumstances(self, atoms: Collection[Atom], objects: Collection[Object]) -> frozenset[Atom]:
        """`atoms`, and what follows from them that steps hang on; `success` and `cost` ask for these.

        Args:
            objects: all there are.
        """
        follow = (derived for derived, bases, needed in self.derived(atoms, objects) if len(bases) >= needed)
        return frozenset(atoms).union(follow)

    def derived(
        self, atoms: Collection[Atom], objects: Collection[Object]
    ) -> Iterator[tuple[Atom, frozenset[Atom], int]]:
        """What may follow from these atoms: each with those that count towards it, and how many of them it takes."""
        by_base: dict[Predicate, list[Atom]] = {form.base: [] for form in self._forms}
        for atom in atoms:
            if atom.predicate in by_base:
                by_base[atom.predicate].append(atom)
        for form in self._forms:
            predicate, needed = form.predicate, 1
            if isinstance(form, ForAll):
                needed = math.prod(sum(o.type == form.base.types[i] for o in objects) for i in form.over)
            counted: dict[tuple[Any, ...], list[Atom]] = {} if needed or predicate.types else {(): []}
            for atom in by_base[form.base]:
                args: Any = atom.args
                counted.setdefault(form.keeps(args), []).append(atom)
            for kept, bases in counted.items():
                yield Atom(predicate, kept), frozenset(bases), needed

    def success(self, step: GroundOperator, atoms: Collection[Atom]) -> float:
        """Probability that the step succeeds where its preconditions and these `circumstances` hold.

        It is estimated from the counts under each of them, and the least favourable one decides: circumstances go
        together, so to multiply them would count the same thing several times. The prior is a beta distribution around
        how this skill does on the whole, a little lower: untried circumstances are riskier than others.
        """
        sides = self._judged(step)
        return min((held if atom in atoms else not_so for atom, held, not_so in sides), default=self._settings.prior)

    def with_and_without(self, step: GroundOperator) -> dict[Atom, tuple[float, float]]:
        """Each atom about its arguments that the step's success was counted by, with the probabilities of success where
        it holds and where it does not, whatever else does."""
        tallies = self._tallies.get(step.name, ())
        sides = zip(tallies, self._judged(step), strict=True)
        return {atom: (held, not_so) for tally, (atom, held, not_so) in sides if tally.form is None}

    def cost(self, step: GroundOperator, atoms: Collection[Atom]) -> float:
        """Of running the step where `atoms` hold; above 0."""
        return self._settings.step - math.log(self.success(step, atoms))

    def about_things(self, step: GroundOperator, atoms: Collection[Atom]) -> frozenset[Atom]:
        """Of these `circumstances` those about its own arguments that the step hangs on. What holds of something, or of
        all there is, a detour could change that has nothing to do with the step."""
        sides = zip(self._tallies.get(step.name, ()), self._judged(step), strict=True)
        return frozenset(atom for tally, (atom, _, _) in sides if tally.form is None and atom in atoms)

    def hangs_on(
        self, step: GroundOperator, objects: Collection[Object]
    ) -> list[tuple[Atom, Exists | ForAll | None, bool]]:
        """What may make the step cheaper: an atom, what it is derived by where the model does not know it, and whether
        it has to hold for that.

        Left out is what the preconditions decide, what decides nothing since something else is worse at its best, and
        what saves less than WORTH_A_STEP.
        """
        decided = self.circumstances(step.preconditions, objects)
        tallies = self._tallies.get(step.name, ())
        sides = self._judged(step)
        most = min((max(held, not_so) for _, held, not_so in sides), default=1.0)
        return [
            (atom, tally.form, held > not_so)
            for tally, (atom, held, not_so) in zip(tallies, sides, strict=True)
            if atom not in decided and math.log(most / min(held, not_so)) > WORTH_A_STEP * self._settings.step
        ]

    def least(self, step: GroundOperator) -> float:
        """No circumstances make the step cheaper than this: each of them is at its better, and the worst decides."""
        best = min((max(held, not_so) for _, held, not_so in self._judged(step)), default=self._settings.prior)
        return self._settings.step - math.log(best)

    def _judged(self, step: GroundOperator) -> list[tuple[Atom, float, float]]:
        """Of each tally of the step's skill the atom, and the probabilities of success where it holds and where not.

        A search asks for the same steps again and again."""
        key = step.name, step.objects
        if key not in self._sides:
            self._sides[key] = [
                (t.atom(step), self._posterior(step, *t.held), self._posterior(step, *t.otherwise))
                for t in self._tallies.get(step.name, ())
            ]
        return self._sides[key]

    def _whole(self, step: GroundOperator) -> Count:
        """Successes and attempts of its skill."""
        return next((tally.total for tally in self._tallies.get(step.name, ())), (0, 0))

    def _posterior(self, step: GroundOperator, won: int, tried: int) -> float:
        s, (all_won, all_tried) = self._settings, self._whole(step)
        if not all_tried:
            return s.prior
        usual = (all_won + s.weight * s.prior) / (all_tried + s.weight)
        return (won + 2 * s.weight * s.untried * usual) / (tried + 2 * s.weight)


class JitteredCosts(OutcomeCosts):
    """The same costs, but of plans that are nearly as good as each other they prefer another one for each seed."""

    def __init__(self, costs: OutcomeCosts, seed: int) -> None:
        super().__init__(costs._tallies, costs._settings)
        self._seed = seed

    def cost(self, step: GroundOperator, atoms: Collection[Atom]) -> float:
        return super().cost(step, atoms) * (1.0 + JITTER * random.Random(f"{self._seed} {step}").random())
