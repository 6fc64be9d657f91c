"""Recoveries of another domain's library: what is refused, and a run that learns no recovery of its own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from resync_robot.commands.train_sim import TrainConfig, train
from resync_robot.core.errors import ConfigError
from resync_robot.core.library import Library, Record, load_library, save_library
from resync_robot.curriculum.learn_stages import Curriculum
from resync_robot.curriculum.run_folder import RunFolder
from resync_robot.curriculum.stage_folder import StageFolder
from resync_robot.curriculum.taken_over import TAKE_OVER, check_taken_over, take_over
from resync_robot.sim_training.domains import find_domain

PUCKS = str(Path(__file__).parents[2] / "docs" / "puck_behind_a_door.py")
DOMAIN = find_domain(PUCKS)
OPEN_DOOR = Record({"signature": [t.name for t in DOMAIN.types][:2]})


def _library(**skills: Record) -> Library:
    return Library(
        domain="elsewhere",
        rig_hash="",
        domain_pddl="(define (domain elsewhere))",
        predicates={},
        skills=skills,
        stages=(),
        provenance={},
    )


@pytest.mark.parametrize(
    ("library", "by_camera", "message"),
    [
        (_library(Climb=OPEN_DOOR), False, "holds Climb; the stages here learn OpenDoor, Shove"),
        (_library(OpenDoor=Record({"signature": ["crane"]})), False, "about crane, which puck-behind-a-door does not"),
        (_library(OpenDoor=OPEN_DOOR), True, "no camera policy for OpenDoor"),
    ],
)
def test_a_library_that_nothing_can_be_taken_from_is_refused(library: Library, by_camera: bool, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        check_taken_over(DOMAIN.stages, library, DOMAIN, by_camera)


def test_others_are_not() -> None:
    seeing = replace(_library(OpenDoor=OPEN_DOOR), policies={"OpenDoor": {"model": b""}})
    check_taken_over(DOMAIN.stages, _library(OpenDoor=OPEN_DOOR), DOMAIN, by_camera=False)
    check_taken_over(DOMAIN.stages, seeing, DOMAIN, by_camera=True)


def test_only_stages_of_that_name_take_over_and_those_distil_nothing() -> None:
    plan = Curriculum(
        domain=DOMAIN,
        stages=DOMAIN.stages,
        preset="quick",
        seed=0,
        workers=1,
        concepts="default",
        provenance={},
        elsewhere=_library(OpenDoor=OPEN_DOOR),
        by_camera=True,
    )
    opening, shoving = DOMAIN.stages
    assert plan.takes_over(opening) and not plan.takes_over(shoving)
    assert plan.steps(opening) == ("mine", "take-over", "check", "dream", "discover", "save")
    assert "recover" in plan.steps(shoving) and "distil" in plan.steps(shoving)


def test_a_run_goes_on_only_with_the_library_that_it_began_with(tmp_path: Path) -> None:
    folder, stage = StageFolder(RunFolder(tmp_path), 1, "OpenDoor"), DOMAIN.stages[0]
    library = _library(OpenDoor=OPEN_DOOR)
    assert take_over(stage, folder, library) == take_over(stage, folder, library) == OPEN_DOOR
    assert folder.figures(TAKE_OVER)["from"] == "elsewhere"
    other = _library(OpenDoor=Record({**OPEN_DOOR.meta, "sure": 0.5}))
    with pytest.raises(ConfigError, match="not the one any more"):
        take_over(stage, folder, other)


@pytest.mark.slow
def test_a_recovery_that_is_taken_over_is_planned_with(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Learn it, give it away as of another domain, and learn the concepts anew around it."""
    first, second = tmp_path / "first", tmp_path / "second"
    train(TrainConfig(domain=PUCKS, preset="smoke", out=first, stages="1", workers=1))
    learned = load_library(first / "library")
    save_library(replace(learned, domain="elsewhere"), tmp_path / "elsewhere")
    config = TrainConfig(
        domain=PUCKS, preset="smoke", out=second, stages="1", workers=1, library=tmp_path / "elsewhere", seed=1
    )
    train(config)
    found = load_library(second / "library")
    assert not list(second.glob("stages/*/ppo.safetensors"))
    assert found.skills["OpenDoor"].meta == learned.skills["OpenDoor"].meta
    assert "Fetch" in found.domain_pddl and found.predicates
    assert "taken over from elsewhere" in capsys.readouterr().out
