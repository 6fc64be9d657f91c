"""Deployment in simulation: recorded whatever happens, and bad input said before anything moves."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from resync_robot import cli
from resync_robot.commands import deploy
from resync_robot.commands.deploy import DeployConfig
from resync_robot.core.episode import read_episode
from resync_robot.core.episode_records import EpisodeMeta, EventKind
from resync_robot.core.episode_writer import EpisodeWriter
from resync_robot.core.rig import load_rig
from resync_robot.deployment import devices as simulated
from resync_robot.deployment import episode as one_episode
from resync_robot.deployment import world as worlds
from resync_robot.hardware import workspace
from resync_robot.planning import execute
from resync_robot.sim_training.domains import find_domain, world_task
from tests import scenes
from tests.commands.deployments import RIG, episodes, oracle
from tests.libraries import DOMAIN, given_library
from tests.planning.other_planner import solve


@pytest.mark.parametrize(
    ("args", "word"),
    [
        (("--domain", "kitchen"), "unknown domain 'kitchen'"),
        (("--scenario", "s9"), "'s9'"),
        (("--goal", "On(b1,b7)"), "unknown object 'b7'"),
        (("--goal", "Under(b1,b0)"), "unknown predicate 'Under'"),
        (("--goal", "On(b1)"), "ill-typed"),
        (("--goal", "on the block"), "cannot read the goal"),
        (("--goal", ""), "--goal is empty"),
        (("--goal", "Holding(r,b0), Holding(r,b1)"), "no plan reaches"),
        (("--goal", "Holding(r,b0), HandEmpty(r)"), "no plan reaches"),
        (("--library", "/nowhere"), "no library folder /nowhere"),
        (("--rig", "/nowhere.toml"), "/nowhere.toml"),
        (("--goal", "not On(b1,b0)"), "'not' is not understood"),
        (("--goal", "On(b1,b0), On(b0,b1)"), "b0 would be upon itself"),
        (("--episodes", "0"), "--episodes is 0"),
        (("--episodes", "-1"), "--episodes is -1; allowed: 1 to 100000"),
        (("--episodes", "99999999999"), "--episodes is 99999999999"),
        (("--seed", "99999999999"), "from 0 to 2147483647"),
        (("--seed", "-1"), "--seed is -1"),
        (("--backend", "ur7e"), "no [controller]"),
        (("--backend", "ur7e", "--rig", RIG), "no emulated lab at"),
        (("--backend", "replay"), "needs a recording"),
        (("--replay", "x.mcap"), "for --backend replay"),
        (("--backend", "replay", "--replay", "/nowhere.mcap"), "/nowhere.mcap"),
        (("--record-pictures", "99"), "--record-pictures is 99; allowed: 0 to 30"),
        (("--record-pictures", "-1"), "--record-pictures is -1; allowed: 0 to 30"),
        (("--out", "/dev/null/run"), "cannot write to /dev/null/run"),
        (("--pddl", "x"), "add --dry-run"),
        (("--pddl", "x", "--dry-run", "--episodes", "2"), "--pddl writes one problem"),
        (("--pddl", __file__, "--dry-run"), "is no folder"),
    ],
)
def test_bad_input_is_one_error_with_code_2(
    args: tuple[str, ...],
    word: str,
    library: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    given = () if "--library" in args else ("--library", str(library))
    assert cli.main(["deploy", *given, *args]) == 2
    shown = capsys.readouterr()
    assert shown.err.startswith("error: ") and word in shown.err
    assert "Traceback" not in shown.err
    if "no emulated lab" in word:
        # Found out only when the first episode begins, and nothing of it is recorded.
        assert not list(tmp_path.rglob("*.mcap"))
        return
    assert shown.out == ""
    assert [p.name for p in tmp_path.iterdir()] == ["library"], "nothing may be left behind"


def test_the_world_and_goal_are_those_of_the_scenario_unless_a_goal_is_given() -> None:
    domain = find_domain(DOMAIN)
    plain = deploy._task(DeployConfig(scenario="s1", seed=3), domain, 3)
    assert plain.initial == world_task(domain, "s1", 3, 0).initial
    asked = deploy._task(DeployConfig(scenario="s1", seed=3, goal="Holding(r,b1)"), domain, 3)
    assert asked.initial == plain.initial and asked.physics == plain.physics
    assert ", ".join(map(str, asked.goal)) == "Holding(r, b1)"


def test_a_step_is_confirmed_by_a_word_only(monkeypatch: pytest.MonkeyPatch) -> None:
    for word, allowed in (("y", True), ("Yes ", True), ("", False), ("n", False), ("why", False)):
        monkeypatch.setattr("builtins.input", lambda prompt, word=word: word)
        assert one_episode.may_run("Pick(r, b0)") is allowed


def test_a_dry_run_looks_plans_records_and_moves_no_skill(
    renderer: None, library: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    args = ["--library", str(library), "--perception", "oracle", "--dry-run", "--out", str(out)]
    assert cli.main(["deploy", *args]) == 0
    shown = capsys.readouterr().out
    assert "Pick(r, b1), Insert(r, b1, b0)" in shown
    assert "Episode 1/1: planned (2 steps); 0 skills" in shown and "1 of 1 episodes were planned" in shown
    assert "failed" not in shown and "reached the goal" not in shown
    (path,) = episodes(out)
    episode = read_episode(path)
    assert episode.damage is None
    assert [(e.kind, e.text) for e in episode.events()] == [(EventKind.PLANNED, "2 steps")]
    assert episode.meta.scenario == "s1" and episode.meta.goal == "On(b1, b0)"
    assert episode.meta.library_hash == given_library().content_hash
    assert next(episode.plans()).steps == ("Pick(r, b1)", "Insert(r, b1, b0)")


def test_what_a_dry_run_planned_is_written_for_other_planners(
    renderer: None, library: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    args = ["--library", str(library), "--perception", "oracle", "--dry-run", "--out", str(tmp_path / "run")]
    assert cli.main(["deploy", *args, "--pddl", str(tmp_path / "pddl")]) == 0
    assert f"PDDL: {tmp_path}/pddl/domain.pddl and {tmp_path}/pddl/problem.pddl.\n" in capsys.readouterr().out
    found = solve(tmp_path / "pddl" / "domain.pddl", tmp_path / "pddl" / "problem.pddl")
    assert found == [("pick", "r", "b1"), ("insert", "r", "b1", "b0")]
    assert "; box0 is the object 'box'" in (tmp_path / "pddl" / "problem.pddl").read_text()


def test_a_recording_that_the_disk_cut_short_is_called_incomplete_and_ends_the_run(
    renderer: None,
    library: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
    full_disk,
) -> None:
    args = ["--library", str(library), "--perception", "oracle", "--dry-run", "--episodes", "2"]
    for most, found in ((4000, "Recording incomplete: "), (100, "Nothing of it was recorded.")):
        out = tmp_path / str(most)
        with full_disk(most):
            code = cli.main(["deploy", *args, "--out", str(out)])
        assert code == 3
        shown = capsys.readouterr()
        assert found in shown.out and "Recording: " not in shown.out and "Episode 2" not in shown.out
        assert [r.message.count("File too large") for r in caplog.records] == [1]
        caplog.clear()
        assert len(episodes(out)) == (most > 100)


def slow_rig(folder: Path) -> Path:
    """The emulated rig, whose motions nobody has confirmed."""
    path, text = folder / "slow.toml", Path(RIG).read_text()
    assert text.count("full_speed = true") == 1
    path.write_text(text.replace("full_speed = true", "full_speed = false"))
    return path


def test_a_step_that_is_not_confirmed_is_not_run(
    renderer: None, library: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []
    monkeypatch.setattr("builtins.input", lambda prompt: asked.append(prompt) or "n")
    out = tmp_path / "run"
    args = ["--library", str(library), "--perception", "oracle", "--confirm", "--out", str(out)]
    assert cli.main(["deploy", *args]) == 3
    assert asked == ["Run Pick(r, b1)? [y/N] "]
    (path,) = episodes(out)
    assert [e.kind for e in read_episode(path).events()] == [EventKind.STOP]


def test_without_a_terminal_to_ask_it_says_so_and_where_the_recording_is(
    renderer: None, library: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def closed(prompt: str) -> str:
        raise EOFError

    monkeypatch.setattr("builtins.input", closed)
    assert oracle(library, tmp_path / "run", "--confirm") == 2
    shown = capsys.readouterr()
    assert "nobody is there to answer" in shown.err and "run it from a terminal" in shown.err
    assert "drop" not in shown.err
    (path,) = episodes(tmp_path / "run")
    assert f"Recording: {path}" in shown.out
    assert [e.kind for e in read_episode(path).events()] == [EventKind.GIVE_UP]


def test_a_recording_that_exists_is_found_before_anything_connects(
    library: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(simulated, "open_simulated", lambda *_: pytest.fail("connected"))
    old = tmp_path / f"episode-001-s1-seed{deploy._task(DeployConfig(scenario='s1'), find_domain(DOMAIN), 1).seed}.mcap"
    old.write_bytes(b"precious")
    assert oracle(library, tmp_path, "--episodes", "2") == 2
    assert f"{old} exists already" in (error := capsys.readouterr().err) and "--out" in error
    assert old.read_bytes() == b"precious" and episodes(tmp_path) == [old]


@pytest.mark.slow
def test_a_first_run_is_slow_and_asks_before_each_step(
    renderer: None, library: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    rig, answers = slow_rig(tmp_path), iter(["y", "n"])
    monkeypatch.setattr("builtins.input", lambda prompt: next(answers))
    out = tmp_path / "run"
    args = ["--library", str(library), "--rig", str(rig), "--perception", "oracle", "--confirm", "--out", str(out)]
    assert cli.main(["deploy", *args]) == 3
    assert "250 mm/s at most" in capsys.readouterr().out and next(answers, None) is None
    episode = read_episode(episodes(out)[0])
    kinds = [e.kind for e in episode.events()]
    assert kinds.count(EventKind.SKILL_START) == 1 and kinds[-1] is EventKind.STOP
    joints = list(episode.joints())
    tips = load_rig(rig).tip_pose(np.array([j.sent.arm for j in joints]))[:, :3, 3]
    speeds = np.linalg.norm(np.diff(tips, axis=0), axis=1) / np.diff([j.time for j in joints])
    assert 0.05 < speeds.max() <= 0.25 * 1.001


def test_an_arm_that_stands_where_it_cannot_be_driven_leaves_the_other_episodes_their_turn(
    renderer: None, library: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    margins = iter([1.0])

    class First(worlds.OracleWorld):
        """In the first episode the arm is too near to something."""

        def __init__(self, *args: Any, **kwargs: Any) -> None:
            with monkeypatch.context() as m:
                m.setattr(workspace, "MARGIN", next(margins, workspace.MARGIN))
                super().__init__(*args, **kwargs)

    monkeypatch.setattr(worlds, "OracleWorld", First)
    out = tmp_path / "run"
    args = ["--library", str(library), "--perception", "oracle", "--dry-run", "--episodes", "2", "--out", str(out)]
    assert cli.main(["deploy", *args]) == 3, "a fault is no plan"
    shown = capsys.readouterr().out
    assert "by hand on the teach pendant" in shown
    assert "Episode 1/2: failed (fault: the arm cannot be driven from where it stands" in shown
    assert "Episode 2/2: planned (2 steps)" in shown and "1 of 2 episodes were planned" in shown
    first, second = (read_episode(path) for path in episodes(out))
    assert [e.kind for e in first.events()] == [EventKind.GIVE_UP]
    assert next(second.plans()).steps


def test_a_scene_without_a_plan_leaves_the_other_episodes_their_turn(
    renderer: None, library: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    found = execute.plan_and_execute
    blind = iter(
        [
            execute.EpisodeResult(
                execute.EpisodeEnd.NO_PLAN, "no plan reaches On(b1, b0)", (), (), scenes.scene({}).initial
            )
        ]
    )
    monkeypatch.setattr(
        execute, "plan_and_execute", lambda *args, **kwargs: next(blind, None) or found(*args, **kwargs)
    )
    args = ["--library", str(library), "--perception", "oracle", "--dry-run", "--episodes", "2", "--out", str(tmp_path)]
    assert cli.main(["deploy", *args]) == 3
    shown = capsys.readouterr().out
    assert "Episode 1/2: failed (no plan: no plan reaches On(b1, b0))" in shown and "another --goal" in shown
    assert "Episode 2/2: planned (2 steps)" in shown and len(episodes(tmp_path)) == 2
    assert "1 of 2 episodes were planned" in shown


def test_without_a_vulkan_device_physics_goes_on_and_pictures_are_one_error(library: Path, tmp_path: Path) -> None:
    blind = os.environ | {"VK_DRIVER_FILES": os.devnull, "VK_ICD_FILENAMES": os.devnull}

    def run(*args: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "resync_robot", *args, "--library", str(library)]
        return subprocess.run(command, env=blind, capture_output=True, text=True, check=False)

    deployed = run("deploy", "--out", str(tmp_path / "run"))
    assert deployed.returncode == 2
    assert deployed.stderr.startswith("error: no Vulkan device can render")
    assert "install_vulkan.sh" in deployed.stderr and "Traceback" not in deployed.stderr
    evaluated = run("evaluate", "--scenarios", "s4", "--methods", "initial", "--episodes", "1", "--workers", "1")
    assert evaluated.returncode == 0, evaluated.stderr


def test_a_replay_of_a_recording_with_a_hole_ends_before_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    meta = EpisodeMeta.of(load_rig(), library_hash="", domain=DOMAIN, scenario="s1", goal="", seed=0, backend="sim")
    path = tmp_path / "e.mcap"
    with EpisodeWriter(path, meta) as writer:
        for k in range(400):
            writer.tip_force(0.02 * k, np.zeros(3))
    data = path.read_bytes()
    hole = data.index(b"zstd", len(data) // 2)
    path.write_bytes(data[:hole] + bytes(100) + data[hole + 100 :])
    config = DeployConfig(backend="replay", replay=path)
    recording = deploy._recording(config)
    assert recording is not None and 0.0 < recording.duration < recording.missing[0][0] + 0.1 < 7.0
    said = capsys.readouterr().out
    assert said.startswith(f"Warning: {path} is not whole: ") and "something is missing from " in said
    assert f"what comes before the first that is missing: {recording.duration:.1f} s" in said
    path.write_bytes(data + b"more")
    assert deploy._recording(config) is not None and capsys.readouterr().out == ""


@pytest.mark.slow
def test_an_episode_that_fails_is_recorded_and_has_code_3(
    renderer: None, library: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    # The given model alone: the insertion upon the cornered block fails by physics.
    assert cli.main(["deploy", "--library", str(library), "--perception", "oracle", "--out", str(out)]) == 3
    shown = capsys.readouterr().out
    assert "failed (" in shown and "0 of 1 episodes" in shown
    episode = read_episode(episodes(out)[0])
    kinds = [e.kind for e in episode.events()]
    assert EventKind.SKILL_START in kinds and EventKind.GIVE_UP in kinds and EventKind.GOAL not in kinds
    joints = list(episode.joints())
    assert joints[-1].time > 5.0
    assert episode.cameras and list(episode.truths())


@pytest.mark.slow
def test_the_shipped_library_reaches_the_goal_where_the_given_model_failed(
    renderer: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from resync_robot.library_models import shipped_library

    if not shipped_library(DOMAIN).exists():
        pytest.skip("no shipped library")
    out = tmp_path / "run"
    assert cli.main(["deploy", "--perception", "oracle", "--out", str(out)]) == 0
    assert EventKind.GOAL in [e.kind for e in read_episode(episodes(out)[0]).events()]
