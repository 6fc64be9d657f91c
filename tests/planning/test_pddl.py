from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyperplan.grounding import ground
from pyperplan.pddl.parser import Parser

from resync_robot.core.errors import PlanningError
from resync_robot.core.symbols import Operator, Predicate, Variable
from resync_robot.core.vocabulary import BLOCK, BOX, ROBOT, TYPES
from resync_robot.planning.pddl import domain_from_pddl, domain_to_pddl, object_names, problem_to_pddl
from tests.planning.models import BLOCKS, ON, OPERATORS, PREDICATES, scene

NAMES = st.from_regex(r"[A-Za-z][A-Za-z0-9_-]{0,8}", fullmatch=True)


@st.composite
def models(draw):
    kinds = st.sampled_from(sorted(TYPES.values()))
    names = draw(st.lists(NAMES.filter(lambda n: n.lower() not in TYPES), min_size=1, max_size=7, unique_by=str.lower))
    predicates = [Predicate(n, tuple(draw(st.lists(kinds, max_size=3)))) for n in names[:4]]
    operators = []
    for name in names[4:]:
        parameters = tuple(Variable(f"?v{i}", t) for i, t in enumerate(draw(st.lists(kinds, max_size=4))))

        def atoms(parameters=parameters):
            chosen = set()
            for p in draw(st.lists(st.sampled_from(predicates), max_size=3)):
                pools = [[v for v in parameters if v.type == t] for t in p.types]
                if all(pools):
                    chosen.add(p(*(draw(st.sampled_from(pool)) for pool in pools)))
            return frozenset(chosen)

        everything = frozenset(
            p(*(Variable(f"?any{i}", t) for i, t in enumerate(p.types)))
            for p in draw(st.lists(st.sampled_from(predicates), max_size=1))
            if p.types
        )
        operators.append(Operator(name, parameters, atoms(), atoms(), atoms(), everything))
    return tuple(sorted(predicates)), tuple(sorted(operators, key=lambda o: o.name))


@given(models())
@settings(max_examples=60, deadline=None)
def test_round_trip_keeps_everything(model) -> None:
    predicates, operators = model
    text = domain_to_pddl("some-domain", TYPES.values(), predicates, operators)
    assert domain_from_pddl(text, TYPES) == (predicates, operators)
    assert domain_to_pddl("some-domain", TYPES.values(), *domain_from_pddl(text, TYPES)) == text


def test_an_effect_on_every_object_is_written_as_pddl_has_it() -> None:
    robot, other = Variable("?r", ROBOT), Variable("?any1", BLOCK)
    holding = Predicate("Holding", (ROBOT, BLOCK))
    punch = Operator("Punch", (robot,), delete_all=frozenset({holding(robot, other)}))
    text = domain_to_pddl("d", TYPES.values(), [holding], [punch])
    assert "(forall (?any1 - block) (not (Holding ?r ?any1)))" in text
    assert "(:requirements :strips :typing :conditional-effects)" in text
    assert domain_from_pddl(text, TYPES) == ((holding,), (punch,))
    for wrong, words in (
        (text.replace("(not (Holding ?r ?any1))", "(Holding ?r ?any1)"), "only 'not' may stand behind 'forall'"),
        (text.replace("(?any1 - block) ", ""), "takes variables and one effect"),
    ):
        with pytest.raises(PlanningError, match=words):
            domain_from_pddl(wrong, TYPES)


def test_pyperplan_reads_it_too() -> None:
    bare = Operator("Wait", (Variable("?r", ROBOT),))
    objects, atoms = scene(2, {0})
    parser = Parser(None, None)
    parser.domInput = domain_to_pddl("insertion", TYPES.values(), PREDICATES, [*OPERATORS, bare])
    names = object_names(objects, TYPES.values(), PREDICATES, [*OPERATORS, bare])
    parser.probInput = problem_to_pddl("p", "insertion", names, atoms, frozenset({ON(BLOCKS[1], BLOCKS[0])}))
    task = ground(parser.parse_problem(parser.parse_domain(read_from_file=False), read_from_file=False))
    assert "(on b1 b0)" in task.goals and len(task.operators) >= 6


GOOD = domain_to_pddl("insertion", TYPES.values(), PREDICATES, OPERATORS)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "expected one"),
        ("(define", "is missing"),
        (GOOD + ")", "too many"),
        ("(hello)", "must start with"),
        ("(" * 100_000, "missing"),
        ("(define (domain d) (:constants a))", ":constants"),
        (GOOD.replace("(Free ?b)", "(Fre ?b)", 1), "declared are"),
        (GOOD.replace("(Free ?b)", "(Free ?q)", 1), r"\?q is not among its parameters"),
        (GOOD.replace("(Free ?b)", "(Free ?r)", 1), "ill-typed"),
        (GOOD.replace("(Free ?block0 - block)", "(Free ?block0 - brick)"), "unknown type 'brick'"),
        (GOOD.replace("(Free ?block0 - block)", "(Free ?block0)"), "has no type"),
        (GOOD.replace("(and (Free ?b) (HandEmpty ?r))", "(and (not (Free ?b)))"), "negative precondition"),
        (GOOD.replace(":precondition", ":condition"), "must have :parameters"),
        ("(define (domain d) (:action))", "has no name"),
        ("(define (domain d) (:predicates Free))", "starts with a word"),
    ],
)
def test_malformed_text_is_one_clear_error(text: str, message: str) -> None:
    with pytest.raises(PlanningError, match=message):
        domain_from_pddl(text, TYPES)


def test_names_that_pddl_cannot_tell_apart_are_refused() -> None:
    with pytest.raises(PlanningError, match="ignores case"):
        domain_to_pddl("d", TYPES.values(), [Predicate("Free", (BLOCK,)), Predicate("free", (BLOCK,))], [])
    with pytest.raises(PlanningError, match="cannot stand in PDDL"):
        domain_to_pddl("d", TYPES.values(), [Predicate("is free?", (BLOCK,))], [])
    with pytest.raises(PlanningError, match="type 'box' and predicate 'Box' have one name"):
        domain_to_pddl("d", TYPES.values(), [Predicate("Box", (BLOCK,))], [])
    with pytest.raises(PlanningError, match="predicate 'Wait' and operator 'wait'"):
        domain_to_pddl("d", TYPES.values(), [Predicate("Wait", (BLOCK,))], [Operator("wait", ())])


def test_no_object_shares_a_name_with_anything_else() -> None:
    box, robot, on, b0, shadow, taken = BOX("box"), ROBOT("Robot"), BLOCK("on"), BLOCK("b0"), BLOCK("B0"), BLOCK("box0")
    names = object_names([box, robot, on, b0, shadow, taken], TYPES.values(), PREDICATES, OPERATORS)
    assert names[taken] == "box0" and names[b0] != names[shadow]
    assert names[box] == "box1" and names[robot] == "Robot0" and names[on] == "on0"
    used = [*TYPES, *(p.name for p in PREDICATES), *(o.name for o in OPERATORS), *names.values()]
    assert len({n.lower() for n in used}) == len(used)
    text = problem_to_pddl("p", "d", names, frozenset({ON(on, b0)}), frozenset({ON(b0, on)}))
    assert "(:init (On on0 " in text and "; box1 is the object 'box'" in text
