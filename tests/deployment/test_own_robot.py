"""A domain's own robot is deployed, recorded and shown as the arm is, by what the recording itself holds."""

from __future__ import annotations

import json
import os
import signal
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from resync_robot import cli
from resync_robot.core.episode import read_episode
from resync_robot.core.episode_records import SCENE_VIEW, EventKind
from resync_robot.core.episode_writer import EpisodeWriter
from resync_robot.core.library import save_library
from resync_robot.core.symbols import ROUND
from resync_robot.deployment import film
from resync_robot.deployment.own_film import OwnFilm
from resync_robot.deployment.own_robot import EffortLimitedWorld, OwnRobot, RecordedWorld
from resync_robot.sim_training.domains import world_task
from tests.domains import PUCK_DOMAIN, PUCK_FILE, puck
from tests.libraries import own_library
from tests.planning.other_planner import solve

R, P0, PAD = puck.ROBOT("r"), puck.PUCK("p0"), puck.PAD("pad0")
OPEN = world_task(PUCK_DOMAIN, "open", 0, 0)


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("learned") / "library"
    save_library(own_library(PUCK_DOMAIN), path)
    return path


def deployed(library: Path, out: Path, *more: str, scenario: str = "open") -> int:
    """The exit code."""
    domain = ("--domain", str(PUCK_FILE), "--scenario", scenario)
    return cli.main(["deploy", *domain, "--library", str(library), "--out", str(out), *more])


@pytest.fixture(scope="module")
def recording(library: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("run")
    assert deployed(library, out) == 0
    (path,) = out.glob("*.mcap")
    return path


def test_a_recording_is_read_without_its_domain(recording: Path) -> None:
    episode = read_episode(recording)
    assert recording.name == f"episode-000-open-seed{OPEN.seed}.mcap" and episode.damage is None
    meta = episode.meta
    assert (meta.domain, meta.scenario, meta.goal, meta.rig, meta.rig_hash) == (
        "puck-behind-a-door", "open", "At(p0, pad0)", {}, "",
    )  # fmt: skip
    assert meta.objects == {o.name: o.type.name for o in OPEN.objects}
    assert set(episode.types) == {t.name for t in PUCK_DOMAIN.types}
    assert episode.types["door"].extents == ("length", "thickness") and episode.types["stone"].symmetry == ROUND
    assert not list(episode.joints()) and "/robot_description" not in episode.messages


def test_states_follow_what_moves(recording: Path) -> None:
    episode = read_episode(recording)
    for states in (list(episode.states()), list(episode.truths())):
        assert states[0] == (0.0, OPEN.initial)
        times = np.array([t for t, _ in states])
        assert times[-1] > 5.0 and np.diff(times).max() < 0.11, "ten actions a second"
        steps = np.diff([s[P0][:2] for _, s in states], axis=0)
        assert 0.01 < np.linalg.norm(steps, axis=1).max() < 0.03, "carried at 0.2 m/s"
        last = states[-1][1]
        assert np.linalg.norm(last[P0][:2] - last[PAD][:2]) < 0.04


def test_plan_events_and_atoms_are_there(recording: Path) -> None:
    episode = read_episode(recording)
    assert next(episode.plans()).steps == ("Fetch(r, p0)", "Bring(r, p0, pad0)")
    start, end = EventKind.SKILL_START, EventKind.SKILL_END
    assert [e.kind for e in episode.events()] == [start, end, start, end, EventKind.GOAL]
    atoms = list(episode.atoms())
    assert atoms[0][1]["HandEmpty(r)"] == 1.0 and atoms[0][1].get("At(p0, pad0)", 0.0) == 0.0
    assert atoms[-1][1]["At(p0, pad0)"] == 1.0


def test_the_simulator_s_pictures_are_a_film_ten_times_a_second(recording: Path) -> None:
    episode = read_episode(recording)
    assert episode.cameras == (SCENE_VIEW,)
    pictures = list(episode.film(SCENE_VIEW))
    np.testing.assert_allclose([t for t, _ in pictures], 0.1 * np.arange(len(pictures)), atol=1e-6)
    shown = cv2.imdecode(np.frombuffer(pictures[0][1], np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    assert np.abs(shown.astype(int) - puck.Rooms(OPEN).picture()).mean() < 3
    assert pictures[-1][0] == pytest.approx(episode.duration, abs=0.11)


def test_it_is_drawn_with_what_is_true_and_what_is_seen(recording: Path, tmp_path: Path) -> None:
    import rerun as rr

    assert cli.main(["review", str(recording), "--save", str(tmp_path / "e.rrd")]) == 0
    drawn = rr.dataframe.load_recording(tmp_path / "e.rrd")
    entities = {c.entity_path for c in drawn.schema().component_columns()}
    assert {f"/plane/{kind}/{name}" for kind in ("truth", "belief") for name in ("r", "p0", "pad0", "door")} <= entities
    assert {"/world/cameras/scene/colour", "/plan", "/events", "/atoms_now", "/about"} <= entities
    rows = drawn.view(index="time", contents="/plane/truth/p0").select().read_all().to_pydict()
    places = [v[0] for v in rows["/plane/truth/p0:Points2D:positions"] if v]
    truths = [s[P0][:2] * (1, -1) for _, s in read_episode(recording).truths()]
    np.testing.assert_allclose(places[0], truths[0], atol=1e-6)
    np.testing.assert_allclose(places[-1], truths[-1], atol=1e-6)


def test_a_film_shows_the_picture_the_plan_and_what_holds(recording: Path, tmp_path: Path) -> None:
    episode = read_episode(recording)
    frames = OwnFilm(episode)
    first, last = frames.frame(0.0), frames.frame(episode.duration)
    assert first.shape == (film.HEIGHT, film.WIDTH, 3)
    scene = slice(film.BAR, film.BAR + film.SCENE[1])

    def reds(frame: np.ndarray) -> float:
        """Where the puck is, px from the left."""
        red = frame[scene].astype(int)
        return float(np.nonzero((red[..., 0] > 170) & (red[..., 1] < 90))[1].mean())

    assert reds(last) > reds(first) + 100, "the puck was brought to the right"
    assert np.abs(first[scene.stop :].astype(int) - last[scene.stop :]).max() > 50
    out = tmp_path / "still.png"
    assert cli.main(["review", str(recording), "--picture", str(out), "--at", "0"]) == 0
    still = cv2.imread(str(out))[..., ::-1]
    assert np.abs(still.astype(int) - puck.Rooms(OPEN).picture()).mean() < 3
    assert cli.main(["review", str(recording), "--video", str(tmp_path / "e.mp4"), "--speed", "50"]) == 0
    assert (tmp_path / "e.mp4").stat().st_size > 5000


def test_without_pictures_there_is_no_film(library: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert deployed(library, tmp_path, "--record-pictures", "0") == 0
    (path,) = tmp_path.glob("*.mcap")
    assert not read_episode(path).cameras
    assert cli.main(["review", str(path), "--video", str(tmp_path / "e.mp4")]) == 2
    assert "holds no pictures to show" in capsys.readouterr().err


def test_a_dry_run_moves_nothing_and_writes_pddl(
    library: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert deployed(library, tmp_path / "run", "--dry-run", "--pddl", str(tmp_path / "pddl")) == 0
    assert "Episode 1/1: planned (2 steps); 0 skills" in capsys.readouterr().out
    found = solve(tmp_path / "pddl" / "domain.pddl", tmp_path / "pddl" / "problem.pddl")
    assert found == [("fetch", "r", "p0"), ("bring", "r", "p0", "pad0")]
    (path,) = (tmp_path / "run").glob("*.mcap")
    episode = read_episode(path)
    assert [e.kind for e in episode.events()] == [EventKind.PLANNED] and len(list(episode.film(SCENE_VIEW))) == 1


def test_a_step_that_is_not_confirmed_is_not_run(
    library: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []
    monkeypatch.setattr("builtins.input", lambda prompt: asked.append(prompt) or "n")
    assert deployed(library, tmp_path, "--confirm") == 3
    assert asked == ["Run Fetch(r, p0)? [y/N] "]
    (path,) = tmp_path.glob("*.mcap")
    assert [e.kind for e in read_episode(path).events()] == [EventKind.STOP]


def test_a_goal_is_checked_before_anything_is_recorded(
    library: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert deployed(library, tmp_path, "--goal", "Holding(r, p0)") == 0
    (path,) = tmp_path.glob("*.mcap")
    assert read_episode(path).meta.goal == "Holding(r, p0)"
    for goal, word in (("Holding(r, p9)", "unknown object 'p9'"), ("Holding(r, p0), HandEmpty(r)", "no plan reaches")):
        assert deployed(library, tmp_path / "none", "--goal", goal) == 2
        assert word in capsys.readouterr().err and not (tmp_path / "none").exists()


def test_every_episode_has_a_world_of_its_own_and_one_that_fails_counts(
    library: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The given model alone does not open doors."""
    assert deployed(library, tmp_path, "--episodes", "2", "--seed", "3", scenario="door") == 3
    shown = capsys.readouterr().out
    assert "0 of 2 episodes reached the goal" in shown and "Episode 2/2: failed (stuck: " in shown
    first, second = (read_episode(p) for p in sorted(tmp_path.glob("*.mcap")))
    assert next(first.truths())[1] == world_task(PUCK_DOMAIN, "door", 3, 0).initial
    assert next(second.truths())[1] == world_task(PUCK_DOMAIN, "door", 3, 1).initial
    assert [e.kind for e in first.events()][-1] is EventKind.GIVE_UP


@pytest.mark.parametrize("place", ["act", "picture", "observe"])
def test_whoever_ends_it_finds_a_whole_recording(
    place: str,
    library: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    plain, calls = getattr(puck.Rooms, place), [0]

    def counted(world: Any, *args: Any) -> Any:
        calls[0] += 1
        if calls[0] == 25:
            os.kill(os.getpid(), signal.SIGINT)
        return plain(world, *args)

    # A file is loaded anew by each command; the class that is counted has to be the one that runs.
    monkeypatch.setattr("resync_robot.commands.deploy._domain", lambda config: PUCK_DOMAIN)
    monkeypatch.setattr(puck.Rooms, place, counted)
    assert deployed(library, tmp_path, "--episodes", "2") == 128 + signal.SIGINT
    shown = capsys.readouterr()
    assert shown.err.splitlines()[-1] == "interrupted by Ctrl-C" and "Traceback" not in shown.err
    (path,) = tmp_path.glob("*.mcap")
    assert f"Episode 1/2: stopped (interrupted by Ctrl-C); 0 skills. Recording: {path}" in shown.out
    episode = read_episode(path)
    assert episode.damage is None and len(list(episode.truths())) > 10
    assert (last := list(episode.events())[-1]).kind is EventKind.STOP and last.text == "interrupted by Ctrl-C"
    assert cli.main(["review", str(path), "--save", str(tmp_path / "e.rrd")]) == 0


def test_a_replay_of_it_is_refused(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["deploy", "--backend", "replay", "--replay", str(recording)]) == 2
    told = capsys.readouterr().err
    assert "a replay needs an arm" in told and f"resync-robot review {recording}" in told


def test_a_scene_that_does_not_stand_is_not_recorded(
    library: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("resync_robot.commands.deploy._domain", lambda config: PUCK_DOMAIN)
    monkeypatch.setattr(puck.Rooms, "reset", lambda self, state, plain=puck.Rooms.reset: plain(self, state) and False)
    assert deployed(library, tmp_path) == 2
    assert "does not stand still" in capsys.readouterr().err and not list(tmp_path.glob("*.mcap"))


class Told:
    """Stands for a recorder."""

    def __init__(self) -> None:
        self.moments: list[float] = []
        self.seen: list[Any] = []

    def on_moment(self, time: float) -> None:
        self.moments.append(time)

    def on_seen(self, state: Any) -> None:
        self.seen.append(state)


def test_the_recorder_hears_of_each_action_and_observation() -> None:
    robot, told = OwnRobot(puck.Rooms(OPEN)), Told()
    world = RecordedWorld(robot, told)  # type: ignore[arg-type]
    assert world.perceive() == OPEN.initial
    for _ in range(3):
        world.act(np.array([0.1, 0.0, -1.0]), 0.1)
    seen = world.observe(live=True)
    assert told.moments == pytest.approx([0.0, 0.1, 0.2, 0.3]) and told.seen == [seen.state]
    assert robot.truth() == seen.state and seen.state[R][0] == pytest.approx(OPEN.initial[R][0] + 0.03)


def test_a_picture_is_kept_where_the_simulator_paints_over_it() -> None:
    class Painter:
        canvas = np.zeros((2, 2, 3), np.uint8)

        def picture(self) -> np.ndarray:
            self.canvas += 1
            return self.canvas

    robot = OwnRobot(Painter())  # type: ignore[arg-type]
    first, second = robot.glimpse(), robot.glimpse()
    assert first.colour.max() == 1 and second.colour.max() == 2 and first.name == SCENE_VIEW


def test_a_limit_of_effort_reaches_the_simulator() -> None:
    class Strong:
        def limit_effort(self, limit: object) -> None:
            self.limit = limit

    strong = Strong()
    EffortLimitedWorld(OwnRobot(strong), Told()).limit_effort((1.0,))  # type: ignore[arg-type]
    assert strong.limit == (1.0,)


def test_types_that_make_no_sense_are_an_error_of_the_recording(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    meta = read_episode(recording).meta
    for i, types in enumerate(({"robot": 3}, {"robot": {"features": ["x"]}}, {"disc": json.loads('{"pose": ["q"]}')})):
        path = tmp_path / f"{i}.mcap"
        with EpisodeWriter(path, replace(meta, types=types)) as writer:
            writer.state(0.0, OPEN.initial)
        assert cli.main(["review", str(path), "--save", str(tmp_path / "e.rrd")]) == 2
        assert "the types in /meta make no sense" in capsys.readouterr().err
