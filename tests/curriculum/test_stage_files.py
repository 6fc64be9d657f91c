"""What a stage of training leaves is read again as it was; Gaussians of other columns are damage."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from resync_robot.core.errors import TrainingError
from resync_robot.core.files import write_json
from resync_robot.curriculum.stage_files import Mined, read_learned, read_mined
from resync_robot.learning.failures import Culprit, PairGaussian
from resync_robot.sim_training.domains import find_domain
from tests.libraries import DOMAIN, recovery_record
from tests.scenes import B0, THE_BOX

CORNERED = find_domain(DOMAIN)


def mined(columns: int) -> Mined:
    gaussian = PairGaussian(np.linspace(0.01, 0.02, columns), np.eye(columns))
    return Mined(Culprit("Pick", THE_BOX, 1), B0, gaussian, (1000, 1001), "s0")


def test_failures_are_read_as_they_were_written(tmp_path: Path) -> None:
    write_json(tmp_path / "failures.json", mined(4).to_json())
    found = read_mined(tmp_path / "failures.json", CORNERED)
    assert found is not None and found.to_json() == mined(4).to_json()
    task, again = found.tasks(CORNERED), mined(4).tasks(CORNERED)
    assert [t.initial for t in task] == [t.initial for t in again]


def test_a_gaussian_of_other_columns_than_the_relation_has_is_damage(tmp_path: Path) -> None:
    write_json(tmp_path / "failures.json", mined(3).to_json())
    with pytest.raises(TrainingError, match=r"failures\.json"):
        read_mined(tmp_path / "failures.json", CORNERED)
    saved = {**recovery_record().meta, "signature": ["robot", "block", "box"], "failed_skill": "Pick"}
    write_json(tmp_path / "recovery.json", {**saved, "after": mined(3).before.to_json()})
    assert read_learned(tmp_path / "recovery.json", tmp_path / "none", 3) is None, "the weights are missing"
    with pytest.raises(TrainingError, match=r"recovery\.json"):
        read_learned(tmp_path / "recovery.json", tmp_path / "none", 4)
