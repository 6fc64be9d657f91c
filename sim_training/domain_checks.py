"""The contract of a domain, tried out: what it declares fits together, and its simulator does what learning relies on.

Learning needs worlds that stand, snapshots that it can go back to, a given model that succeeds where nothing is in the
way and fails where a stage is to learn, and contacts that name what it failed on.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import chain
from typing import Any

import numpy as np

from resync_robot.core.domain_faults import faults, skill_faults
from resync_robot.core.embodiment import Embodiment
from resync_robot.core.errors import PlanningError
from resync_robot.core.findings import Finding, Status
from resync_robot.core.state import State
from resync_robot.core.symbols import Type
from resync_robot.core.task import Domain, Sample, Task
from resync_robot.core.world import EffortLimited
from resync_robot.planning.abstract import HOLDS, Abstraction
from resync_robot.planning.execute import EpisodeResult, ExecuteSettings, Listener, Model, plan_and_execute
from resync_robot.planning.search import plan

UNOBSTRUCTED, OBSTRUCTED = 0.95, 0.05
"""Least success of the given model where nothing is in the way, and most of it where a stage is to learn."""
NAMED = 0.8
"""Least share of failures in which something is run into that is an object."""
ACTIONS, KEPT_UP = 24, 6
"""Random actions that are tried, twice from each snapshot; each is repeated so often."""
CLOSE = 0.01
"""Difference of features up to which a simulator will do that does not replay contacts exactly."""

Verdict = tuple[Status, str, str]
"""Status, what was found, and what mends it."""


def examine(domain: Domain, worlds: int = 20) -> Iterator[Finding]:
    """Look at one part after the other; what builds on a part that is broken is not looked at.

    Args:
        worlds: tasks of each scenario.
    """
    broken = [Finding("parts", "fail", *fault) for fault in faults(domain)]
    parts = ("types", "predicates", "operators", "scenarios", "stages")
    yield from broken or [Finding("parts", "ok", ", ".join(f"{len(getattr(domain, p))} {p}" for p in parts))]
    if broken:
        return
    samples: dict[str, tuple[Sample, ...]] = {
        name: tuple(dict.fromkeys((s.sample, s.sample_practice, s.sample_unseen)))
        for name, s in domain.scenarios.items()
    }
    if domain.free is not None:
        samples["free"] = (_as_stages(domain, domain.free),)
    found = [_guarded(f"tasks: {name}", partial(_tasks, domain, ways, worlds)) for name, ways in samples.items()]
    yield from found
    if any(f.status == "fail" for f in found):
        return
    if domain.embodiment is None or domain.free is None:
        lacking = "embodiment" if domain.embodiment is None else "free"
        yield Finding("simulator", "warn", f"no {lacking} is declared, so nothing of it was run", f"give it {lacking}=")
        return
    drawn = {name: [_draw(sample, worlds) for sample in ways] for name, ways in samples.items()}
    yield from _simulated(domain, domain.embodiment, drawn)


def _simulated(domain: Domain, body: Embodiment, drawn: Mapping[str, list[list[Task]]]) -> Iterator[Finding]:
    made: list[Any] = []
    # Made by the domain's own function, which may raise anything.
    yield _guarded("skills", partial(_skills, domain, made))
    if not made:
        return
    model = Model({s.name: s for s in made}, Abstraction(domain.predicates, domain.classifiers), domain.operators)
    scenes = [_guarded(f"scenes: {name}", partial(_scenes, body, list(chain(*ways)))) for name, ways in drawn.items()]
    yield from scenes
    if any(f.status == "fail" for f in scenes):
        return
    tasks = {name: ways[0] for name, ways in drawn.items()}
    first = tasks[domain.stages[0].scenario]
    # An arm takes targets of its joints. Between random ones lie leaps that nobody would send.
    arm = isinstance(body.simulate(first[0]), EffortLimited)
    if not arm:
        yield _guarded("actions", partial(_actions, body, first))
    yield _guarded("snapshots", partial(_snapshots, body, model, first, arm))
    yield _guarded("picture", partial(_picture, body, first[0]))
    for name in ("free", *(name for name, s in domain.scenarios.items() if s.after_stage == 0)):
        yield _guarded(f"given model: {name}", partial(_succeeds, body, model, tasks[name]))
    for stage in domain.stages:
        yield _guarded(f"given model: {stage.scenario}", partial(_fails, body, model, tasks[stage.scenario]))


def _guarded(name: str, check: Callable[[], Verdict]) -> Finding:
    """The finding of a check; whatever the domain's own code raises is one, too."""
    try:
        return Finding(name, *check())
    except Exception as error:
        words = " ".join(str(error).split())
        return Finding(name, "fail", f"raises {type(error).__name__}: {words}", "mend what raises it")


def _draw(sample: Sample, worlds: int) -> list[Task]:
    return [sample(np.random.default_rng(seed), seed) for seed in range(worlds)]


def _as_stages(domain: Domain, free: Callable[[np.random.Generator, int, Mapping[Type, int]], Task]) -> Sample:
    """`free` with as many things of each type as a stage's scenario has."""

    def sample(rng: np.random.Generator, seed: int) -> Task:
        drawn = [domain.scenario(s.scenario).sample(np.random.default_rng(seed), seed) for s in domain.stages]
        counts = Counter[Type]()
        for task in drawn:
            counts |= Counter(o.type for o in task.objects)
        return free(rng, seed, counts)

    return sample


def _tasks(domain: Domain, ways: Sequence[Sample], worlds: int) -> Verdict:
    """Tasks are drawn the same again, consist of what the domain knows, and are not solved but solvable."""
    abstraction = Abstraction(domain.predicates, domain.classifiers)
    lengths: list[int] = []
    drawn, again = ([task for sample in ways for task in _draw(sample, worlds)] for _ in range(2))
    for task, same in zip(drawn, again, strict=True):
        if not isinstance(task, Task):
            return "fail", f"`sample` returns what is of type {type(task).__name__}", "return a Task"
        if task.initial != same.initial:
            return "fail", f"seed {task.seed} gives another world each time", "draw from `rng` only"
        strange = {o.type for o in task.objects} - set(domain.types)
        if strange or set(task.objects) != set(task.initial):
            what = f"of unknown type '{min(strange).name}'" if strange else "not those of the state"
            return "fail", f"objects are {what}", "give Task(state.objects, state, ...)"
        if not all(np.isfinite(task.initial[o]).all() for o in task.objects):
            return "fail", f"seed {task.seed} has a feature that is no number", "mend the sampling"
        values = abstraction.abstract(task.initial)
        odd = next((a for a, p in values.items() if not 0.0 <= p <= 1.0), None)
        if odd is not None:
            return "fail", f"the classifier says {values[odd]} of {odd}", "return a probability, 0 to 1"
        missing = task.goal - set(values)
        if missing:
            return "fail", f"the goal {min(missing)} is about nothing in the state", "take predicates and objects there"
        atoms = frozenset(a for a, p in values.items() if p > HOLDS)
        if task.goal <= atoms:
            return "fail", f"with seed {task.seed} the goal holds from the beginning", "draw tasks that have to be done"
        try:
            lengths.append(len(plan(domain.operators, task.objects, atoms, task.goal).steps))
        except PlanningError as error:
            return "fail", f"no plan with seed {task.seed}: {error.what}", "let the given operators reach every goal"
    return "ok", f"{len(drawn)} drawn twice alike, plans of {min(lengths)} to {max(lengths)} steps", ""


def _skills(domain: Domain, made: list[Any]) -> Verdict:
    skills = domain.embodiment.skills() if domain.embodiment else ()
    for what, fix in skill_faults(domain, skills):
        return "fail", what, fix
    made.extend(skills)
    return "ok", ", ".join(s.name for s in skills), ""


def _scenes(body: Embodiment, tasks: list[Task]) -> Verdict:
    """Every scene stands as it was drawn, in a new simulator and in one that is set to it."""
    moved: list[int] = []
    for task in tasks:
        world = body.simulate(task)
        if not world.reset(task.initial) or _apart(world.perceive(), task.initial) > CLOSE:
            moved.append(task.seed)
    if moved:
        some = ", ".join(map(str, moved[:5]))
        return "fail", f"{len(moved)} of {len(tasks)} do not stand (seeds {some})", "draw things apart, or mend `reset`"
    return "ok", f"{len(tasks)} of {len(tasks)} stand", ""


def _actions(body: Embodiment, tasks: list[Task]) -> Verdict:
    """Least, greatest and random actions leave finite states, and time passes."""
    low, high = (np.array(ends, dtype=float) for ends in zip(*body.actions.values(), strict=True))
    world = body.simulate(tasks[0])
    begun = world.observe().time
    for action in (low, high, *_random(body)):
        world.act(action, 1.0 / body.rate_hz)
        state = world.perceive()
        if not all(np.isfinite(state[o]).all() for o in state):
            return "fail", f"after the action {np.round(action, 3).tolist()} a feature is no number", "mend `act`"
    passed, wanted = world.observe().time - begun, (2 + ACTIONS) / body.rate_hz
    if abs(passed - wanted) > 0.5 / body.rate_hz:
        return "fail", f"after {wanted:g} s the clock says {passed:g} s", "let `act` add its duration to the time"
    return "ok", f"{', '.join(body.actions)}, {body.rate_hz:g} Hz", ""


def _snapshots(body: Embodiment, model: Model, tasks: list[Task], arm: bool) -> Verdict:
    """The same actions from the same snapshot of a failure lead to the same state: random ones, of an `arm` those with
    which it went there."""
    worst = 0.0
    for task in tasks[:5]:
        world, sent = body.simulate(task), _Sent()
        plan_and_execute(world, model, task.goal, ExecuteSettings(max_failures=1), sent)
        actions = sent.actions[-ACTIONS:] if arm else _random(body, task.seed)
        kept, before, ends = world.save(), world.perceive(), []
        for _ in range(2):
            for action in actions:
                world.act(action, 1.0 / body.rate_hz)
            ends.append(world.perceive())
            world.restore(kept)
            worst = max(worst, _apart(world.perceive(), before))
        worst = max(worst, _apart(*ends))
    differ = f"after `restore` features differ by up to {worst:.2g}"
    if worst > CLOSE:
        return "fail", differ, "keep copies of all that moves in `save`"
    if worst > 0:
        return "warn", differ, "exact is better: failures are replayed"
    return "ok", "restored exactly", ""


def _picture(body: Embodiment, task: Task) -> Verdict:
    image = body.simulate(task).picture()
    if not (isinstance(image, np.ndarray) and image.dtype == np.uint8 and image.ndim == 3 and image.shape[2] == 3):
        found = f"{image.dtype} {image.shape}" if isinstance(image, np.ndarray) else type(image).__name__
        return "warn", f"`picture` gives {found}", "return (h, w, 3) uint8, RGB"
    return "ok", f"{image.shape[1]} x {image.shape[0]} px", ""


def _succeeds(body: Embodiment, model: Model, tasks: list[Task]) -> Verdict:
    ends = [_attempt(body, model, task)[0] for task in tasks]
    won = sum(r.success for r in ends)
    if won < UNOBSTRUCTED * len(tasks):
        reason = Counter(r.reason for r in ends if not r.success).most_common(1)[0][0]
        fix = "let nothing be in the way there, or mend the skill"
        return "fail", f"reaches the goal in {won} of {len(tasks)}; most often: {reason}", fix
    return "ok", f"reaches the goal in {won} of {len(tasks)}", ""


def _fails(body: Embodiment, model: Model, tasks: list[Task]) -> Verdict:
    """It fails, and says on what."""
    failed, named = 0, Counter[str]()
    blamed = 0
    for task in tasks:
        result, touched = _attempt(body, model, task)
        failed += not result.success
        if not result.success:
            named.update(touched)
            blamed += bool(touched)
    if len(tasks) - failed > OBSTRUCTED * len(tasks):
        fix = "a stage needs a scenario in which the given model fails"
        return "fail", f"reaches the goal in {len(tasks) - failed} of {len(tasks)}", fix
    if blamed < NAMED * failed:
        fix = "let `contacts` return what the robot, or what it holds, runs into"
        return "fail", f"in {failed - blamed} of {failed} failures nothing is run into", fix
    return "ok", f"fails in {failed} of {len(tasks)}, on {', '.join(n for n, _ in named.most_common(3))}", ""


class _Sent(Listener):
    """Every action, in order."""

    def __init__(self) -> None:
        self.actions: list[Any] = []

    def on_control(self, observation: Any, action: Any) -> None:
        self.actions.append(action)


class _Touched(Listener):
    """The objects that were run into while skills ran, the robot's own arguments excepted."""

    def __init__(self, world: Any) -> None:
        self._world = world
        self.names: set[str] = set()

    def on_control(self, observation: Any, action: Any) -> None:
        self._note()

    def on_skill_end(self, skill: Any, outcome: Any) -> None:
        self._note()

    def _note(self) -> None:
        self.names |= {o.name for o, force in self._world.contacts().items() if force > 0}


def _attempt(body: Embodiment, model: Model, task: Task) -> tuple[EpisodeResult, set[str]]:
    world = body.simulate(task)
    touched = _Touched(world)
    return plan_and_execute(world, model, task.goal, ExecuteSettings(max_failures=1), touched), touched.names


def _random(body: Embodiment, seed: int = 0) -> list[np.ndarray]:
    """A few actions, each kept up for a while, so that something comes of them."""
    low, high = (np.array(ends, dtype=float) for ends in zip(*body.actions.values(), strict=True))
    drawn = np.random.default_rng(seed).uniform(low, high, (ACTIONS // KEPT_UP, len(low)))
    return [action for action in drawn for _ in range(KEPT_UP)]


def _apart(a: State, b: State) -> float:
    """The greatest difference of a feature."""
    return max(float(np.abs(a[o] - b[o]).max(initial=0.0)) for o in b)
