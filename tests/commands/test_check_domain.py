"""check-domain: a table, an exit code, a picture."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from resync_robot import cli
from resync_robot.commands.check_domain import with_robot
from resync_robot.sim_training.domains import find_domain
from tests.domains import PUCK_DOMAIN, PUCK_FILE


def test_the_guide_s_domain_passes_and_is_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sheet = tmp_path / "sheet.png"
    assert cli.main(["check-domain", str(PUCK_FILE), "--worlds", "2", "--sheet", str(sheet)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert all(line.startswith("ok ") for line in lines[:-1]) and lines[-1] == f"Contact sheet: {sheet}"
    drawn = np.asarray(Image.open(sheet))
    assert drawn.shape[0] > 256 * len(PUCK_DOMAIN.scenarios) and drawn.shape[1] > 4 * 480


def test_a_broken_one_ends_with_code_2_and_every_fault(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "broken.py"
    text = PUCK_FILE.read_text("utf-8").replace('"Holding": holding, "At": at', '"Holding": holding')
    file.write_text(text.replace("horizon=30", "horizon=0"))
    assert cli.main(["check-domain", str(file), "--json"]) == 2
    told = json.loads(capsys.readouterr().out)
    assert not told["healthy"]
    assert [f["detail"] for f in told["findings"]] == [
        "predicate At has no classifier",
        "stage OpenDoor has a horizon of 0",
        "stage Shove has a horizon of 0",
    ]


def test_it_writes_over_no_file_of_another_kind(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    kept = tmp_path / "kept.png"
    kept.write_text("mine")
    assert cli.main(["check-domain", str(PUCK_FILE), "--sheet", str(kept)]) == 2
    assert kept.read_text() == "mine" and "it is left as it is" in capsys.readouterr().err


def test_a_domain_of_the_arm_is_looked_at_with_the_arm_and_no_other_one_is_given_it() -> None:
    for name in ("cornered-insertion-s", "cornered-insertion-l"):
        domain = with_robot(find_domain(name))
        assert domain.embodiment is not None
        assert {s.name for s in domain.embodiment.skills()} == {o.name for o in domain.operators}
    assert with_robot(PUCK_DOMAIN) is PUCK_DOMAIN
    without = replace(PUCK_DOMAIN, embodiment=None)
    assert with_robot(without) is without


@pytest.mark.slow
def test_cornered_insertion_l_keeps_the_contract(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["check-domain", "cornered-insertion-l", "--worlds", "2", "--json"]) == 0
    found = {f["name"]: f for f in json.loads(capsys.readouterr().out)["findings"]}
    assert found["given model: free"]["status"] == found["given model: l0"]["status"] == "ok"
    assert "box" in found["given model: l0"]["detail"]
