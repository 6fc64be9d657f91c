from __future__ import annotations

import pytest

from resync_robot.core.symbols import Operator, Predicate, Variable
from resync_robot.core.vocabulary import BLOCK, BOX, ROBOT
from resync_robot.learning.dataset import merged_dataset
from resync_robot.learning.effect_vectors import (
    candidate_from_json,
    candidate_to_json,
    measured_effects,
    stated_effects,
)
from resync_robot.learning.effects import Attempts, Candidate, Effect
from tests.learning.toy import BOX_0, ON, ROBOT_0, Toy

SIGNATURES = {"Pick": (ROBOT, BLOCK), "Insert": (ROBOT, BLOCK, BLOCK), "Recover": (ROBOT, BLOCK, BOX)}
CANDIDATES = [
    Candidate((BLOCK, BOX), (Effect("Pick", (1, None), -1), Effect("Recover", (1, 2), 1))),
    Candidate((BLOCK, BOX), (Effect("Recover", (1, 2), 1),), Attempts("Insert", (2, None))),
    Candidate((BLOCK, BLOCK), (Effect("Insert", (1, 2), 1), Effect("Insert", (2, 1), -1))),
]


@pytest.mark.parametrize("candidate", CANDIDATES, ids=str)
def test_an_effect_vector_survives_a_record(candidate: Candidate) -> None:
    assert candidate_from_json(candidate_to_json(candidate), candidate.types, SIGNATURES) == candidate


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ({}, "no field 'effects'"),
        ({"effects": {"Fly": [[[1], 1]]}}, "no parameters of Fly"),
        ({"effects": {"Recover": [[[0, 2], 1]]}}, "no parameters of Recover"),
        ({"effects": {"Recover": [[[1, None], 1]]}}, "no parameters of Recover"),
        ({"effects": {"Recover": [[[1, 2], 0]]}}, "a sign, 1 or -1"),
        ({"effects": {"Recover": [[1, 2], 1]}}, "should be of type list"),
        ({"effects": {"Recover": [[1, 1]]}}, "no parameters of Recover"),
        ({"effects": {}, "attempts": {"skill": "Pick"}}, "'attempts' has no field 'slots'"),
        ({"effects": {}, "attempts": {"skill": "Pick", "slots": [7, None]}}, "no parameters of Pick"),
    ],
)
def test_a_record_that_holds_no_effect_vector_is_refused(data: dict[str, object], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        candidate_from_json(data, (BLOCK, BOX), SIGNATURES)


def test_operators_state_effects() -> None:
    r, b, x = Variable("?r", ROBOT), Variable("?b", BLOCK), Variable("?x", BOX)
    free = Predicate("Free", (BLOCK, BOX))
    recover = Operator("Recover", (r, b, x), add=frozenset({free(b, x)}))
    jam = Operator("Jam", (x, b), delete=frozenset({free(b, x)}))
    assert stated_effects(free, [recover, jam]) == [Effect("Recover", (1, 2), 1), Effect("Jam", (1, 0), -1)]


def test_data_show_the_effects_on_a_known_predicate() -> None:
    """Of every argument, and of all objects of a type that the skill does not mention."""
    toy, b = Toy(0, noise=False), (BLOCK("b0"), BLOCK("b1"))
    tries = [("Pick", (ROBOT_0, b[0])), ("Insert", (ROBOT_0, *b))]
    runs = [toy.record(toy.scene(2, lambda i: "free"), tries, frozenset(), "test") for _ in range(4)]
    data = merged_dataset([runs], ("Recover",), SIGNATURES)
    height = [data.state_at(m)[b[0]][2] for m in range(len(data.moments))]
    on = [frozenset({ON(*b)}) if 0.06 < z < 0.1 else frozenset() for z in height]
    assert measured_effects(data, on, ON, "Insert") == [Effect("Insert", (1, 2), 1)]
    assert measured_effects(data, on, ON, "Pick") == []
    inside = Predicate("Inside", (BLOCK, BOX))
    held = [frozenset() if z > 0.2 else frozenset({inside(b[0], BOX_0)}) for z in height]
    assert measured_effects(data, held, inside, "Pick") == [Effect("Pick", (1, None), -1)]
