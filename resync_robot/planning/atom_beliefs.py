"""What is believed of the ground atoms: a probability for each, updated by sight and by the outcomes of skills.

    log-odds of an atom = log-odds by the latest look + evidence of outcomes

Looks do not add up. A learned classifier that is wrong about an object is wrong at every look, so the latest one
counts, and as far as the classifier is to be trusted. What does tell that it is wrong are outcomes, and they do add up:

- A skill failed: one of its learned preconditions may have been false. Each is blamed as far as the others, and bad
  luck, do not explain the failure.
- A skill succeeded: its preconditions held, most likely.
- What a skill mostly fails without, though nothing says that it needs it, is told by the skill's outcome as well.
- A step ran that brings an atom about: the atom is expected from then on, the more if the skill says that it is done.
  Where it looks false again and again, it is the classifier that is wrong.

Given predicates are believed as they are seen.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from resync_robot.core.skill import SkillEnd, SkillOutcome
from resync_robot.core.symbols import Atom, Atoms, GroundOperator, Object
from resync_robot.planning.abstract import HOLDS
from resync_robot.planning.outcome_costs import OutcomeCosts


@dataclass(frozen=True, kw_only=True)
class BeliefSettings:
    """How much looks and outcomes say."""

    certain: float = 0.85
    """Probability from which on plans count on an atom. With the errors of the shipped library's classifiers, an atom
    is certain that holds in nine of ten samples of the poses."""
    error: float = 0.05
    """Probability that a learned classifier is wrong about an object, where the library tells no held-out error."""
    least_error: float = 0.01
    """The least such probability, however few errors there were in training: the world is another one."""
    lucky: float = 0.1
    """Probability that a skill succeeds although a learned precondition is false."""
    word: float = 0.75
    """Probability that a skill is done that says so."""
    gave_up: float = 0.75
    """Share of the usual success of a skill where it gave up: some of those attempts have done enough."""
    most: float = 0.95
    """Outcomes alone raise no probability above this, and lower none below 1 minus it: attempts at one object are not
    independent of each other."""
    memory: float = 0.5
    """Share of the evidence (in log-odds) about an object that is left once a look shows that it has changed."""


class AtomBeliefs:
    """A probability for each ground atom.

    Args:
        learned: name of a learned predicate -> held-out error of its classifier; None where nobody measured it.
        costs: how often steps succeed whose preconditions hold.
    """

    def __init__(
        self,
        learned: Mapping[str, float | None],
        costs: OutcomeCosts | None = None,
        settings: BeliefSettings | None = None,
    ) -> None:
        self._settings, self._costs = settings or BeliefSettings(), costs or OutcomeCosts()
        least, usual = self._settings.least_error, self._settings.error
        self._errors = {name: max(least, usual if error is None else error) for name, error in learned.items()}
        self._seen: dict[Atom, float] = {}
        self._evidence: dict[Atom, float] = {}
        """Log-odds that outcomes add, of learned atoms; 0 where missing."""

    def perceived(self, probabilities: Mapping[Atom, float]) -> None:
        """Take in a look: every ground atom with the probability that it holds, by sight alone."""
        turned = {a for a, p in probabilities.items() if a in self._seen and (p > HOLDS) != (self._seen[a] > HOLDS)}
        changed = {o for atom in turned for o in atom.args}
        self._seen = dict(probabilities)
        for atom, evidence in list(self._evidence.items()):
            self._set(atom, evidence * (1.0 if changed.isdisjoint(atom.args) else self._settings.memory))

    def attempted(self, step: GroundOperator, outcome: SkillOutcome, probabilities: Mapping[Atom, float]) -> bool:
        """Take in how a step went, and the look after it.

        Returns:
            Whether its effects came true, as far as can be told.
        """
        before = {a: self.probability(a) for a in step.preconditions}
        there = {o for atom in self._seen for o in atom.args if isinstance(o, Object)}
        success = self._costs.success(step, self._costs.circumstances(self.certain(), there))
        self.perceived(probabilities)
        self._expect(step, outcome, success)
        certain = self.certain()
        came_true = step.add <= certain and not step.delete & certain
        self._blame(before, success, came_true, step)
        self._tell_circumstances(came_true, step)
        return came_true

    def _expect(self, step: GroundOperator, outcome: SkillOutcome, success: float) -> None:
        """What the step brings about is so with the probability of its success, given its word, or was so before."""
        for atom in (step.delete | step.swept) - step.add:
            self._evidence.pop(atom, None)
        if outcome.ending in (SkillEnd.REFUSED, SkillEnd.NEEDLESS):
            return
        # How often it succeeds in practice says little of an attempt that gave up.
        s = self._settings
        brought, trust = (success, s.word / (1 - s.word)) if outcome.done else (success * s.gave_up, 1.0)
        for atom in self._learned(step.add):
            odds = math.exp(self._evidence.get(atom, 0.0))
            odds = (odds + brought) / (1 - brought) * trust
            self._set(atom, math.log(odds))

    def _blame(self, before: Mapping[Atom, float], success: float, came_true: bool, step: GroundOperator) -> None:
        """Bayes' rule for each learned precondition that the step leaves alone: how likely was this if it was true, and
        if it was not?"""
        lucky = self._settings.lucky
        for atom in self._learned(before.keys() - step.add - step.delete - step.swept):
            others = math.prod(p for a, p in before.items() if a != atom)
            well = success * others + lucky * (1 - others)
            ratio = well / lucky if came_true else (1 - well) / (1 - lucky)
            self._set(atom, self._evidence.get(atom, 0.0) + math.log(ratio))

    def _tell_circumstances(self, came_true: bool, step: GroundOperator) -> None:
        """Bayes' rule for what the success of the step hangs on by experience, beside its preconditions."""
        hangs_on = self._costs.with_and_without(step)
        for atom in self._learned(hangs_on.keys() - step.preconditions - step.add - step.delete - step.swept):
            if_true, if_false = hangs_on[atom]
            ratio = if_true / if_false if came_true else (1 - if_true) / (1 - if_false)
            self._set(atom, self._evidence.get(atom, 0.0) + math.log(ratio))

    def _set(self, atom: Atom, evidence: float) -> None:
        """Keep it, but let outcomes not outweigh sight beyond measure."""
        sight, most = self._sight(atom), _log_odds(self._settings.most)
        self._evidence[atom] = min(max(evidence, min(0.0, -most - sight)), max(0.0, most - sight))

    def _learned(self, atoms: Iterable[Atom]) -> list[Atom]:
        return sorted(a for a in atoms if a.predicate.name in self._errors)

    def _sight(self, atom: Atom) -> float:
        """Log-odds of a learned atom by the latest look, as its classifier may be wrong."""
        seen, error = self._seen.get(atom, 0.0), self._errors[atom.predicate.name]
        return _log_odds(seen * (1 - error) + (1 - seen) * error)

    def probability(self, atom: Atom) -> float:
        """That the atom holds; 0 for one that no look spoke of."""
        if atom.predicate.name not in self._errors or atom not in self._seen:
            return self._seen.get(atom, 0.0)
        return 1 / (1 + math.exp(-self._sight(atom) - self._evidence.get(atom, 0.0)))

    def certain(self) -> Atoms:
        """The atoms that plans count on."""
        return frozenset(a for a in self._seen if self.probability(a) >= self._settings.certain)

    def likely(self) -> dict[Atom, float]:
        """The other atoms that a plan may count on where the certain ones are not enough, with their probabilities:
        those that all there is to tell speaks for, or at least the looks."""
        found = {a: self.probability(a) for a, seen in sorted(self._seen.items())}
        return {a: p for a, p in found.items() if p < self._settings.certain and (p >= HOLDS or self._seen[a] >= HOLDS)}

    def doubted(self) -> dict[Atom, float]:
        """Every learned atom that is not certain, with its probability."""
        found = {a: self.probability(a) for a in self._learned(self._seen)}
        return {a: p for a, p in found.items() if p < self._settings.certain}

    def shown(self) -> dict[Atom, float]:
        """Every atom with its probability, for recordings: of those that are not certain at most `HOLDS`, so that what
        is above is what plans count on."""
        s = self._settings
        found = {a: self.probability(a) for a in self._seen}
        return {a: p if p >= s.certain else min(p, HOLDS) for a, p in found.items()}


def _log_odds(p: float) -> float:
    return math.log(p / (1 - p))
