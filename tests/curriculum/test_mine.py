"""Mining in a domain with a robot of its own: what is kept, read again, and refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from resync_robot.core.errors import TrainingError
from resync_robot.curriculum import mine as mining
from resync_robot.curriculum.context import Known
from resync_robot.curriculum.mine import FAILURES, Mined, mine
from resync_robot.curriculum.run_folder import RunFolder
from resync_robot.curriculum.stage_folder import StageFolder
from resync_robot.planning.skill_run import run_skill
from resync_robot.sim_training.domains import find_domain

PUCKS = str(Path(__file__).parents[2] / "docs" / "puck_behind_a_door.py")
DOMAIN = find_domain(PUCKS)
STAGE = DOMAIN.stages[0]


def _mine(folder: StageFolder, count: int = 6, scenario: str = "door") -> Mined:
    stage = replace(STAGE, scenario=scenario)
    return mine(DOMAIN, stage, folder, Known(domain=DOMAIN.spec, rig=None), range(500, 540), count, 1, lambda *_: None)


def test_failures_are_kept_and_read_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = StageFolder(RunFolder(tmp_path), 1, STAGE.recovery)
    mined = _mine(folder)
    assert mined.explanation.skill == "Fetch" and [o.name for o in mined.explanation.culprits] == ["door"]
    assert len(mined.starts) == 6 and all(s.state != s.task.initial for s in mined.starts)
    assert folder.figures("mine")["tasks"] >= 6

    def nobody(*_: object) -> None:
        raise AssertionError("what was mined is not mined again")

    monkeypatch.setattr(mining, "parallel_map", nobody)
    again = _mine(folder)
    assert again.explanation == mined.explanation
    for cause, gaussian in mined.before.items():
        np.testing.assert_array_equal(again.before[cause].mean, gaussian.mean)
    assert [s.state for s in again.starts] == [s.state for s in mined.starts]


@pytest.mark.parametrize("damage", ["cut", "other", "empty"])
def test_a_damaged_file_is_named_with_its_mend(tmp_path: Path, damage: str) -> None:
    folder = StageFolder(RunFolder(tmp_path), 1, STAGE.recovery)
    _mine(folder)
    path = folder.path / FAILURES
    saved = json.loads(path.read_text(encoding="utf-8"))
    del saved["states"][0]["failed"]
    texts = {"cut": path.read_text(encoding="utf-8")[:200], "other": json.dumps(saved), "empty": ""}
    path.write_text(texts[damage], encoding="utf-8")
    with pytest.raises(TrainingError, match=r"failures\.json") as caught:
        _mine(folder)
    assert "remove it, and add --resume" in caught.value.fix
    path.unlink()
    assert len(_mine(folder).starts) == 6


def test_a_scenario_that_hardly_fails_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TrainingError, match=r"0 of 40 tasks of open failed, 6 failures are needed"):
        _mine(StageFolder(RunFolder(tmp_path), 1, STAGE.recovery), scenario="open")


def test_the_same_failure_of_something_else_is_kept_under_its_name(tmp_path: Path) -> None:
    """On its way to another cargo the car is caught in the same ice."""
    icy = find_domain("icy-transport")
    folder = StageFolder(RunFolder(tmp_path), 1, "IcyDrive")
    known = Known(domain=icy.spec, rig=None)
    mined = mine(icy, icy.stages[0], folder, known, range(500, 600), 30, 1, lambda *_: None)
    about, saved = mined.explanation, json.loads((folder.path / FAILURES).read_text(encoding="utf-8"))
    assert about.skill == "GoToPickObject" and saved["likewise"]
    assert len(mined.starts) == len(saved["states"]) + len(saved["likewise"])
    model = known.open().model
    for start in mined.starts:
        simulator = icy.embodiment.simulate(start.task)
        assert simulator.reset(start.state)
        assert not run_skill(simulator, model.skill(about.skill).ground(about.objects)).done
        assert set(about.culprits) <= set(simulator.contacts())
    likewise = mined.starts[len(saved["states"])]
    names = saved["likewise"][0]["names"]
    assert {names[n] for n in names} == set(names) and about.relevant.name in names
    back = {
        o: next(p for p in likewise.task.objects if p.name == names.get(o.name, o.name)) for o in likewise.task.objects
    }
    assert likewise.task.renamed(back).renamed(back) == likewise.task
