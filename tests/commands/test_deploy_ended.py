"""Whoever ends a deployment, and however it ends, finds a whole recording that says so."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from resync_robot.core.episode import read_episode
from resync_robot.core.episode_records import EventKind
from resync_robot.core.episode_writer import EpisodeWriter
from resync_robot.core.rig import Rig
from resync_robot.deployment import devices as simulated
from resync_robot.deployment import world as worlds
from resync_robot.deployment.recorder import Recorder
from resync_robot.hardware import devices as machines
from resync_robot.hardware.base import Halt
from resync_robot.sim_training.domains import find_domain, world_task
from tests.commands.deployments import RIG, episodes, oracle


def tell_to_end(number: int) -> Callable[..., Any]:
    """Does nothing but to have this process told to end."""
    return lambda *_, **__: os.kill(os.getpid(), number)


def before(monkeypatch: pytest.MonkeyPatch, owner: type, name: str, happen: Callable[..., Any]) -> None:
    """Have `happen` happen before a method does what it does."""
    original = getattr(owner, name)

    def both(*args: Any, **kwargs: Any) -> Any:
        happen()
        return original(*args, **kwargs)

    monkeypatch.setattr(owner, name, both)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("phase", ["look", "plan", "confirm", "motion"])
def test_whoever_ends_it_finds_a_whole_recording_that_says_so(
    renderer: None,
    library: Path,
    tmp_path: Path,
    phase: str,
    number: signal.Signals,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    end = tell_to_end(number)
    monkeypatch.setattr("builtins.input", end if phase == "confirm" else lambda prompt: "y")
    if phase == "look":
        before(monkeypatch, worlds.OracleWorld, "perceive", end)
    if phase == "plan":
        before(monkeypatch, Recorder, "on_plan", end)
    if phase == "motion":
        before(monkeypatch, Recorder, "on_stream", end)
    assert oracle(library, tmp_path / "run", "--confirm", "--episodes", "2") == 128 + number
    shown = capsys.readouterr()
    words = "interrupted by Ctrl-C" if number == signal.SIGINT else f"ended by {number.name}"
    assert shown.err.splitlines()[-1] == words and "Traceback" not in shown.err
    (path,) = episodes(tmp_path / "run")
    assert f"Episode 1/2: stopped ({words}); 0 skills. Recording: {path}" in shown.out
    episode = read_episode(path)
    assert episode.damage is None
    last = list(episode.events())[-1]
    assert (last.kind, last.text) == (EventKind.STOP, words)


@pytest.mark.parametrize(("owner", "name"), [(Recorder, "let_go"), (EpisodeWriter, "close")])
def test_ended_while_it_ends_the_recording_is_whole_all_the_same(
    renderer: None,
    library: Path,
    tmp_path: Path,
    owner: type,
    name: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    before(monkeypatch, owner, name, tell_to_end(signal.SIGTERM))
    assert oracle(library, tmp_path / "run", "--dry-run", "--episodes", "2") == 128 + signal.SIGTERM
    (path,) = episodes(tmp_path / "run")
    assert f"Episode 1/2: planned (2 steps); 0 skills. Recording: {path}" in capsys.readouterr().out
    episode = read_episode(path)
    assert episode.damage is None and [e.kind for e in episode.events()] == [EventKind.PLANNED]


@pytest.mark.parametrize("halt", Halt)
def test_what_is_known_of_the_robot_is_the_same_in_result_recording_and_exit_code(
    renderer: None,
    library: Path,
    tmp_path: Path,
    halt: Halt,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Simulated devices in place of a real arm's, which is let go when all else is done."""

    @contextmanager
    def opened(layout: machines.Layout, rig: Rig) -> Iterator[machines.Devices]:
        task = world_task(find_domain(layout.domain), layout.scenario, layout.seed, layout.episode)
        with simulated.open_simulated(task, rig) as devices:
            yield replace(devices, halt=lambda: halt)

    monkeypatch.setattr(machines, "open_ur7e", opened)
    known = halt is Halt.STOPPED
    out = tmp_path / "run"
    code = oracle(library, out, "--backend", "ur7e", "--rig", RIG, "--dry-run", "--episodes", "2")
    shown = capsys.readouterr().out
    assert code == (0 if known else 3)
    assert ("assume that it may still move" in shown) != known and ("emergency stop" in shown) != known
    # Nothing is begun with a robot of which nobody knows whether it moves.
    assert len(episodes(out)) == (2 if known else 1) and ("other 1 episodes are not begun" in shown) != known
    for path in episodes(out):
        last = list(read_episode(path).events())[-1]
        assert (last.kind, last.text) == (EventKind.HALTED if known else EventKind.MAY_MOVE, halt.value)
