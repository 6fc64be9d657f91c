"""Worlds of an evaluation, each its own, and episodes that are run in them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from resync_robot import __version__, cli
from resync_robot.planning.execute import ExecuteSettings
from resync_robot.sim_training.domains import find_domain, world_task
from tests.libraries import DOMAIN, given_library

CORNERED = find_domain(DOMAIN)


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
        task = world_task(CORNERED, "s1", 3, episode, worlds="unseen")
        width = next(task.initial.get(o, "size_x")[0] for o in task.objects if o.type.name == "block")
        assert 0.041 < width < 0.0461 or 0.0699 < width < 0.0771
        friction = task.physics["friction_pad"]
        assert 0.9 <= friction <= 1.0 or 1.3 <= friction <= 1.43
        assert {v["kind"] for v in task.physics["surfaces"].values()} <= {"checks", "blotches"}
        again = world_task(CORNERED, "s1", 3, episode, worlds="unseen")
        assert again.initial == task.initial and again.physics == task.physics


def test_worlds_of_different_seeds_are_different_worlds() -> None:
    """So ranges of episodes never overlap, however many of one seed there are."""
    seen = [features(world_task(CORNERED, "s0", s, e)).tobytes() for s in range(4) for e in (0, 1, 2, 1_000_000)]
    assert len(set(seen)) == len(seen)


def test_episodes_are_run_counted_and_written(
    library: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "deep" / "rows.json"
    args = ["--library", str(library), "--methods", "initial", "--scenarios", "s0", "--episodes", "2"]
    assert cli.main(["evaluate", *args, "--workers", "1", "--json", str(file)]) == 0
    # The given model alone is stuck in the corner, by physics.
    assert "| initial | 0.00 [0.00, 0.66] of 2 |" in capsys.readouterr().out
    written = json.loads(file.read_text("utf-8"))
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


def test_an_episode_can_begin_with_a_block_in_the_hand(library: Path, tmp_path: Path) -> None:
    """The given model inserts at once what it holds, again and again: that is shorter than to put it down."""
    file = tmp_path / "rows.json"
    args = ["--library", str(library), "--methods", "initial", "--scenarios", "s7", "--episodes", "1"]
    assert cli.main(["evaluate", *args, "--workers", "1", "--json", str(file)]) == 0
    (episode,) = json.loads(file.read_text("utf-8"))["episodes"]
    assert episode["skills_run"] == ["Insert(r, b1, b0)"] * ExecuteSettings().max_failures
    assert (episode["success"], episode["end"]) == (False, "stuck")


def test_the_shipped_library_puts_the_block_down_frees_the_base_and_goes_on(tmp_path: Path) -> None:
    file = tmp_path / "rows.json"
    args = ["--methods", "resync", "--scenarios", "s7", "--seeds", "1000", "--episodes", "1"]
    assert cli.main(["evaluate", *args, "--workers", "1", "--json", str(file)]) == 0
    (episode,) = json.loads(file.read_text("utf-8"))["episodes"]
    assert episode["success"]
    assert episode["skills_run"] == ["Place(r, b1)", "Recover(r, b0, box)", "Pick(r, b1)", "Insert(r, b1, b0)"]


@pytest.mark.parametrize(
    ("scenario", "seed", "skills"),
    [
        ("s0", 2, ["Recover(r, b0, box)", "Pick(r, b0)", "Insert(r, b0, b1)"]),
        ("s1", 3, ["Recover(r, b0, box)", "Pick(r, b1)", "Insert(r, b1, b0)"]),
    ],
)
def test_with_the_right_sequence_given_the_shipped_skills_reach_the_goal(
    scenario: str, seed: int, skills: list[str], tmp_path: Path
) -> None:
    file = tmp_path / "rows.json"
    where = ["--methods", "human", "--scenarios", scenario, "--seeds", str(seed), "--episodes", "1", "--workers", "1"]
    assert cli.main(["evaluate", *where, "--perception", "oracle", "--skills", "state", "--json", str(file)]) == 0
    written = json.loads(file.read_text("utf-8"))
    assert [(e["success"], e["skills_run"]) for e in written["episodes"]] == [(True, skills)]
    assert {r["recoveries_per_episode"] for r in written["rows"]} == {1.0}
