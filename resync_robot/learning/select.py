"""Which concepts to keep: hill climbing on how well planning with them explains the data (J).

Default J, in per cent: how far each demonstration is from the first plan, no plan being as far as can be, plus the
shares of failed attempts that the operators allow and of successful ones that they forbid. A demonstration that the
operators allow and that is no longer than that plan is one of the plans that are as good, and as near as can be: which
of them is found first says nothing of the concepts. Nodes are counted but buy nothing: an improvement that only saves
nodes picks junk such as "was picked before". The published J weighs node counts over several plans.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from resync_robot.core.errors import PlanningError
from resync_robot.core.symbols import Atoms, GroundOperator, Object, Operator, Predicate, Variable
from resync_robot.learning.dataset import ATTEMPT, Dataset, Run, Step
from resync_robot.learning.effects import Candidate
from resync_robot.learning.fit import Fit
from resync_robot.learning.operators import Evidence, OperatorConfig, learn_operator
from resync_robot.planning.abstract import Form, Not
from resync_robot.planning.search import Plan, plan, plans

Sequence_ = tuple[tuple[str, tuple[Object, ...]], ...]


@dataclass(frozen=True)
class Concept:
    """A predicate that selection may keep: a candidate, or a form derived from a candidate or a given predicate.

    Attributes:
        base: what it derives from in the end; itself where `form` is None.
        candidate, fit: of the base; None where that is given.
        truth: for each moment the atoms that hold.
        about: how many of its arguments are not the robot.
    """

    predicate: Predicate
    form: Form | None
    base: Predicate
    candidate: Candidate | None
    fit: Fit | None
    truth: tuple[Atoms, ...]
    evidence: Evidence
    about: int

    @property
    def preference(self) -> tuple[bool, int, bool, int, float, str]:
        """Smaller is better, among concepts that explain equally well.

        Labelled by attempts first; then effects that leave every other skill at 0, (0, +, 0) before (0, +, -): what
        the next skill destroys again is no state of the world; then positive forms, what says of more objects that it
        holds of them, for then the planner knows for which of them to bring it about, and the better fit.
        """
        candidate = self.candidate
        return (
            candidate is not None and candidate.attempts is None,
            len(candidate.effects) if candidate else 0,
            isinstance(self.form, Not),
            -self.about,
            round(self.fit.loss, 3) if self.fit else 0.0,
            self.predicate.name,
        )


@dataclass(frozen=True, kw_only=True)
class SelectConfig:
    """How J is computed.

    Attributes:
        plans: 1 for the default J, more for the published one.
        penalty: cost of a demonstration without a plan.
        min_gain: J must fall by more than this: by default, by more than what counts as equally good. A concept that
            explains no more than a handful of attempts comes and goes with the seed.
        indifference: concepts whose J is within this of the lowest explain equally well, and preference decides:
            differences of a few per cent are those of a handful of attempts, and change from seed to seed.
        max_concepts: hill climbing stops there.
    """

    plans: int = 1
    penalty: float = 100.0
    min_gain: float = 3.0
    indifference: float = 3.0
    max_concepts: int = 4
    max_nodes: int = 3_000


PAPER_J = SelectConfig(plans=8, penalty=1e5, min_gain=0.0, indifference=0.0, max_nodes=1_000)


@dataclass(frozen=True)
class Score:
    """J of a set of concepts and its parts."""

    j: float
    operators: tuple[Operator, ...]
    plan_error: float
    failures_allowed: float
    successes_forbidden: float
    nodes: float


@dataclass
class Selection:
    """The outcome of `select`.

    Attributes:
        curve: one entry for each round, with the concept taken.
    """

    concepts: tuple[Concept, ...]
    score: Score
    curve: list[dict[str, object]] = field(default_factory=list)


class Selector:
    """Scores sets of concepts on a data set, remembering every plan it has made.

    Args:
        given: for each moment the atoms of the given predicates that hold.
        given_evidence: columns of the given predicates.
        parameters: skill name -> its variables.
        fallback: given operators, used for skills that never succeeded in the data.
        swept: what each skill ends of every object there is.
    """

    def __init__(
        self,
        dataset: Dataset,
        given: Sequence[Atoms],
        given_evidence: Sequence[Evidence],
        parameters: Mapping[str, tuple[Variable, ...]],
        fallback: Mapping[str, Operator],
        config: SelectConfig,
        operator_config: OperatorConfig,
        swept: Mapping[str, Atoms] | None = None,
    ) -> None:
        self.dataset, self.given, self.given_evidence = dataset, given, given_evidence
        self.parameters, self.fallback = parameters, fallback
        self.config, self.operator_config, self.swept = config, operator_config, swept or {}
        # A single attempt aims at no goal, so it shows no way to one.
        self.demonstrations = [r for r in dataset.runs if r.solved and r.steps and r.source != ATTEMPT]
        self.failures = [s for r in dataset.runs for s in r.failures]
        self.successes = [s for r in dataset.runs for s in r.steps]
        self._memory: dict[tuple[Operator, ...], dict[tuple[object, ...], tuple[Plan, ...]]] = {}
        self._grounded: dict[tuple[Operator, tuple[Object, ...], tuple[Object, ...]], GroundOperator] = {}

    def operators(self, concepts: Sequence[Concept]) -> tuple[Operator, ...]:
        """Learned from the data with the given predicates and these concepts."""
        result = []
        for skill, variables in sorted(self.parameters.items()):
            columns = [c for e in [*self.given_evidence, *(k.evidence for k in concepts)] for c in e[skill]]
            said = self.fallback.get(skill)
            learned = learn_operator(skill, variables, columns, self.operator_config, said) or said
            if learned is not None:
                result.append(replace(learned, delete_all=self.swept.get(skill, learned.delete_all)))
        return tuple(result)

    def score(self, concepts: Sequence[Concept]) -> Score:
        """J of the given predicates with these concepts."""
        operators = self.operators(concepts)
        costs, nodes = [], []
        # Only atoms that a precondition asks for can change a plan: the rest would only defeat the memory.
        asked = {a.predicate for op in operators for a in op.preconditions}
        for run in self.demonstrations:
            atoms = self._atoms(run.first, concepts)
            wanted = {g.predicate for g in run.goal} | asked
            known = frozenset(a for a in atoms if a.predicate in wanted)
            found = self._plans(operators, run.objects, known, run.goal)
            costs.append(self._cost(found, run, self._leads_to(run, operators, known)))
            nodes.append(found[0].nodes_created if found else self.config.max_nodes)
        error = float(np.mean(costs)) if costs else self.config.penalty
        allowed = self._share_applicable(operators, self.failures, concepts)
        forbidden = 1.0 - self._share_applicable(operators, self.successes, concepts)
        j = error + (self.config.penalty * (allowed + forbidden) if self.operator_config.use_failures else 0.0)
        return Score(j, operators, error, allowed, forbidden, float(np.mean(nodes)) if nodes else 0.0)

    def _share_applicable(
        self, operators: Sequence[Operator], steps: Sequence[Step], concepts: Sequence[Concept]
    ) -> float:
        by_name = {op.name: op for op in operators}
        known = [s for s in steps if s.skill in by_name]
        met = [self._ground(by_name[s.skill], s.objects).applicable(self._atoms(s.before, concepts)) for s in known]
        return float(np.mean(met)) if met else 0.0

    def _atoms(self, moment: int, concepts: Sequence[Concept]) -> Atoms:
        return self.given[moment].union(*(k.truth[moment] for k in concepts))

    def _ground(
        self, operator: Operator, objects: tuple[Object, ...], among: tuple[Object, ...] = ()
    ) -> GroundOperator:
        key = (operator, objects, among)
        if key not in self._grounded:
            self._grounded[key] = operator.ground(objects, among)
        return self._grounded[key]

    def _leads_to(self, run: Run, operators: Sequence[Operator], atoms: Atoms) -> bool:
        """Whether a demonstration is a plan of these operators."""
        by_name = {op.name: op for op in operators}
        for step in run.steps:
            if step.skill not in by_name:
                return False
            ground = self._ground(by_name[step.skill], step.objects, run.objects)
            if not ground.applicable(atoms):
                return False
            atoms = ground.apply(atoms)
        return run.goal <= atoms

    def _plans(
        self, operators: tuple[Operator, ...], objects: tuple[Object, ...], atoms: Atoms, goal: Atoms
    ) -> tuple[Plan, ...]:
        memory = self._memory.setdefault(operators, {})
        key = (objects, atoms, goal)
        if key not in memory:
            if self.config.plans > 1:
                memory[key] = plans(operators, objects, atoms, goal, self.config.plans, max_nodes=self.config.max_nodes)
            else:
                try:
                    memory[key] = (plan(operators, objects, atoms, goal, max_nodes=self.config.max_nodes),)
                except PlanningError:
                    memory[key] = ()
        return memory[key]

    def _cost(self, found: Sequence[Plan], run: Run, allowed: bool) -> float:
        demonstrated = tuple((s.skill, s.objects) for s in run.steps)
        if self.config.plans > 1:
            return _published_cost(found, demonstrated, self.config.penalty)
        if not found:
            return self.config.penalty
        planned = tuple((s.name, s.objects) for s in found[0].steps)
        if allowed and len(demonstrated) <= len(planned):
            return 0.0
        longest = max(len(planned), len(demonstrated), 1)
        return self.config.penalty * edit_distance(planned, demonstrated) / longest


def _published_cost(found: Sequence[Plan], demonstrated: Sequence_, penalty: float) -> float:
    """sum_k q_k p_k N_k + q_{K+1} penalty, with p_k the belief that plan k is what was demonstrated."""
    p, q, cost = 1.0 - 1e-5, 1.0, 0.0
    for candidate in found:
        planned = tuple((s.name, s.objects) for s in candidate.steps)
        p_k = p * (1.0 - p) ** edit_distance(planned, demonstrated)
        cost += q * p_k * candidate.nodes_created
        q *= 1.0 - p_k
    return cost + q * penalty


def edit_distance(a: Sequence[object], b: Sequence[object]) -> int:
    """Steps to insert, delete or replace to turn one sequence into the other."""
    row = list(range(len(b) + 1))
    for i, x in enumerate(a, start=1):
        previous, row[0] = row[0], i
        for j, y in enumerate(b, start=1):
            previous, row[j] = row[j], min(row[j] + 1, row[j - 1] + 1, previous + (x != y))
    return row[-1]


def select(
    selector: Selector, pool: Sequence[Concept], progress: Callable[[str, float], None] = lambda what, share: None
) -> Selection:
    """Hill climbing: in each round add the concept that lowers J most, until none lowers it enough."""
    config = selector.config
    chosen: list[Concept] = []
    best = selector.score(chosen)
    outcome = Selection((), best, [_entry("(given)", best)])
    while len(chosen) < config.max_concepts:
        scored: list[tuple[Score, Concept]] = []
        rest = [k for k in pool if k.predicate not in {c.predicate for c in chosen}]
        for i, concept in enumerate(rest):
            progress(f"selecting concept {len(chosen) + 1}, J = {best.j:.1f}", i / len(rest))
            # What no operator asks for changes no plan.
            operators = selector.operators([*chosen, concept])
            if not any(a.predicate == concept.predicate for op in operators for a in op.preconditions):
                continue
            scored.append((selector.score([*chosen, concept]), concept))
        if not scored:
            break
        lowest = min(s.j for s, _ in scored)
        if lowest >= best.j - config.min_gain:
            break
        # Among those that explain equally well, what is preferred for other reasons wins.
        score, concept = min(
            ((s, k) for s, k in scored if s.j <= lowest + config.indifference and s.j < best.j),
            key=lambda pair: (*pair[1].preference, pair[0].j),
        )
        chosen.append(concept)
        best = score
        outcome.curve.append(_entry(concept.predicate.name, best))
    outcome.concepts, outcome.score = tuple(chosen), best
    return outcome


def _entry(name: str, score: Score) -> dict[str, object]:
    return {
        "added": name,
        "J": round(score.j, 3),
        "plan_error": round(score.plan_error, 3),
        "failures_allowed": round(score.failures_allowed, 4),
        "successes_forbidden": round(score.successes_forbidden, 4),
        "nodes": round(score.nodes, 1),
    }
