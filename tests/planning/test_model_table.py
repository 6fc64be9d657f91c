"""The table of a model: one row an operator, what was learned in bold, and effects on everything said as such."""

from __future__ import annotations

from dataclasses import replace

from resync_robot.core.symbols import Variable
from resync_robot.core.vocabulary import BLOCK
from resync_robot.planning.model_table import model_table
from resync_robot.sim_training.domains.cornered_insertion_s.domain import HOLDING, INSERT, PICK


def test_each_operator_is_a_row_and_what_was_learned_is_bold() -> None:
    ready = replace(PICK.preconditions and next(iter(PICK.preconditions)).predicate, name="ReadyPick", types=(BLOCK,))
    pick = replace(PICK, preconditions=PICK.preconditions | {ready(PICK.parameters[1])})
    lines = model_table((INSERT, pick), learned=["ReadyPick"]).splitlines()
    cells = [[c.strip() for c in line.strip("|").split("|")] for line in lines]
    assert cells[0] == ["skill", "needs", "makes true", "ends"] and set(lines[1]) == {"|", "-"}
    assert cells[2] == ["Insert(r, b0, b1)", "Holding(r, b0)", "HandEmpty(r), On(b0, b1)", "Holding(r, b0)"]
    assert cells[3] == ["Pick(r, b)", "**ReadyPick**(b), HandEmpty(r)", "Holding(r, b)", "HandEmpty(r)"]
    assert len({len(line) for line in lines}) == 1


def test_what_ends_of_every_object_is_said_as_such() -> None:
    sweeping = replace(PICK, delete_all=frozenset({HOLDING(PICK.parameters[0], Variable("?any1", BLOCK))}))
    assert "Holding(r, any block)" in model_table((sweeping,))
