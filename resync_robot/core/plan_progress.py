"""How the work stood at each moment of a recording: whether the robot scans, what is done, has failed, and is next."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

from resync_robot.core.episode import Episode
from resync_robot.core.episode_records import Event, EventKind, Plan


class Standing(Enum):
    """Of one step."""

    DONE = "done"
    FAILED = "failed"
    UNDER_WAY = "under way"
    NEXT = "next"
    LATER = "later"


@dataclass(frozen=True)
class PlanProgress:
    """
    Attributes:
        time: s of the episode from which on it stands so.
        doing: what the robot does: "scanning", "planning", the step under way or about to begin, or how it ended.
        reason: why the plan was made; empty before the first.
        steps: every step that was run, and those that the plan still holds, in order.
    """

    time: float
    doing: str
    reason: str
    steps: tuple[tuple[str, Standing], ...]


def plan_progress(episode: Episode) -> tuple[PlanProgress, ...]:
    """Every change, by time; the first holds from the beginning. Raises EpisodeError on a message without sense."""
    return _Story(episode).tell()


def progress_at(moments: Sequence[PlanProgress], time: float) -> PlanProgress:
    """How it stood at `time`, given what `plan_progress` returned."""
    return moments[max(0, bisect_right(moments, time, key=lambda m: m.time) - 1)]


_AFTER = (EventKind.HALTED, EventKind.MAY_MOVE)
"""Told once the episode is over."""
_SIGHT = (EventKind.SCAN, EventKind.DOUBT)
_VERDICTS = {
    EventKind.GOAL: "goal reached",
    EventKind.PLANNED: "planned, nothing run",
    EventKind.GIVE_UP: "given up",
    EventKind.STOP: "stopped",
}


class _Story:
    """Follows the events in their order. Simulated time stands still while somebody computes, so many messages share
    one time, and only those of one channel are known to be in order: a plan is taken up when an event asks for it.
    """

    def __init__(self, episode: Episode) -> None:
        self._events = list(episode.events())
        self._perceived = [time for time, _ in episode.atoms()]
        self._plans: deque[Plan] = deque()
        last: Plan | None = None
        for plan in episode.plans():
            # The others only tell which step of the same plan begins, as the events do.
            if plan.current is None or last is None or (plan.steps, plan.reason) != (last.steps, last.reason):
                self._plans.append(plan)
            last = plan
        self._past: list[tuple[str, Standing]] = []
        self._now: str | None = None
        self._ahead: list[str] = []
        self._reason = ""
        self._scans_until: float | None = None
        self._moments: dict[float, PlanProgress] = {}

    def tell(self) -> tuple[PlanProgress, ...]:
        self._tell(0.0, "planning")
        self._scan(0.0, 0)
        for i, event in enumerate(self._events):
            self._go_on(event.time)
            self._take(event, i)
        self._go_on(float("inf"))
        return tuple(self._moments[time] for time in sorted(self._moments))

    def _take(self, event: Event, i: int) -> None:
        self._mark_failed(event.details.get("failed"))
        if event.kind is EventKind.SKILL_START:
            while self._plans and self._plans[0].time <= event.time and self._ahead[:1] != [event.text]:
                self._take_up(self._plans.popleft())
            self._scans_until, self._now = None, event.text
            if self._ahead[:1] == [event.text]:
                self._ahead.pop(0)
            self._tell(event.time, event.text)
        elif event.kind is EventKind.SKILL_END:
            step = self._now or event.text.partition(": ")[0]
            done = event.details.get("ending") == "done"
            self._end_step(step, Standing.DONE if done else Standing.FAILED)
            self._tell(event.time, "planning")
            self._scan(event.time, i + 1)
        elif event.kind is EventKind.REPLAN and self._plans and self._plans[0].time <= event.time:
            self._take_up(self._plans.popleft())
        elif event.kind in _VERDICTS:
            self._judge(event, i)

    def _judge(self, event: Event, i: int) -> None:
        """The end, or a stop that a person may still release."""
        while self._plans and self._plans[0].time <= event.time:
            self._take_up(self._plans.popleft())
        if self._now is not None and all(later.kind in _AFTER for later in self._events[i + 1 :]):
            self._end_step(self._now, Standing.FAILED)
        self._scans_until = None
        verdict = _VERDICTS[event.kind]
        why = event.text if event.kind in (EventKind.GIVE_UP, EventKind.STOP) else ""
        self._tell(event.time, f"{verdict}: {why}" if why else verdict)

    def _scan(self, since: float, i: int) -> None:
        """A look begins at `since`, before event `i`, unless what was perceived is there at once."""
        seen, until = since, float("inf")
        for event in self._events[i:]:
            if event.kind in _SIGHT:
                seen = event.time
            elif event.kind is not EventKind.STOP:
                until = event.time
                break
        perceived = next((time for time in self._perceived if time >= seen), float("inf"))
        if min(perceived, until) > since:
            self._scans_until = min(perceived, until)
            self._tell(since, "scanning")

    def _go_on(self, until: float) -> None:
        """What happens before the next event."""
        while self._plans and self._plans[0].time < until:
            self._end_scan(self._plans[0].time)
            self._take_up(self._plans.popleft())
        self._end_scan(until)

    def _end_scan(self, time: float) -> None:
        if self._scans_until is not None and self._scans_until <= time < float("inf"):
            self._tell(self._scans_until, "planning")
            self._scans_until = None

    def _take_up(self, plan: Plan) -> None:
        self._ahead, self._reason = list(plan.steps[plan.current or 0 :]), plan.reason
        self._tell(plan.time, self._ahead[0] if self._ahead else "planning")

    def _end_step(self, step: str, standing: Standing) -> None:
        self._past.append((step, standing))
        self._now = None

    def _mark_failed(self, step: object) -> None:
        """It said that it was done, and what was seen then says that it was not."""
        for i in range(len(self._past) - 1, -1, -1):
            if self._past[i][0] == step:
                self._past[i] = (self._past[i][0], Standing.FAILED)
                return

    def _tell(self, time: float, doing: str) -> None:
        under_way = [(self._now, Standing.UNDER_WAY)] if self._now is not None else []
        ahead = [(step, Standing.LATER) for step in self._ahead]
        if ahead:
            ahead[0] = (ahead[0][0], Standing.NEXT)
        self._moments[time] = PlanProgress(time, doing, self._reason, (*self._past, *under_way, *ahead))
