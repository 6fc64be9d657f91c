"""Deployment through the real protocols: a whole task on the emulated arm, seen by its cameras."""

from __future__ import annotations

import threading
from itertools import pairwise
from pathlib import Path

import pytest

from resync_robot import cli
from resync_robot.core.episode import Episode, read_episode
from resync_robot.core.episode_records import EventKind
from resync_robot.core.skill import GroundSkill
from resync_robot.deployment.recorder import Recorder
from resync_robot.hardware.base import Halt
from tests import emulators

pytestmark = [pytest.mark.realtime, pytest.mark.usefixtures("renderer")]


def deployed(folder: Path, *faults: str) -> tuple[int, Episode]:
    """The exit code and the recording of an episode in which nothing has to be recovered."""
    out = folder / "run"
    words = ("--backend", "ur7e", "--scenario", "s4", "--seed", "1001", "--out", str(out))
    with emulators.lab(folder, *faults) as rig:
        code = cli.main(["deploy", *words, "--rig", str(rig)])
    (path,) = out.glob("*.mcap")
    return code, read_episode(path)


def test_a_task_is_done_by_camera_and_wholly_recorded(tmp_path: Path) -> None:
    code, episode = deployed(tmp_path)
    assert code == 0 and episode.damage is None
    kinds = [event.kind for event in episode.events()]
    assert kinds.count(EventKind.SKILL_END) == 2 and kinds[-2:] == [EventKind.GOAL, EventKind.HALTED]
    assert episode.cameras == ("front", "side", "wrist")
    joints = list(episode.joints())
    # It counts from the episode's beginning, not from when the controller was switched on.
    assert joints[0].time < 5.0
    gaps = [later.time - earlier.time for earlier, later in pairwise(joints)]
    assert min(gaps) >= 0 and max(gaps) < 5.0
    timings = list(episode.timings())
    assert timings and all(timing.due >= timing.asked for timing in timings)


def test_a_protective_stop_is_cleared_by_the_operator_and_the_task_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked: list[str] = []
    monkeypatch.setattr("builtins.input", lambda prompt: asked.append(prompt) or "clear")
    code, episode = deployed(tmp_path, "protective-stop@20")
    assert code == 0 and len(asked) == 1 and "STOP: the robot made a protective stop" in capsys.readouterr().out
    stops = [event.time for event in episode.events() if event.kind is EventKind.STOP]
    assert len(stops) == 1
    # Nothing is sent for 5 s, and then from where the arm stopped.
    before = [j for j in episode.joints() if j.time <= stops[0]]
    after = [j for j in episode.joints() if j.time > stops[0]]
    assert after[0].time - stops[0] > 4.9
    assert abs(after[0].measured - before[-1].measured).max() < 0.1


def test_a_protective_stop_that_nobody_clears_ends_the_episode(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("builtins.input", lambda prompt: "what?")
    code, episode = deployed(tmp_path, "protective-stop@5")
    assert code == 3
    events = list(episode.events())
    assert events[-2].kind is EventKind.GIVE_UP and "protective stop" in events[-2].text
    assert events[-1].kind is EventKind.HALTED
    (stop,) = (event.time for event in events if event.kind is EventKind.STOP)
    joints = list(episode.joints())
    assert joints and joints[-1].time < stop + 0.1


def test_nobody_says_of_a_controller_that_is_gone_that_its_robot_has_stopped(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
) -> None:
    out, begin = tmp_path / "run", Recorder.on_skill_start
    with emulators.lab_process(tmp_path) as (rig, process):

        def switch_off(recorder: Recorder, skill: GroundSkill) -> None:
            begin(recorder, skill)
            threading.Timer(1.0, process.kill).start()

        monkeypatch.setattr(Recorder, "on_skill_start", switch_off)
        words = ("--backend", "ur7e", "--scenario", "s4", "--seed", "1001", "--out", str(out), "--rig", str(rig))
        assert cli.main(["deploy", *words, "--episodes", "2"]) == 3
    shown = capfd.readouterr()
    assert "Traceback" not in shown.err and "has been stopped" not in shown.out + shown.err
    assert Halt.UNKNOWN.value in shown.out
    assert [
        r for r in caplog.records if r.name == "resync_robot.hardware.ur7e" and Halt.UNKNOWN.value in r.getMessage()
    ]
    (path,) = out.glob("*.mcap")
    episode = read_episode(path)
    assert episode.damage is None
    give_up, known = list(episode.events())[-2:]
    assert give_up.kind is EventKind.GIVE_UP and "stopped" not in give_up.text
    assert (known.kind, known.text) == (EventKind.MAY_MOVE, Halt.UNKNOWN.value)
