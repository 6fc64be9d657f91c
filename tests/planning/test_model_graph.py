"""A model as a graph in layers, from what holds anyway to what comes last."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from resync_robot.core.symbols import SE2, Operator, Predicate, Type, Variable
from resync_robot.planning.model_graph import ModelGraph, Node, graph_of
from resync_robot.sim_training.domains.cornered_insertion_l.domain import CORNERED_INSERTION_L as LARGE
from resync_robot.sim_training.domains.cornered_insertion_s.domain import INSERT, PICK

THING = Type("thing", SE2, pose=SE2)
X = Variable("?x", THING)
PREDICATES = [Predicate(f"P{i}", (THING,)) for i in range(6)]
some = st.sets(st.sampled_from(PREDICATES), max_size=3)


def levels(graph: ModelGraph) -> dict[str, int]:
    return {node.name: layer for node, (_, layer) in graph.places().items()}


def test_edges_lead_from_what_is_needed_over_the_skill_to_what_it_makes_true() -> None:
    graph = graph_of((PICK, INSERT), {"Holding"})
    assert [[n.name for n in layer] for layer in graph.layers] == [
        ["HandEmpty"],
        ["Pick"],
        ["Holding"],
        ["Insert"],
        ["On"],
    ]
    assert {n.name for layer in graph.layers for n in layer if n.skill} == {"Pick", "Insert"}
    assert [n.name for layer in graph.layers for n in layer if n.learned] == ["Holding"]
    assert {(a.name, b.name) for a, b in graph.edges} == {
        ("HandEmpty", "Pick"),
        ("Pick", "Holding"),
        ("Holding", "Insert"),
        ("Insert", "On"),
        ("Insert", "HandEmpty"),
    }


def test_what_comes_first_stands_above() -> None:
    level = levels(graph_of(LARGE.operators, ()))
    chain = [
        "LidOn",
        "RemoveLid",
        "LidOff",
        "Pick",
        "Holding",
        "Insert",
        "On",
        "PickTower",
        "HoldingTower",
        "PlaceTower",
    ]
    assert sorted(chain, key=level.__getitem__) == chain
    assert level["OpenDrawer"] < level["DrawerOpen"] < level["PlaceTower"] < level["In"]


@given(st.lists(st.tuples(some, some), min_size=1, max_size=6))
def test_whatever_the_model_each_name_has_a_place_of_its_own_below_what_first_makes_it_true(
    skills: list[tuple[set[Predicate], set[Predicate]]],
) -> None:
    operators = [
        Operator(f"S{i}", (X,), frozenset(p(X) for p in needs), frozenset(p(X) for p in makes), frozenset())
        for i, (needs, makes) in enumerate(skills)
    ]
    graph = graph_of(operators, ())
    places = graph.places()
    assert len(set(places.values())) == len(places) == sum(map(len, graph.layers))
    assert {n.name for n in places} == {
        *(o.name for o in operators),
        *(p.name for needs, makes in skills for p in needs | makes),
    }
    for layer in graph.layers:
        assert len({node.skill for node in layer}) == 1
    for needed, skill in ((a, b) for a, b in graph.edges if b.skill):
        assert places[needed][1] < places[skill][1]
    assert graph_of(reversed(operators), ()) == graph


def test_a_skill_may_be_called_as_a_predicate_is() -> None:
    p = Predicate("Open", (THING,))
    graph = graph_of([Operator("Open", (X,), frozenset(), frozenset({p(X)}), frozenset())], {"Open"})
    assert graph.layers == ((Node("Open", True, True),), (Node("Open", False, True),))
