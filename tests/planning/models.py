"""The model that Cornered Insertion-S should end with, written by hand for the tests of the planner."""

from __future__ import annotations

from resync_robot.core.symbols import Atom, Object, Operator, Predicate, Variable
from resync_robot.core.vocabulary import BLOCK, BOX, ROBOT

HAND_EMPTY = Predicate("HandEmpty", (ROBOT,))
HOLDING = Predicate("Holding", (ROBOT, BLOCK))
ON = Predicate("On", (BLOCK, BLOCK))
FREE = Predicate("Free", (BLOCK,))
PREDICATES = (HAND_EMPTY, HOLDING, ON, FREE)

R, B, B0, B1 = Variable("?r", ROBOT), Variable("?b", BLOCK), Variable("?b0", BLOCK), Variable("?b1", BLOCK)
X = Variable("?x", BOX)
PICK = Operator(
    "Pick", (R, B), frozenset({HAND_EMPTY(R), FREE(B)}), frozenset({HOLDING(R, B)}), frozenset({HAND_EMPTY(R)})
)
INSERT = Operator(
    "Insert",
    (R, B0, B1),
    frozenset({HOLDING(R, B0), FREE(B1)}),
    frozenset({ON(B0, B1), HAND_EMPTY(R)}),
    frozenset({HOLDING(R, B0)}),
)
RECOVER = Operator("Recover", (R, B, X), frozenset({HAND_EMPTY(R)}), frozenset({FREE(B)}))
OPERATORS = (PICK, INSERT, RECOVER)

ROBOT_0, BOX_0 = ROBOT("robot"), BOX("box")
BLOCKS = tuple(BLOCK(f"b{i}") for i in range(4))


def scene(blocks: int, cornered: set[int]) -> tuple[list[Object], frozenset[Atom]]:
    """Objects and atoms with an empty hand and every block free but the cornered ones."""
    used = BLOCKS[:blocks]
    atoms = {HAND_EMPTY(ROBOT_0)} | {FREE(b) for i, b in enumerate(used) if i not in cornered}
    return [ROBOT_0, BOX_0, *used], frozenset(atoms)
