"""Commands on a domain that brings a robot of its own: what they run, and what has no meaning there."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from resync_robot.commands.evaluate import EvaluateConfig, evaluate
from resync_robot.core.errors import ConfigError, LibraryError
from resync_robot.core.library import load_library, save_library
from resync_robot.library_models import learned_model
from tests.pucks import DOMAIN, PUCKS, random_library


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("library") / "library"
    save_library(random_library(), path)
    return path


def test_a_library_without_an_arm_comes_back_whole(library: Path) -> None:
    loaded = load_library(library)
    assert loaded.rig_hash == "" and loaded.stages == random_library().stages
    model = learned_model(DOMAIN, None, loaded)
    assert [t.name for t in model.skill("OpenDoor").types] == ["robot", "puck", "door"]


def test_evaluate_runs_every_method(library: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "result.json"
    evaluate(
        EvaluateConfig(
            domain=PUCKS,
            library=(library,),
            methods=("resync", "rc", "initial"),
            scenarios=("open", "door"),
            episodes=2,
            workers=1,
            json=out,
        )
    )
    found = json.loads(out.read_text(encoding="utf-8"))
    successes = {(r["scenario"], r["method"]): r["successes"] for r in found["rows"]}
    assert [successes["open", m] for m in ("resync", "rc", "initial")] == [2, 2, 2]
    assert successes["door", "initial"] == 0
    assert found["provenance"]["rig"] == "" and found["provenance"]["perception"] == "oracle"
    assert "| initial | 1.00" in capsys.readouterr().out


def test_an_episode_ends_at_its_horizon(library: Path, tmp_path: Path) -> None:
    out, steps = tmp_path / "result.json", 20
    evaluate(
        EvaluateConfig(
            domain=PUCKS, library=(library,), scenarios=("open",), episodes=2, workers=1, horizon=steps, json=out
        )
    )
    episodes = json.loads(out.read_text(encoding="utf-8"))["episodes"]
    assert {(e["success"], e["end"]) for e in episodes} == {(False, "exhausted")}
    assert json.loads(out.read_text(encoding="utf-8"))["provenance"]["horizon"] == steps


@pytest.mark.parametrize(
    ("given", "option"),
    [
        ({"rig": Path("rig.toml")}, "--rig"),
        ({"perception": "camera"}, "--perception camera"),
        ({"skills": "camera"}, "--skills camera"),
        ({"worlds": "hard"}, "--worlds hard"),
        ({"physics": "reference"}, "--physics reference"),
    ],
)
def test_what_only_an_arm_has_is_refused(library: Path, given: dict[str, object], option: str) -> None:
    with pytest.raises(ConfigError, match=f"{option} is for domains of the arm"):
        evaluate(EvaluateConfig(domain=PUCKS, library=(library,), **given))  # type: ignore[arg-type]


def test_there_is_no_shipped_library_of_somebody_elses_domain() -> None:
    with pytest.raises(LibraryError, match="no library folder"):
        evaluate(EvaluateConfig(domain=PUCKS))
