"""Evaluation: worlds of their own, episodes that are run and written, and bad input said clearly."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from resync_robot import __version__, cli, evaluate
from resync_robot.core.errors import ConfigError, UnknownNameError
from resync_robot.core.library import save_library
from resync_robot.planning.execute import ExecuteSettings
from sim_training.domains import find_domain, world_task
from tests.libraries import DOMAIN, given_library

CORNERED = find_domain(DOMAIN)


def test_groups_of_scenarios_and_lists_are_spelled_out_once() -> None:
    names = tuple(CORNERED.scenarios)
    train = tuple(s.name for s in CORNERED.scenarios.values() if s.training)
    test = tuple(n for n in names if n not in train)
    assert evaluate._scenarios(("all",), CORNERED) == names
    assert evaluate._scenarios(("train",), CORNERED) == train
    assert evaluate._scenarios(("test",), CORNERED) == test
    assert evaluate._scenarios(("s1,s0", "s1"), CORNERED) == ("s1", "s0")
    assert evaluate._methods(("resync,rc", "initial")) == ("resync", "rc", "initial")


def test_unknown_names_list_the_valid_ones() -> None:
    with pytest.raises(UnknownNameError, match="unknown method 'magic'") as caught:
        evaluate._methods(("resync", "magic"))
    assert "initial" in caught.value.fix
    with pytest.raises(UnknownNameError, match="s9"):
        evaluate._scenarios(("s9",), CORNERED)


@pytest.mark.parametrize(
    ("given", "word"),
    [
        ({"episodes": 0}, "--episodes is 0; allowed: 1 to"),
        ({"episodes": 10**12}, "--episodes is 10"),
        ({"workers": 0}, "--workers is 0; allowed: 1 to 256"),
        ({"workers": -1}, "--workers is -1"),
        ({"workers": 10**6}, "--workers is 10"),
        ({"seeds": ()}, "--seeds names none"),
        ({"seeds": (0, -1)}, "--seeds is -1"),
        ({"seeds": (2**40,)}, "from 0 to 2147483647"),
        ({"perception_only": True, "scenes": 0}, "--scenes is 0"),
        ({"perception_only": True, "scenes": 10**12}, "--scenes is 10"),
        ({"perception_only": True, "workers": 0}, "--workers is 0"),
        ({"perception_only": True, "seeds": (-1,)}, "--seeds is -1"),
    ],
)
def test_numbers_out_of_range_are_refused_at_once(given: dict, word: str) -> None:
    with pytest.raises(ConfigError) as error:
        evaluate.evaluate(evaluate.EvaluateConfig(**given))
    assert word in str(error.value)


def features(task) -> np.ndarray:
    return np.concatenate([task.initial[o] for o in task.objects])


@given(st.integers(0, 10_000), st.integers(0, 10_000), st.sampled_from(sorted(CORNERED.scenarios)))
def test_a_world_is_a_pure_function_of_its_names(seed: int, episode: int, scenario: str) -> None:
    first, again = (world_task(CORNERED, scenario, seed, episode) for _ in range(2))
    assert first.initial == again.initial
    assert (first.physics, first.goal, first.seed) == (again.physics, again.goal, again.seed)
    for others in ((seed + 1, episode), (seed, episode + 1)):
        assert not np.array_equal(features(world_task(CORNERED, scenario, *others)), features(first))


def test_no_world_of_evaluation_is_one_of_training() -> None:
    def trained(seed: int) -> np.ndarray:
        return features(CORNERED.scenario("s0").sample(np.random.default_rng(seed), seed))

    seen = {features(world_task(CORNERED, "s0", s, e)).tobytes() for s in range(5) for e in range(20)}
    assert len(seen) == 100
    assert not seen & {trained(seed).tobytes() for seed in range(200)}
    assert not seen & {trained(1_000_000 + seed).tobytes() for seed in range(200)}


def test_unseen_worlds_lie_outside_the_edges_of_training() -> None:
    for episode in range(20):
        task = world_task(CORNERED, "s1", 3, episode, unseen=True)
        width = next(task.initial.get(o, "size_x")[0] for o in task.objects if o.type.name == "block")
        assert 0.041 < width < 0.0461 or 0.0699 < width < 0.0771
        friction = task.physics["friction_pad"]
        assert 0.9 <= friction <= 1.0 or 1.3 <= friction <= 1.43
        assert {v["kind"] for v in task.physics["surfaces"].values()} <= {"checks", "blotches"}
        again = world_task(CORNERED, "s1", 3, episode, unseen=True)
        assert again.initial == task.initial and again.physics == task.physics


# -- the command ------------------------------------------------------------------------------------------------------


@pytest.fixture
def library(tmp_path: Path) -> Path:
    save_library(given_library(), tmp_path / "library")
    return tmp_path / "library"


@pytest.mark.parametrize(
    ("args", "word"),
    [
        (("--domain", "kitchen"), "unknown domain 'kitchen'"),
        (("--scenarios", "s9"), "'s9'"),
        (("--methods", "magic"), "unknown method 'magic'"),
        (("--episodes", "0"), "--episodes is 0"),
        (("--seeds", "0", "-3"), "--seeds is -3"),
        (("--library", "/nowhere"), "no library folder /nowhere"),
        (("--json", "/dev/null/rows.json"), "cannot write /dev/null/rows.json"),
        (("--skills", "camera"), "--skills camera needs cameras"),
        (("--skills", "camera", "--perception", "camera", "--workers", "1"), "no camera policy for 'Recover'"),
    ],
)
def test_bad_input_is_one_error_with_code_2(
    args: tuple[str, ...], word: str, library: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = () if "--library" in args else ("--library", str(library))
    assert cli.main(["evaluate", *given, *args]) == 2
    shown = capsys.readouterr()
    assert shown.err.startswith("error: ") and word in shown.err
    assert "Traceback" not in shown.err
    assert shown.out == ""


def damage(library: Path, how: str) -> str:
    """Spoils a library; returns a word that the error must hold."""
    manifest = json.loads((library / "library.json").read_text())
    weights = library / "skills" / "Recover.safetensors"
    if how == "another version":
        (library / "library.json").write_text(json.dumps({**manifest, "version": 99}))
        return "version 99"
    if how == "truncated":
        weights.write_bytes(weights.read_bytes()[:-7])
    elif how == "altered":
        raw = bytearray(weights.read_bytes())
        raw[-1] ^= 1
        weights.write_bytes(raw)
    elif how == "missing":
        weights.unlink()
    elif how == "no manifest":
        (library / "library.json").write_text("{}")
        return "version None"
    return "Recover.safetensors"


@pytest.mark.parametrize("command", ["evaluate", "deploy"])
@pytest.mark.parametrize("how", ["another version", "truncated", "altered", "missing", "no manifest"])
def test_a_spoiled_library_is_one_error_with_code_2(
    command: str, how: str, library: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    word = damage(library, how)
    assert cli.main([command, "--library", str(library)]) == 2
    shown = capsys.readouterr()
    assert shown.err.startswith("error: ") and word in shown.err
    assert shown.err.count("\n") <= 2
    assert shown.out == ""


def test_a_library_of_another_domain_or_without_recovery_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from dataclasses import replace

    save_library(replace(given_library(), domain="kitchen"), tmp_path / "other")
    save_library(replace(given_library(), skills={}), tmp_path / "lacking")
    for name, word in (("other", "learned in 'kitchen'"), ("lacking", "no skill 'Recover'")):
        for command in ("evaluate", "deploy"):
            extra = ("--workers", "1") if command == "evaluate" else ()
            assert cli.main([command, "--library", str(tmp_path / name), *extra]) == 2
            assert f"error: the library {'was' if name == 'other' else 'holds'}" in (
                shown := capsys.readouterr().err.splitlines()[-2]
            ), shown
            assert word in shown


def test_episodes_are_run_counted_and_written(
    library: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "deep" / "rows.json"
    args = ["--library", str(library), "--methods", "initial", "--scenarios", "s0", "--episodes", "2"]
    assert cli.main(["evaluate", *args, "--workers", "1", "--json", str(file)]) == 0
    # The given model alone is stuck in the corner, by physics.
    assert "| initial | 0.00 [0.00, 0.66] of 2 |" in capsys.readouterr().out
    written = json.loads(file.read_text())
    assert set(written) == {"rows", "summary", "episodes", "provenance"}
    (row,) = written["rows"]
    assert (row["domain"], row["scenario"], row["split"], row["method"]) == (DOMAIN, "s0", "train", "initial")
    assert (row["episodes"], row["successes"], sum(row["failure_reasons"].values())) == (2, 0, 2)
    assert [(e["scenario"], e["seed"], e["episode"], e["success"]) for e in written["episodes"]] == [
        ("s0", 0, 0, False),
        ("s0", 0, 1, False),
    ]
    for episode in written["episodes"]:
        attempts = ExecuteSettings().max_failures
        assert episode["skills_run"] == ["Pick(r, b0)"] * attempts
        assert (episode["skills"], episode["end"]) == (attempts, "stuck")
    provenance = written["provenance"]
    assert provenance["version"] == __version__
    assert provenance["libraries"] == [row["library_hash"]] == [given_library().content_hash]


def test_with_the_right_sequence_given_the_shipped_skills_reach_the_goal(tmp_path: Path) -> None:
    file = tmp_path / "rows.json"
    args = ["--methods", "human", "--scenarios", "s0,s1", "--episodes", "1", "--workers", "1", "--json", str(file)]
    assert cli.main(["evaluate", *args]) == 0
    written = json.loads(file.read_text())
    assert [(e["scenario"], e["success"], e["skills_run"]) for e in written["episodes"]] == [
        ("s0", True, ["Recover(r, b0, box)", "Pick(r, b0)", "Insert(r, b0, b1)"]),
        ("s1", True, ["Recover(r, b0, box)", "Pick(r, b1)", "Insert(r, b1, b0)"]),
    ]
    assert {r["recoveries_per_episode"] for r in written["rows"]} == {1.0}


def test_the_table_is_lost_before_the_file_is(library: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def nobody_reads(text: str) -> None:
        raise BrokenPipeError

    monkeypatch.setattr("resync_robot.progress.say", nobody_reads)
    monkeypatch.setattr("sim_training.parallel.parallel_map", lambda run, jobs, context, workers: [])
    monkeypatch.setattr(evaluate, "table", lambda *_: "")
    with pytest.raises(BrokenPipeError):
        evaluate.evaluate(evaluate.EvaluateConfig(library=(library,), json=tmp_path / "rows.json"))
    assert json.loads((tmp_path / "rows.json").read_text())["rows"] == []
