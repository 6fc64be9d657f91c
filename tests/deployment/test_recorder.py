"""The recorder writes what the executive, the stream and the scans tell it, so that a reader finds it again."""

from __future__ import annotations

import threading
from pathlib import Path

import cv2
import numpy as np
import pytest

from resync_robot.core.episode import Episode, read_episode
from resync_robot.core.episode_records import EpisodeMeta, EventKind, Timing
from resync_robot.core.episode_writer import EpisodeWriter
from resync_robot.core.joints import JointTarget
from resync_robot.core.rig import load_rig
from resync_robot.core.skill import SkillEnd, SkillOutcome
from resync_robot.core.world import CameraFrame, Glimpse
from resync_robot.deployment.recorder import CLOUD_POINTS, Recorder, cloud
from resync_robot.hardware.base import Command, Halt, RobotState, StaleError
from resync_robot.library_models import initial_model
from resync_robot.planning.execute import EpisodeEnd
from resync_robot.planning.search import plan
from resync_robot.sim_training.domains import find_domain
from tests import scenes
from tests.libraries import DOMAIN
from tests.scenes import B0, B1, R

RIG = load_rig()
STATE = scenes.scene({"b0": (0.0, 0.0), "b1": (0.1, 0.1)}).initial
MODEL = initial_model(find_domain(DOMAIN), RIG)
ON = find_domain(DOMAIN).predicate("On")
PLAN = plan(MODEL.operators, STATE.objects, MODEL.abstraction.true_atoms(STATE), frozenset({ON(B0, B1)}))
PICK = MODEL.skill("Pick").ground((R, B0))


def frame(name: str = "front", depth: int = 5000, time: float = 0.0) -> CameraFrame:
    pose = np.eye(4)
    pose[:3, 3] = [0.0, 0.0, 1.0]
    intrinsics = np.array([[100.0, 0, 32], [0, 100.0, 24], [0, 0, 1]])
    colour = np.zeros((48, 64, 3), np.uint8)
    colour[..., 0] = 200
    return CameraFrame(name, colour, np.full((48, 64), depth, np.uint16), intrinsics, pose, time)


class Session:
    """A recorder at work on a file, and its reader afterwards."""

    def __init__(self, path: Path, **more: object) -> None:
        meta = EpisodeMeta.of(
            RIG, library_hash="", domain=DOMAIN, scenario="s1", goal="On(b0, b1)", seed=0, backend="sim"
        )
        self.path, self.now, self.told = path, 0.0, []
        self.writer = EpisodeWriter(path, meta)
        self.recorder = Recorder(self.writer, lambda: self.now, tell=self.told.append, **more)

    def read(self) -> Episode:
        self.writer.close()
        return read_episode(self.path)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "episode.mcap"


def test_plans_and_skills_are_told_and_recorded_in_their_order(path: Path) -> None:
    s = Session(path)
    s.recorder.on_perceived(STATE, MODEL.abstraction.abstract(STATE))
    s.recorder.on_plan(PLAN, "start")
    s.now = 1.0
    s.recorder.on_step_of_plan(0)
    s.recorder.on_skill_start(PICK)
    s.now = 3.0
    s.recorder.on_skill_end(PICK, SkillOutcome(SkillEnd.BLOCKED, "a wall"))
    s.recorder.on_effects_missing(PLAN.steps[0])
    s.recorder.on_plan(PLAN, "it did not work")
    s.recorder.on_end(EpisodeEnd.STUCK, "again and again")
    episode = s.read()
    assert [(e.time, e.kind) for e in episode.events()] == [
        (1.0, EventKind.SKILL_START),
        (3.0, EventKind.SKILL_END),
        (3.0, EventKind.REPLAN),
        (3.0, EventKind.GIVE_UP),
    ]
    _, end, replan, gave_up = episode.events()
    assert replan.details == {"failed": "Pick(r, b0)"} and gave_up.details == {"end": "stuck"}
    assert end.text == "Pick(r, b0): blocked, a wall" and end.details["ending"] == "blocked"
    assert [(p.current, p.reason) for p in episode.plans()] == [
        (None, "start"),
        (0, "start"),
        (None, "it did not work"),
    ]
    assert next(episode.plans()).steps == ("Pick(r, b0)", "Insert(r, b0, b1)")
    assert next(episode.states())[1] == STATE
    assert next(episode.atoms())[1]["HandEmpty(r)"] == 1.0
    assert s.told[0].strip() == "plan (start): Pick(r, b0), Insert(r, b0, b1)"
    assert not list(episode.truths())


@pytest.mark.parametrize(
    ("end", "kind"),
    [
        (EpisodeEnd.GOAL, EventKind.GOAL),
        (EpisodeEnd.PLANNED, EventKind.PLANNED),
        (EpisodeEnd.STOPPED, EventKind.STOP),
        (EpisodeEnd.NO_PLAN, EventKind.GIVE_UP),
        (EpisodeEnd.EXHAUSTED, EventKind.GIVE_UP),
    ],
)
def test_every_end_is_an_event(path: Path, end: EpisodeEnd, kind: EventKind) -> None:
    s = Session(path)
    s.recorder.on_end(end, "")
    (event,) = s.read().events()
    assert event.kind is kind and event.text == end.value


def glimpse(name: str = "front", time: float = 0.0) -> Glimpse:
    return Glimpse(name, frame(name).colour, time)


@pytest.mark.parametrize("live", [False, True])
def test_the_stream_is_recorded_with_a_film_and_truth_once_in_a_while(path: Path, live: bool) -> None:
    s = Session(path, truth=lambda: STATE, cameras=[lambda: glimpse(time=s.now)], film_hz=5.0, live=live)
    asked, sent = JointTarget(np.full(6, 0.2), 0.1), JointTarget(np.full(6, 0.1), 0.1)
    for i in range(30):
        s.now = 0.1 * i
        state = RobotState(s.now, np.full(6, 0.05), np.zeros(6), np.array([0.0, 0.0, 3.0]), 0.09)
        s.recorder.on_stream(state, Command(s.now, asked, sent))
        s.writer.flush()
    episode = s.read()
    joints = list(episode.joints())
    assert len(joints) == 30
    np.testing.assert_allclose(joints[3].requested.arm, 0.2)
    np.testing.assert_allclose(joints[3].sent.arm, 0.1)
    np.testing.assert_allclose(joints[3].measured, 0.05)
    film = list(episode.film("front"))
    np.testing.assert_allclose([time for time, _ in film], 0.2 * np.arange(15), atol=0.01)
    shown = cv2.imdecode(np.frombuffer(film[0][1], np.uint8), cv2.IMREAD_COLOR)
    np.testing.assert_allclose(shown[..., ::-1], frame().colour, atol=4)
    assert episode.cameras == ("front",) and not list(episode.pictures("front"))
    assert len(list(episode.truths())) == 3
    assert next(episode.tip_force())[1][2] == 3.0


def test_a_scan_is_recorded_as_pictures_and_a_cloud(path: Path) -> None:
    s = Session(path)
    seen = frame("wrist", time=0.0)
    s.recorder.on_picture(seen)
    s.recorder.on_scan([seen], STATE)
    episode = s.read()
    assert [e.kind for e in episode.events()] == [EventKind.SCAN]
    (picture,) = episode.pictures("wrist")
    assert picture.colour is not None
    shown = cv2.imdecode(np.frombuffer(picture.colour, np.uint8), cv2.IMREAD_COLOR)
    np.testing.assert_array_equal(shown[..., ::-1], seen.colour)
    points = next(episode.points())
    np.testing.assert_allclose(points.xyz[:, 2], 1.5, atol=1e-5)
    assert (points.rgb[:, 0] == 200).all()


def test_a_cloud_is_where_its_pixels_look_and_thin_enough() -> None:
    xyz, rgb = cloud([frame(depth=5000), frame(depth=0), frame(depth=10000)])
    # 0.5 m and 1 m along the optical axis of cameras that stand at z = 1 m; nothing where nothing was measured.
    assert set(np.round(np.unique(xyz[:, 2]), 4)) == {1.5, 2.0}
    assert np.abs(xyz[:, 0] / (xyz[:, 2] - 1)).max() == pytest.approx(0.32)
    assert len(xyz) == len(rgb) <= 2 * CLOUD_POINTS
    assert xyz.dtype == np.float32 and rgb.dtype == np.uint8


def test_confirmation_is_passed_on(path: Path) -> None:
    asked = []
    s = Session(path, confirm=lambda step: asked.append(str(step)) or False)
    assert s.recorder.confirm(PLAN.steps[0]) is False
    assert asked == ["Pick(r, b0)"]


def test_a_silent_camera_holds_up_nothing_and_costs_nobody_elses_pictures(path: Path) -> None:
    """At a robot whose time goes on by itself, whoever streams must not wait for a picture, nor pictures pile up."""
    asked, told = 0, threading.Event()

    def silent() -> Glimpse:
        nonlocal asked
        asked += 1
        told.wait(10.0)
        raise StaleError("the camera is silent")

    s = Session(path, cameras=[silent, lambda: glimpse("side")], film_hz=10.0, live=True)
    command = Command(0.0, JointTarget(np.zeros(6), 0.1), JointTarget(np.zeros(6), 0.1))

    def stream(count: int, begin: int = 0) -> None:
        for i in range(begin, begin + count):
            s.recorder.on_stream(RobotState(i, np.zeros(6), np.zeros(6), np.zeros(3), 0.09), command)

    stream(100)
    assert not told.is_set()
    told.set()
    s.writer.flush()
    assert asked == 1, "the looks have not queued up behind it"
    stream(1, begin=100)
    episode = s.read()
    assert s.writer.error is None and episode.damage is None
    assert len(list(episode.joints())) == 101
    assert asked == len(list(episode.film("side"))) == 2


def test_timings_are_recorded(path: Path) -> None:
    s = Session(path)
    timings = [Timing(None, 1.0, 1.01, 0.002), Timing(1.9, 2.0, 2.01, 0.001)]
    for timing in timings:
        s.recorder.on_timing(timing)
    assert list(s.read().timings()) == timings


def test_doubt_is_told_and_recorded_with_its_figures(path: Path) -> None:
    session = Session(path)
    session.recorder.on_doubt({ON(B0, B1): 0.62}, 3)
    session.recorder.on_unsettled(("b1",), "the scan did not find b1")
    event, unsettled = (e for e in session.read().events() if e.kind is EventKind.DOUBT)
    assert event.details["shares"] == {"On(b0, b1)": 0.62}
    assert unsettled.details["objects"] == ["b1"] and "did not find b1" in unsettled.text
    assert "after 3 looks" in event.text
    assert any("in doubt" in line and "0.62" in line for line in session.told)


@pytest.mark.parametrize(("halt", "kind"), [(Halt.STOPPED, EventKind.HALTED), (Halt.UNKNOWN, EventKind.MAY_MOVE)])
def test_what_is_known_of_a_robot_at_the_end_is_an_event(path: Path, halt: Halt, kind: EventKind) -> None:
    s = Session(path)
    s.recorder.on_halt(halt)
    (event,) = s.read().events()
    assert (event.kind, event.text) == (kind, halt.value)


def test_once_the_robot_is_let_go_its_cameras_are_left_alone(path: Path, caplog: pytest.LogCaptureFixture) -> None:
    def gone() -> Glimpse:
        raise StaleError("the camera is closed")

    s = Session(path, cameras=[gone], live=True)
    s.recorder.let_go()
    command = Command(0.0, JointTarget(np.zeros(6), 0.1), JointTarget(np.zeros(6), 0.1))
    s.recorder.on_stream(RobotState(0.0, np.zeros(6), np.zeros(6), np.zeros(3), 0.09), command)
    assert s.read().damage is None and not caplog.records
