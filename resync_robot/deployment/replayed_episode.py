"""A replay: what is taken from the recording, and whether today's run went as the recorded one did."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

from resync_robot.core.episode import Episode
from resync_robot.core.episode_records import EventKind, Plan
from resync_robot.core.errors import ConfigError, EpisodeError
from resync_robot.core.rig import Rig
from resync_robot.core.skill import GroundSkill
from resync_robot.core.state import State
from resync_robot.core.symbols import Atom, Object
from resync_robot.core.task import Domain, Task
from resync_robot.deployment.recorder import Recorder
from resync_robot.deployment.settings import DeployConfig
from resync_robot.hardware.answers import Answers, Departure, RecordingOverError
from resync_robot.planning.execute import EpisodeEnd
from resync_robot.planning.search import Plan as FoundPlan

SETTINGS = ("perception", "skills", "segmenter", "dry_run")
"""Of `DeployConfig`: they decide what is asked of the world."""
SAME_PROBABILITY = 0.02
"""By which that of an atom may differ: the same program on another processor rounds otherwise."""
ENDS = (EventKind.GOAL, EventKind.GIVE_UP, EventKind.PLANNED, EventKind.STOP)
BROKEN_OFF = (EpisodeEnd.FAULT.value, EpisodeEnd.STOPPED.value)
"""Ends that came from outside of what was asked: the last thing asked had no answer."""


@dataclass(frozen=True)
class Replayed:
    """How a replay went.

    Attributes:
        departure: None where it went as recorded.
        until: s of the episode up to which it went as recorded.
        largest: rad (or m, of the hand's opening) by which a target differed most from the recorded one until then.
        ended: how the recorded run ended, for people; "" where the recording breaks off before.
    """

    departure: Departure | None
    until: float
    largest: float
    ended: str

    @property
    def same(self) -> bool:
        return self.departure is None

    @property
    def verdict(self) -> str:
        """For people."""
        if self.departure is not None:
            return self.departure.what
        end = self.ended or f"the recording breaks off at {self.until:.2f} s"
        return f"same as recorded ({end})"


def settings_of(config: DeployConfig) -> dict[str, Any]:
    """What a recording keeps of them."""
    return {name: getattr(config, name) for name in SETTINGS}


def as_recorded(config: DeployConfig, recording: Episode) -> DeployConfig:
    """The settings of the recorded deployment, but for those that were given anew.

    Raises:
        ConfigError: a goal was given, which another run would have to reach.
    """
    if config.goal is not None:
        raise ConfigError("a replay has the goal of its recording", "leave out --goal")
    meta = recording.meta
    usual = {f.name: f.default for f in fields(DeployConfig)}
    then = {n: meta.settings[n] for n in SETTINGS if n in meta.settings and getattr(config, n) == usual[n]}
    return replace(config, domain=meta.domain, scenario=meta.scenario, seed=meta.seed, **then)


def check_rig(recording: Episode, rig: Rig) -> None:
    """Raises ConfigError where the recording is of another machine: everything would be elsewhere."""
    meta = recording.meta
    if meta.rig_hash == rig.hash:
        return
    controller = meta.rig.get("controller")
    emulated = isinstance(controller, Mapping) and controller.get("emulated")
    example = ", such as --rig hardware/emulated.toml" if emulated else ""
    raise ConfigError(
        f"{recording.path} was recorded on the rig '{meta.rig.get('name')}' ({meta.rig_hash}), not on '{rig.name}' "
        f"({rig.hash})",
        f"give the rig file of that machine as it was then{example}",
    )


def recorded_task(recording: Episode, domain: Domain) -> Task:
    """The recorded episode's objects and goal. Raises EpisodeError, or what `parse_goal` raises."""
    meta = recording.meta
    initial = next(iter(recording.truths()), None) or next(iter(recording.states()), None)
    if initial is None:
        raise EpisodeError(f"{recording.path} holds no states of objects", "record one with resync-robot deploy")
    objects = initial[1].objects
    if meta.objects:
        strange = sorted(set(meta.objects.values()) - set(recording.types))
        if strange:
            raise EpisodeError(f"{recording.path}: /meta names objects of no known type: {', '.join(strange)}")
        objects = tuple(Object(name, recording.types[kind]) for name, kind in meta.objects.items())
    return Task(objects, initial[1], domain.parse_goal(meta.goal, objects), {}, meta.seed)


class ReplayRecorder(Recorder):
    """Records a replay as any episode, and compares what is concluded and begun with what was then.

    What is asked of the world is compared where it is answered, in `resync_robot.hardware.answers`; but who plans
    otherwise is told so here, before the first target differs. Every method raises Departure.
    """

    def compare_with(self, recording: Episode, answers: Answers) -> None:
        self._answers = answers
        self._atoms: Iterator[tuple[float, dict[str, float]]] = recording.atoms()
        self._plans: Iterator[Plan] = (plan for plan in recording.plans() if plan.current is None)
        self._begun = (e.text for e in recording.events() if e.kind is EventKind.SKILL_START)

    def on_perceived(self, state: State, atoms: Mapping[Atom, float]) -> None:
        super().on_perceived(state, atoms)
        _, then = next(self._atoms, (0.0, None))
        if then is None:
            return
        now = {str(atom): float(p) for atom, p in atoms.items()}
        off = {a: abs(now.get(a, 0.0) - then.get(a, 0.0)) for a in {*now, *then}}
        worst = max(sorted(off), key=lambda a: off[a], default="")
        if worst and not off[worst] <= SAME_PROBABILITY:
            self._depart(f"{worst} holds with {now.get(worst, 0.0):.2f}, where it was {then.get(worst, 0.0):.2f}")

    def on_plan(self, plan: FoundPlan, reason: str) -> None:
        super().on_plan(plan, reason)
        then, steps = next(self._plans, None), tuple(map(str, plan.steps))
        if then is not None and steps != then.steps:
            self._depart(f"the plan is {', '.join(steps)}, where it was {', '.join(then.steps)}")

    def on_skill_start(self, skill: GroundSkill) -> None:
        super().on_skill_start(skill)
        then = next(self._begun, None)
        if then is not None and str(skill) != then:
            self._depart(f"it begins {skill}, where the recorded run began {then}")

    def _depart(self, why: str) -> None:
        raise Departure(self._answers.now, why)


def judge(recording: Episode, answers: Answers, end: EpisodeEnd, reason: str, error: BaseException | None) -> Replayed:
    """How a replay went that ended so.

    Args:
        error: what broke it off; None where it came to an end by itself.
    """
    last = next((e for e in reversed(list(recording.events())) if e.kind in ENDS), None)
    # A recording that breaks off holds no end, and neither does one that a fault of this very program ended.
    then = "" if last is None else str(last.details.get("end", ""))
    words = "" if last is None else last.text
    departure: Departure | None = None
    if isinstance(error, Departure):
        departure = error
    elif isinstance(error, RecordingOverError):
        if then and then not in BROKEN_OFF:
            departure = Departure(answers.now, f"it goes on, where the recorded run ended ({words})")
    elif answers.left:
        departure = Departure(answers.now, f"it ends ({reason or end.value}), where the recorded run went on")
    elif then and end.value != then:
        departure = Departure(answers.now, f"it ends ({reason or end.value}), where the recorded run ended ({words})")
    return Replayed(departure, answers.now, answers.largest, words)
