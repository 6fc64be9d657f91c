"""How sure a recovery has to be that it is done: as trials show."""

from __future__ import annotations

from pathlib import Path

import pytest

from resync_robot.core.library import Record
from resync_robot.curriculum import recover as recovering
from resync_robot.curriculum.context import Known
from resync_robot.curriculum.mine import Mined
from resync_robot.curriculum.recover import _as_sure_as_needed
from resync_robot.learning.learned_recovery import SURE
from resync_robot.sim_training.domains import find_domain

PUCKS = str(Path(__file__).parents[2] / "docs" / "puck_behind_a_door.py")
DOMAIN = find_domain(PUCKS)
DONE, TOO_SOON, TOO_LATE = (True, ("begun", "left")), (True, None), (False, ("begun", "left"))


@pytest.mark.parametrize(
    ("results", "expected"),
    [
        ([[DONE] * 3, [DONE] * 3, [DONE] * 3], SURE[2]),
        ([[DONE, TOO_SOON, TOO_SOON], [DONE, DONE, TOO_SOON], [DONE] * 3], SURE[2]),
        ([[DONE, DONE, TOO_SOON], [DONE] * 3, [DONE, TOO_LATE, TOO_LATE]], SURE[1]),
        ([[None] * 3, [None] * 3, [None] * 3], SURE[2]),
    ],
    ids=["all alike", "said so too soon", "grew worse", "no scene stood"],
)
def test_the_least_that_mends_most_often_is_taken(
    results: list[list[object]], expected: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried = iter(results)
    monkeypatch.setattr(recovering, "parallel_map", lambda function, jobs, context, workers: next(tried))
    record, mined = Record({"sure": 0.5}, {}), Mined(None, {}, ())
    chosen = _as_sure_as_needed(Known(domain=PUCKS, rig=None), DOMAIN.stages[0], mined, record, range(3), 1)
    assert chosen.meta["sure"] == expected
