"""A replay goes as its recording did, or says when it departed and why."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.records import Channel, Message

from resync_robot import cli
from resync_robot.core import ros_messages
from resync_robot.core.episode import Episode, read_episode
from resync_robot.core.episode_records import Answer, Ask, EpisodeMeta, EventKind
from resync_robot.core.episode_writer import EpisodeWriter
from resync_robot.core.errors import ConfigError, PerceptionError
from resync_robot.core.joints import JointTarget
from resync_robot.core.library import save_library
from resync_robot.core.mcap_file import read_whole, write_whole
from resync_robot.core.rig import Rig, load_rig
from resync_robot.core.state import State
from resync_robot.core.task import Task
from resync_robot.core.world import CameraFrame, Glimpse
from resync_robot.deployment import devices as simulated
from resync_robot.deployment.episode import film_of
from resync_robot.deployment.recorder import Recorder
from resync_robot.deployment.replayed_episode import as_recorded, check_rig, judge, recorded_task
from resync_robot.deployment.settings import DeployConfig
from resync_robot.deployment.world import DeployedWorld
from resync_robot.hardware.answers import Answers, Departure, RecordingOverError
from resync_robot.hardware.devices import Devices, open_replay
from resync_robot.hardware.sim import SimRobot
from resync_robot.perception.catalogue import Catalogue
from resync_robot.planning.execute import EpisodeEnd
from resync_robot.sim_training.domains import find_domain
from resync_robot.sim_training.physics.world import SimWorld
from tests import scenes
from tests.libraries import DOMAIN, given_library
from tests.perception.raycast import FLOOR, Table

RIG = load_rig()


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("given") / "library"
    save_library(given_library(), folder)
    return folder


@contextmanager
def blind(task: Task, rig: Rig) -> Iterator[simulated.SimulatedDevices]:
    """The simulated robot without its cameras, which nobody needs where the simulator tells the truth."""
    world = SimWorld(task, rig)
    with SimRobot(world) as robot:
        yield simulated.SimulatedDevices(
            robot=robot,
            cameras={},
            clock=lambda: world.time,
            truth=world.perceive,
            live=world.perceive,
            film=(lambda: Glimpse("side", np.full((8, 12, 3), 90, np.uint8), world.time),),
            film_hz=4.0,
        )


@pytest.fixture(scope="module")
def recorded(library: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An episode of two skills, driven through the simulator's own state."""
    out = tmp_path_factory.mktemp("recorded")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulated, "open_simulated", blind)
        words = ("--library", str(library), "--perception", "oracle", "--scenario", "s4", "--seed", "1004")
        assert cli.main(["deploy", *words, "--out", str(out)]) == 0
    (path,) = out.glob("*.mcap")
    return path


def replayed(path: Path, library: Path, out: Path, *more: str) -> tuple[int, Episode]:
    words = ("--library", str(library), "--backend", "replay", "--replay", str(path), "--out", str(out), *more)
    code = cli.main(["deploy", *words])
    (found,) = out.glob("*.mcap")
    assert found.name == path.name
    return code, read_episode(found)


def altered(path: Path, out: Path, topic: str, alter: Callable[[int, int, Any], Any]) -> Path:
    """The recording with other messages on a channel: of (index, how many, content) the new content, or None."""
    records = read_whole(path).records
    named = {r.id: r.topic for r in records if isinstance(r, Channel)}
    rows = [i for i, r in enumerate(records) if isinstance(r, Message) and named[r.channel_id] == topic]
    kept: list[Any] = list(records)
    for k, i in enumerate(rows):
        content = alter(k, len(rows), json.loads(ros_messages.text_data(records[i].data)))
        kept[i] = None if content is None else replace(records[i], data=ros_messages.string(json.dumps(content)))
    write_whole([r for r in kept if r is not None], out)
    return out


def test_a_recording_of_this_version_is_replayed_the_same(
    recorded: Path, library: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    code, again = replayed(recorded, library, tmp_path)
    said = capsys.readouterr().out
    assert code == 0
    assert "Episode 1/1: same as recorded (goal); 2 skills" in said and "1 of 1 episodes went as recorded." in said
    first = read_episode(recorded)
    # Neither scenario nor seed nor --perception was given.
    assert (again.meta.scenario, again.meta.seed, again.meta.goal) == ("s4", first.meta.seed, first.meta.goal)
    assert again.meta.settings == first.meta.settings and again.meta.objects == first.meta.objects
    assert [(e.kind, e.text, e.time) for e in again.events()] == [
        (e.kind, e.text, pytest.approx(e.time, abs=1e-6)) for e in first.events()
    ]
    # The film answers nothing.
    film = [time for time, _ in first.film("side")]
    assert len(film) > 4 * 0.8 * first.duration and np.median(np.diff(film)) == pytest.approx(0.25, abs=0.021)
    # A replay can be replayed.
    assert [a.ask for _, a in again.answers()] == [a.ask for _, a in first.answers()]
    then, now = list(first.joints()), list(again.joints())
    assert len(now) > 0.9 * len(then)
    np.testing.assert_array_equal(now[100].measured, then[100].measured)


def test_one_joint_altered_in_the_middle_is_a_departure_at_that_time(
    recorded: Path, library: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    moments: list[float] = []

    def alter(k: int, count: int, content: Any) -> Any:
        if not moments and k > count / 2 and content["ask"] == "MEASURE":
            content["details"]["arm"][1] += 0.2
            moments.append(content["clock"])
        return content

    path = altered(recorded, tmp_path / recorded.name, "/answer", alter)
    capsys.readouterr()
    code, again = replayed(path, library, tmp_path / "again")
    said = capsys.readouterr().out
    assert code == 3 and "0 of 1 episodes went as recorded." in said
    (line,) = (line for line in said.splitlines() if "departed at" in line)
    assert float(line.split("departed at ")[1].split(" s, because ")[0]) == pytest.approx(moments[0], abs=0.2)
    assert "is sent to" in line or "where the recorded run" in line
    last = list(again.events())[-1]
    assert last.kind is EventKind.GIVE_UP and "departed at" in last.text


def test_a_plan_that_is_another_today_is_named(
    recorded: Path, library: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = altered(recorded, tmp_path / recorded.name, "/plan", lambda k, n, c: c | {"steps": ["Wave(r)"]})
    assert replayed(path, library, tmp_path / "again")[0] == 3
    assert "because the plan is Pick(r, " in capsys.readouterr().out


def test_atoms_that_are_others_today_are_named(
    recorded: Path, library: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong = {"atoms": {"HandEmpty(r)": 0.25}}
    path = altered(recorded, tmp_path / recorded.name, "/atoms", lambda k, n, c: wrong if k == 1 else c)
    assert replayed(path, library, tmp_path / "again")[0] == 3
    assert ", where it was 0." in capsys.readouterr().out


def test_a_recording_that_breaks_off_is_the_same_as_far_as_it_goes(
    recorded: Path, library: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    half = altered(recorded, tmp_path / "half.mcap", "/answer", lambda k, n, c: c if k < n // 2 else None)
    path = altered(half, tmp_path / recorded.name, "/event", lambda k, n, c: c if c["kind"] == "skill start" else None)
    assert replayed(path, library, tmp_path / "again")[0] == 0
    assert "same as recorded (the recording breaks off at " in capsys.readouterr().out


def test_another_rig_is_refused_before_anything_is_written(
    recorded: Path, library: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    episode = read_episode(recorded)
    rig = load_rig(Path(__file__).parents[2] / "hardware" / "emulated.toml")
    with pytest.raises(ConfigError, match="was recorded on the rig"):
        check_rig(episode, rig)
    of_emulated = replace(episode, meta=EpisodeMeta.of(
        rig, library_hash="", domain=DOMAIN, scenario="s1", goal="", seed=0, backend="ur7e"
    ))  # fmt: skip
    with pytest.raises(ConfigError) as error:
        check_rig(of_emulated, load_rig())
    assert "--rig hardware/emulated.toml" in error.value.fix
    check_rig(of_emulated, rig)


def test_settings_are_those_of_the_recording_unless_given_and_a_goal_is_refused(recorded: Path) -> None:
    episode = read_episode(recorded)
    taken = as_recorded(DeployConfig(backend="replay", replay=recorded), episode)
    assert (taken.scenario, taken.seed, taken.perception, taken.skills) == ("s4", episode.meta.seed, "oracle", "state")
    assert as_recorded(DeployConfig(skills="camera"), episode).skills == "camera"
    with pytest.raises(ConfigError, match="has the goal of its recording"):
        as_recorded(DeployConfig(goal="On(b1,b0)"), episode)


def test_what_is_filmed_is_what_the_cameras_can_unless_told_otherwise() -> None:
    devices = Devices(robot=None, cameras={}, clock=lambda: 0.0, truth=None, film=(lambda: None,), film_hz=2.0)  # type: ignore[arg-type]
    for wanted, hz in ((None, 2.0), (7.5, 7.5)):
        assert film_of(DeployConfig(record_pictures=wanted), devices) == (devices.film, hz)
    assert film_of(DeployConfig(record_pictures=0.0), devices)[0] == ()


def test_the_task_is_that_of_the_recording(recorded: Path) -> None:
    episode, domain = read_episode(recorded), find_domain(DOMAIN)
    task = recorded_task(episode, domain)
    assert {o.name: o.type.name for o in task.objects} == dict(episode.meta.objects)
    assert ", ".join(map(str, sorted(task.goal))) == episode.meta.goal


@pytest.mark.parametrize(
    ("then", "end", "error", "left", "why"),
    [
        (EpisodeEnd.GOAL, EpisodeEnd.GOAL, None, 0, ""),
        (EpisodeEnd.STUCK, EpisodeEnd.STUCK, None, 0, ""),
        (EpisodeEnd.STUCK, EpisodeEnd.GOAL, None, 0, "it ends (goal), where the recorded run ended (stuck)"),
        (EpisodeEnd.GOAL, EpisodeEnd.GOAL, None, 1, "it ends (goal), where the recorded run went on"),
        (
            EpisodeEnd.GOAL,
            EpisodeEnd.FAULT,
            RecordingOverError("more"),
            0,
            "it goes on, where the recorded run ended (goal)",
        ),
        (EpisodeEnd.FAULT, EpisodeEnd.FAULT, RecordingOverError("more"), 0, ""),
        (EpisodeEnd.STOPPED, EpisodeEnd.FAULT, RecordingOverError("more"), 0, ""),
        (None, EpisodeEnd.FAULT, RecordingOverError("more"), 0, ""),
        (EpisodeEnd.GOAL, EpisodeEnd.FAULT, Departure(1.5, "it waves"), 3, "it waves"),
    ],
)
def test_how_two_runs_ended_is_compared(
    then: EpisodeEnd | None, end: EpisodeEnd, error: Exception | None, left: int, why: str, tmp_path: Path
) -> None:
    rig = load_rig()
    meta = EpisodeMeta.of(rig, library_hash="", domain=DOMAIN, scenario="s1", goal="", seed=0, backend="sim")
    target = JointTarget(rig.arm.home, 0.1)
    with EpisodeWriter(tmp_path / "e.mcap", meta) as writer:
        for k in range(3):
            writer.answer(Answer(Ask.REST, 0.5 * k, target))
        if then is not None:
            kind = EventKind.GOAL if then is EpisodeEnd.GOAL else EventKind.GIVE_UP
            writer.event(1.0, kind, then.value, end=then.value)
        # What is said of the robot afterwards is no end of the run.
        writer.event(1.1, EventKind.HALTED, "it has stopped")
    episode = read_episode(tmp_path / "e.mcap")
    answers = Answers(episode)
    for _ in range(3 - left):
        answers.take(Ask.REST)
    found = judge(episode, answers, end, "", error)
    assert found.same == (not why)
    if why:
        assert found.departure is not None and found.departure.why == why
        assert found.verdict == f"departed at {found.departure.time:.2f} s, because {why}"
    else:
        assert found.verdict.startswith("same as recorded (")


class Eye:
    """A wrist camera that sees a drawn table from where the arm really is, with noise that JPEG would not keep."""

    name = "wrist"

    def __init__(self, robot: SimRobot) -> None:
        self._robot, self._rng = robot, np.random.default_rng(0)
        self.table = Table(RIG, Catalogue())
        self.table.block("b0", 0.45, 0.05, FLOOR, 0.2, 0.060, 0.045)

    def connect(self) -> None: ...

    def close(self) -> None: ...

    def capture(self) -> CameraFrame:
        now = self._robot.state()
        frame = self.table.picture(now.q)
        noise = self._rng.integers(-3, 4, frame.colour.shape)
        colour = np.clip(frame.colour.astype(int) + noise, 0, 255).astype(np.uint8)
        return replace(frame, colour=colour, time=now.time)


def test_a_scan_is_replayed_bit_by_bit_and_exchanged_pictures_are_not(tmp_path: Path) -> None:
    """The whole way of a picture, from a camera over the recording to the belief, without a renderer."""
    path = tmp_path / "e.mcap"
    meta = EpisodeMeta.of(RIG, library_hash="", domain=DOMAIN, scenario="s1", goal="", seed=0, backend="sim")
    world = SimWorld(scenes.scene({"b0": (0.0, 0.1)}), RIG)
    with SimRobot(world) as robot, EpisodeWriter(path, meta) as writer:
        recorder = Recorder(writer, lambda: world.time)
        seeing = DeployedWorld(robot, {"wrist": Eye(robot)}, RIG, world.task.objects, witness=recorder)
        seeing.stream.recorders.append(recorder.on_stream)
        before = seeing.perceive()

    def again(path: Path) -> State:
        episode = read_episode(path)
        with open_replay(episode) as devices:
            seeing = DeployedWorld(
                devices.robot, devices.cameras, RIG, world.task.objects, stream=devices.stream, ready=devices.ready
            )
            return seeing.perceive()

    assert again(path) == before
    exchanged = tmp_path / "exchanged.mcap"
    exchange(path, exchanged)
    try:
        after = again(exchanged)
    except (Departure, PerceptionError):
        return
    assert after != before


def exchange(path: Path, out: Path) -> None:
    """The recording with the wrist's pictures in reverse order."""
    records = list(read_whole(path).records)
    named = {r.id: r.topic for r in records if isinstance(r, Channel)}
    for kind in ("colour", "depth"):
        topic = f"/camera/wrist/{kind}"
        rows = [i for i, r in enumerate(records) if isinstance(r, Message) and named[r.channel_id] == topic]
        data = [records[i].data for i in rows]
        for i, other in zip(rows, reversed(data), strict=True):
            records[i] = replace(records[i], data=other)
    write_whole(records, out)


@pytest.mark.slow
def test_a_scan_is_replayed_bit_by_bit_and_an_exchanged_picture_is_a_departure(
    renderer: None, library: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("--library", str(library), "--dry-run", "--scenario", "s2", "--seed", "1002", "--out", str(tmp_path))
    assert cli.main(["deploy", *words]) == 0
    (path,) = tmp_path.glob("*.mcap")
    code, again = replayed(path, library, tmp_path / "again")
    assert code == 0 and "same as recorded (2 steps)" in capsys.readouterr().out
    first = read_episode(path)
    for (_, now), (_, then) in zip(again.states(), first.states(), strict=True):
        assert now == then
    exchanged = tmp_path / "exchanged" / path.name
    exchanged.parent.mkdir()
    exchange(path, exchanged)
    assert replayed(exchanged, library, tmp_path / "2")[0] == 3
    assert "departed at" in capsys.readouterr().out


@pytest.mark.slow
def test_an_episode_by_camera_with_a_recovery_is_replayed_the_same(
    renderer: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With the shipped library: pictures, a policy that looks while it moves, and a limit on what it presses with."""
    cli.main(["deploy", "--scenario", "s1", "--seed", "1001", "--out", str(tmp_path)])
    (path,) = tmp_path.glob("*.mcap")
    asks = {answer.ask for _, answer in read_episode(path).answers()}
    assert asks >= {Ask.MEASURE, Ask.PICTURE, Ask.PART, Ask.THOUGHT, Ask.REST}
    assert cli.main(["deploy", "--backend", "replay", "--replay", str(path), "--out", str(tmp_path / "again")]) == 0
    assert "same as recorded (" in capsys.readouterr().out
