"""What is shown of the plan at a time is what the robot was at then."""

from __future__ import annotations

from pathlib import Path

import pytest

from resync_robot.core.episode import read_episode
from resync_robot.core.episode_records import EpisodeMeta, EventKind
from resync_robot.core.episode_writer import EpisodeWriter
from resync_robot.core.plan_progress import Standing, plan_progress, progress_at
from resync_robot.core.rig import load_rig

SLIDE, PICK, INSERT = "Recover(r, b0, box)", "Pick(r, b1)", "Insert(r, b1, b0)"
STEPS = (SLIDE, PICK, INSERT)
DONE, FAILED, UNDER_WAY, NEXT, LATER = Standing
ATOMS = {"HandEmpty(r)": 1.0}


class Recorded:
    """Writes as the recorder does, and tells what is shown."""

    def __init__(self, path: Path) -> None:
        self.path = path / "episode.mcap"
        meta = EpisodeMeta.of(load_rig(), library_hash="", domain="", scenario="", goal=INSERT, seed=0, backend="sim")
        self.writer = EpisodeWriter(self.path, meta)

    def scanned(self, time: float) -> None:
        self.writer.event(time, EventKind.SCAN, "6 views")
        self.writer.atoms(time, ATOMS)

    def start(self, time: float, step: str) -> None:
        self.writer.event(time, EventKind.SKILL_START, step)

    def end(self, time: float, step: str, ending: str = "done") -> None:
        self.writer.event(time, EventKind.SKILL_END, f"{step}: {ending}", ending=ending)

    def at(self, *times: float) -> list[tuple[str, list[Standing]]]:
        self.writer.close()
        moments = plan_progress(read_episode(self.path))
        return [(m.doing, [standing for _, standing in m.steps]) for m in (progress_at(moments, t) for t in times)]


@pytest.fixture
def recorded(tmp_path: Path) -> Recorded:
    return Recorded(tmp_path)


def test_scanning_done_failed_and_next_are_shown_when_they_are_so(recorded: Recorded) -> None:
    r = recorded
    r.scanned(8.0)
    r.writer.plan(8.5, STEPS, None, "start")
    r.writer.plan(9.0, STEPS, 0, "start")
    r.start(9.0, SLIDE)
    r.end(14.0, SLIDE)
    r.scanned(20.0)
    r.writer.plan(20.0, STEPS, 1, "start")
    r.start(20.0, PICK)
    r.end(25.0, PICK, "blocked")
    r.scanned(30.0)
    r.writer.event(30.0, EventKind.REPLAN, "Pick did not do what it should", failed=PICK)
    r.writer.plan(30.0, STEPS[1:], None, "Pick did not do what it should")
    r.writer.plan(31.0, STEPS[1:], 0, "Pick did not do what it should")
    r.start(31.0, PICK)
    shown = r.at(0.0, 4.0, 8.2, 8.7, 10.0, 15.0, 21.0, 26.0, 30.5, 40.0)
    assert shown == [
        ("scanning", []),
        ("scanning", []),
        ("planning", []),
        (SLIDE, [NEXT, LATER, LATER]),
        (SLIDE, [UNDER_WAY, NEXT, LATER]),
        ("scanning", [DONE, NEXT, LATER]),
        (PICK, [DONE, UNDER_WAY, NEXT]),
        ("scanning", [DONE, FAILED, NEXT]),
        (PICK, [DONE, FAILED, NEXT, LATER]),
        (PICK, [DONE, FAILED, UNDER_WAY, NEXT]),
    ]


def test_a_step_that_said_it_was_done_has_failed_once_the_scan_says_so(recorded: Recorded) -> None:
    r = recorded
    r.scanned(1.0)
    r.writer.plan(1.0, STEPS, None, "start")
    r.start(1.0, SLIDE)
    r.end(5.0, SLIDE)
    r.scanned(9.0)
    r.writer.event(9.0, EventKind.REPLAN, "effects missing", failed=SLIDE)
    r.writer.plan(9.0, STEPS, None, "effects missing")
    assert r.at(6.0, 9.0) == [
        ("scanning", [DONE, NEXT, LATER]),
        (SLIDE, [FAILED, NEXT, LATER, LATER]),
    ]


def test_no_scan_is_shown_where_what_was_perceived_was_there_at_once(recorded: Recorded) -> None:
    """A simulator that is asked, and a grasp that is certain."""
    r = recorded
    r.writer.atoms(0.0, ATOMS)
    r.writer.plan(0.0, STEPS, None, "start")
    r.start(0.0, SLIDE)
    r.end(5.0, SLIDE)
    r.writer.atoms(5.0, ATOMS)
    r.start(6.0, PICK)
    assert r.at(0.0, 5.5) == [(SLIDE, [UNDER_WAY, NEXT, LATER]), ("planning", [DONE, NEXT, LATER])]


def test_what_ran_before_the_plan_is_shown_too(recorded: Recorded) -> None:
    r = recorded
    r.writer.event(7.0, EventKind.SCAN, "6 views")
    r.start(7.0, "Pick(r, b2)")
    r.end(11.0, "Pick(r, b2)")
    r.scanned(15.0)
    r.writer.plan(15.0, (INSERT,), None, "start")
    assert r.at(3.0, 8.0, 13.0, 16.0) == [
        ("scanning", []),
        ("Pick(r, b2)", [UNDER_WAY]),
        ("scanning", [DONE]),
        (INSERT, [DONE, NEXT]),
    ]


def test_skills_that_end_at_once_share_a_time_with_the_next_plan(recorded: Recorded) -> None:
    """Simulated time stands still while somebody plans anew."""
    r = recorded
    r.writer.atoms(0.0, ATOMS)
    r.writer.plan(0.0, (SLIDE, PICK), None, "start")
    r.writer.plan(0.0, (SLIDE, PICK), 0, "start")
    r.start(0.0, SLIDE)
    r.end(0.0, SLIDE, "refused")
    r.writer.atoms(0.0, ATOMS)
    r.writer.event(0.0, EventKind.REPLAN, "again", failed=SLIDE)
    r.writer.plan(0.0, (SLIDE, PICK), None, "again")
    r.writer.plan(0.0, (SLIDE, PICK), 0, "again")
    r.start(0.0, SLIDE)
    assert r.at(1.0) == [(SLIDE, [FAILED, UNDER_WAY, NEXT])]


@pytest.mark.parametrize(
    ("kind", "words", "last"),
    [
        (EventKind.GOAL, "goal reached", DONE),
        (EventKind.GIVE_UP, "given up: a fault", FAILED),
        (EventKind.STOP, "stopped: a fault", FAILED),
    ],
)
def test_the_end_is_shown(recorded: Recorded, kind: EventKind, words: str, last: Standing) -> None:
    r = recorded
    r.scanned(1.0)
    r.writer.plan(1.0, STEPS, None, "start")
    r.start(1.0, SLIDE)
    if kind is EventKind.GOAL:
        r.end(2.0, SLIDE)
    r.writer.event(3.0, kind, "a fault")
    r.writer.event(3.1, EventKind.HALTED, "it has stopped")
    assert r.at(4.0) == [(words, [last, NEXT, LATER])]


def test_a_stop_that_was_released_leaves_the_step_under_way(recorded: Recorded) -> None:
    r = recorded
    r.scanned(1.0)
    r.writer.plan(1.0, STEPS, None, "start")
    r.start(1.0, SLIDE)
    r.writer.event(3.0, EventKind.STOP, "protective stop")
    r.end(9.0, SLIDE, "blocked")
    r.scanned(12.0)
    assert r.at(4.0, 10.0) == [
        ("stopped: protective stop", [UNDER_WAY, NEXT, LATER]),
        ("scanning", [FAILED, NEXT, LATER]),
    ]


def test_a_torn_recording_ends_in_the_middle_of_a_scan(recorded: Recorded) -> None:
    r = recorded
    r.scanned(1.0)
    r.writer.plan(1.0, STEPS, None, "start")
    r.start(1.0, SLIDE)
    r.end(2.0, SLIDE)
    assert r.at(100.0) == [("scanning", [DONE, NEXT, LATER])]
