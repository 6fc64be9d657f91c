"""Which stages a run learns, on top of what; and a whole run, cut off after each of its steps."""

from __future__ import annotations

import itertools
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from resync_robot.commands.train_sim import TrainConfig, train
from resync_robot.core.errors import ConfigError, ResyncError, UnknownNameError
from resync_robot.core.library import LearnedFailure, LearnedStage, Library, load_library
from resync_robot.curriculum.learn_stages import STAGE_SEEDS, STEPS, TRAINING_SEEDS, Curriculum, chosen_stages
from resync_robot.sim_training.domains import find_domain

PUCKS = str(Path(__file__).parents[2] / "docs" / "puck_behind_a_door.py")
DOMAIN = find_domain(PUCKS)


def _library(*recoveries: str) -> Library:
    failure = LearnedFailure(skill="Fetch", argument=1, objects={"door": "door"}, before={}, after={})
    stages = tuple(LearnedStage(recovery=r, scenario="door", failure=failure) for r in recoveries)
    return Library(
        domain=DOMAIN.name, rig_hash="", domain_pddl="", predicates={}, skills={}, stages=stages, provenance={}
    )


@pytest.mark.parametrize(
    ("words", "known", "expected"),
    [
        ("", (), ["OpenDoor", "Shove"]),
        ("", ("OpenDoor",), ["Shove"]),
        ("2,1", (), ["Shove", "OpenDoor"]),
        ("Shove", (), ["Shove"]),
        (" 1 ", (), ["OpenDoor"]),
    ],
)
def test_stages_are_named_by_number_or_recovery(words: str, known: tuple[str, ...], expected: list[str]) -> None:
    found = chosen_stages(DOMAIN, words, _library(*known) if known else None)
    assert [s.recovery for s in found] == expected


@pytest.mark.parametrize(
    ("words", "known", "message"),
    [
        ("3", (), "stage of puck-behind-a-door"),
        ("1,OpenDoor", (), "named twice"),
        ("1", ("OpenDoor",), "in the library of --from already"),
        ("", ("OpenDoor", "Shove"), "no stage left"),
        (",", (), "no stage left"),
    ],
)
def test_others_are_refused(words: str, known: tuple[str, ...], message: str) -> None:
    with pytest.raises((ConfigError, UnknownNameError), match=message):
        chosen_stages(DOMAIN, words, _library(*known) if known else None)


def test_no_two_steps_share_a_world() -> None:
    plan = Curriculum(
        domain=DOMAIN, stages=DOMAIN.stages, preset="quick", seed=3, workers=1, concepts="default", provenance={}
    )
    ranges = [plan.seeds(number, step) for number in (1, 2, 3) for step in STEPS]
    assert all(a.stop <= b.start for a, b in itertools.pairwise(ranges))
    assert ranges[0].start >= 3 * TRAINING_SEEDS + STAGE_SEEDS and ranges[-1].stop <= 4 * TRAINING_SEEDS


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"rig": Path("rig.toml")}, "--rig is for domains of the arm"),
        ({"device": "cuda"}, "--device cuda is for domains of the arm"),
        ({"skills": "camera"}, "--skills camera is for domains of the arm"),
        ({"library": Path("nowhere")}, "there is no library folder"),
        ({"stages": "Close"}, "stage of puck-behind-a-door 'Close'"),
    ],
)
def test_what_makes_no_sense_is_refused_before_anything_is_mined(
    tmp_path: Path, given: dict[str, object], message: str
) -> None:
    config = replace(TrainConfig(domain=PUCKS, out=tmp_path / "run", preset="smoke"), **given)  # type: ignore[arg-type]
    with pytest.raises(ResyncError, match=message):
        train(config)
    assert not list((tmp_path / "run").glob("stages/*/failures.json"))


@pytest.mark.slow
def test_a_run_that_is_cut_off_anywhere_ends_in_the_same_library(tmp_path: Path) -> None:
    """What each step leaves is removed from the last one on; the run then goes on, to the same library."""
    whole = tmp_path / "whole"
    train(TrainConfig(domain=PUCKS, preset="smoke", out=whole, stages="1", workers=1))
    expected = load_library(whole / "library").content_hash
    later = ["library", "stages/1-OpenDoor/library", "stages/1-OpenDoor/dreams-*", "stages/1-OpenDoor/recovered.json"]
    later += [
        "stages/1-OpenDoor/recovery.*",
        "stages/1-OpenDoor/ppo.safetensors",
        "stages/1-OpenDoor/attempts.safetensors",
    ]
    later += ["stages/1-OpenDoor/failures.json"]
    for count in range(1, len(later) + 1):
        cut = tmp_path / f"cut-{count}"
        shutil.copytree(whole, cut)
        for pattern in later[:count]:
            for path in cut.glob(pattern):
                shutil.rmtree(path) if path.is_dir() else path.unlink()
        train(TrainConfig(domain=PUCKS, out=cut, resume=True, workers=1))
        assert load_library(cut / "library").content_hash == expected, later[:count]
