"""Wandering among blocks that nothing obstructs: what is begun and not finished is seen, and what fails is not told."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np

from resync_robot.core.skill import GroundSkill
from resync_robot.core.state import State
from resync_robot.core.symbols import Atom, GroundOperator, Object, Operator, Predicate, Type, Variable
from resync_robot.core.trajectory import Trajectory, Transition
from resync_robot.learning.dataset import ATTEMPT, merged_dataset
from resync_robot.learning.operators import swept
from resync_robot.library_models import initial_model
from resync_robot.sim_training.domains import find_domain
from resync_robot.sim_training.wandering import EARLY, LONGEST, drawn, situation, wander

DOMAIN = find_domain("blocked-stacking")
MODEL = initial_model(DOMAIN, None)
OPERATORS: dict[str, Operator] = {o.name: o for o in DOMAIN.operators}


def _walk(seed: int, **limits: float) -> tuple[Transition, ...]:
    """One in which the hand goes to the first block instead of recovering.

    Args:
        limits: of the skill that does so, beside its own.
    """
    assert DOMAIN.free is not None and DOMAIN.embodiment is not None
    task = DOMAIN.free(np.random.default_rng(seed), seed, {})
    world = DOMAIN.embodiment.simulate(task)
    assert world.reset(task.initial)
    robot, block = OPERATORS["ReachToGrasp"].parameters

    def reach(state: State) -> GroundSkill:
        return replace(MODEL.skill("ReachToGrasp"), **limits).ground(
            (state.of_type(robot.type)[0], state.of_type(block.type)[0])
        )

    return wander(world, MODEL, task, reach, {"Punch"}, np.random.default_rng(seed))


WALKS = tuple(_walk(seed) for seed in range(48))


def test_each_step_begins_where_the_one_before_it_ended_and_was_possible() -> None:
    for walk in WALKS:
        assert len(walk) <= LONGEST and all(t.succeeded for t in walk)
        assert all(a.after == b.before for a, b in itertools.pairwise(walk))
        for t in walk:
            operator = OPERATORS[t.skill].ground(t.objects)
            assert operator.applicable(MODEL.abstraction.true_atoms(t.before))
    assert len({t.skill for walk in WALKS for t in walk}) >= 3


def test_the_same_seed_wanders_the_same_way() -> None:
    assert [(t.skill, t.objects) for t in _walk(5)] == [(t.skill, t.objects) for t in WALKS[5]]


def test_what_fails_is_taken_back_and_something_else_is_done() -> None:
    """The recovery runs out of its time on the way, in each of them."""
    in_vain = [_walk(seed, time_limit_s=0.1) for seed in range(12)]
    assert min(len(walk) for walk in in_vain) > EARLY, "so each of them has gone on after it"
    for walk in in_vain:
        assert all(a.after == b.before for a, b in itertools.pairwise(walk))


def test_what_was_not_done_in_such_a_situation_comes_first() -> None:
    """Each skill as often, however many objects it could be done to; else a drawer is opened and closed for ever."""
    rng, nothing = np.random.default_rng(0), frozenset[Atom]()
    hand, drawer = Object("h", Type("hand", ())), Object("d", Type("drawer", ()))
    blocks = [Object(f"b{i}", Type("block", ())) for i in range(8)]
    steps = [_step("Open", hand, drawer), *(_step("Pick", hand, b) for b in blocks)]
    first = [drawn(steps, nothing, set(), rng).name for _ in range(200)]
    assert 70 < first.count("Open") < 130
    seen = {situation(steps[0], nothing)}
    assert {drawn(steps, nothing, seen, rng).name for _ in range(50)} == {"Pick"}
    on = Predicate("On", (blocks[0].type, blocks[0].type))(blocks[0], blocks[1])
    seen |= {situation(steps[3], nothing)}
    assert {str(drawn(steps, frozenset({on}), seen, rng)) for _ in range(80)} == {str(steps[1]), str(steps[2])}
    seen |= {situation(s, nothing) for s in steps}
    assert len({str(drawn(steps, nothing, seen, rng)) for _ in range(200)}) == len(steps)


def test_a_situation_does_not_depend_on_names() -> None:
    block, hand = Type("block", ()), Type("hand", ())
    on, free = Predicate("On", (block, block)), Predicate("Free", (hand,))
    h, a, b, c = Object("h", hand), Object("a", block), Object("b", block), Object("c", block)

    def picking(upper: Object, lower: Object) -> object:
        return situation(_step("Pick", h, upper), frozenset({on(upper, lower), free(h)}))

    assert picking(a, b) == picking(c, a)
    assert picking(a, b) != situation(_step("Pick", h, b), frozenset({on(a, b), free(h)}))
    assert picking(a, b) != situation(_step("Lift", h, a), frozenset({on(a, b), free(h)}))
    assert picking(a, b) == situation(_step("Pick", h, a), frozenset({on(a, b), on(b, c), free(h)}))


def _step(name: str, *objects: Object) -> GroundOperator:
    nothing = frozenset[Atom]()
    parameters = tuple(Variable(f"?{i}", o.type) for i, o in enumerate(objects))
    return Operator(name, parameters, nothing, nothing, nothing).ground(objects)


def test_it_shows_that_a_hand_is_ready_for_one_block_at_a_time() -> None:
    """No plan reaches for a block to reach for another one then, so no demonstration shows it."""
    told = [Trajectory(walk, frozenset(), False, ATTEMPT) for walk in WALKS]
    signatures = {o.name: tuple(v.type for v in o.parameters) for o in DOMAIN.operators}
    dataset = merged_dataset([told], (), signatures)
    truth = [MODEL.abstraction.true_atoms(dataset.state_at(m)) for m in range(len(dataset.moments))]
    found = swept(dataset, truth, DOMAIN.predicates, {o.name: o.parameters for o in DOMAIN.operators})
    # And that it lets go of what it holds, to grasp something, and so is not ready to place it.
    ended = {"ReadyGrasp(?r, ?any1)", "Holding(?r, ?any1)", "ReadyPlace(?r, ?any1, ?any2)"}
    assert {str(a) for a in found["ReachToGrasp"]} == ended
