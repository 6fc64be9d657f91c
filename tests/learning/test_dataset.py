"""Which failures say of what they came."""

from __future__ import annotations

import pytest

from resync_robot.core.state import State
from resync_robot.core.symbols import Type
from resync_robot.core.trajectory import Trajectory, Transition
from resync_robot.learning.dataset import ATTEMPT, Dataset, Run, Step, merged_dataset, without_unclear

CUP = Type("cup")(name="a")
MENDED, NOT = Step("Fill", (CUP,), 0, 1, "Wipe"), Step("Fill", (CUP,), 0, 1)


def run(stage: int, source: str) -> Run:
    return Run((), (MENDED, NOT), 0, frozenset(), False, source, (CUP,), stage)


def test_what_failed_in_dreams_of_several_causes_and_was_not_mended_says_nothing() -> None:
    runs = (run(1, "before1@0"), run(2, "before1@0 before2@1"), run(2, ATTEMPT), run(3, "after1@0 before3@0"))
    clear = without_unclear(Dataset((), (), runs, {}))
    assert [r.failures for r in clear.runs] == [(MENDED, NOT), (MENDED,), (MENDED, NOT), (MENDED,)]
    assert without_unclear(clear) == clear


@pytest.mark.parametrize(
    ("lived", "mended"),
    [
        ("Fill! Wipe Fill", ["Wipe"]),
        ("Fill! Wipe Fill!", ["", ""]),
        ("Fill! Wipe", [""]),
        ("Fill! Wipe! Fill", ["", ""]),
        ("Fill! Wipe Fill! Dry Fill", ["", "Dry"]),
        ("Fill! Wipe Dry Fill", ["Wipe"]),
        ("Wipe! Wipe Fill", [""]),
    ],
)
def test_a_failure_is_mended_where_the_next_attempt_succeeds_and_not_where_its_recovery_says_so(
    lived: str, mended: list[str]
) -> None:
    state = State({})
    steps = tuple(Transition(state, w.rstrip("!"), (CUP,), state, not w.endswith("!")) for w in lived.split())
    signatures = dict.fromkeys(("Fill", "Wipe", "Dry"), (CUP.type,))
    (run,) = merged_dataset([[Trajectory(steps, frozenset(), True, "dream")]], ("Wipe", "Dry"), signatures).runs
    assert [f.mended_by for f in run.failures] == mended
