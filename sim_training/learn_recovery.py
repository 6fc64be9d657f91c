"""The recovery of one stage, in any domain: attempts fit a model of success, PPO follows it, verdicts end it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float

from resync_robot.core import relations
from resync_robot.core.embodiment import Embodiment, Stage
from resync_robot.core.errors import TrainingError
from resync_robot.core.symbols import Object, Term
from resync_robot.core.task import Domain
from resync_robot.learning.learned_recovery import LearnedRecovery
from resync_robot.learning.recovery_policy import ActorCritic
from resync_robot.learning.relational_view import RelationalView
from resync_robot.learning.success_model import SuccessModel
from resync_robot.learning.terminals import train_terminal
from resync_robot.planning.execute import Model
from resync_robot.sim_training.failure_mining import Explanation, FailedAttempt
from resync_robot.sim_training.ppo import Environment, PpoSettings, Progress, train_policy
from resync_robot.sim_training.recovery_env import Judge, JudgedSettings, RecoveryEnv, Start, try_from


@dataclass(frozen=True, kw_only=True)
class RecoverySettings:
    """How much of everything."""

    attempts: int = 300
    """Runs of the failed skill that the model of success is first fitted to; half of them where nothing obstructs."""
    ppo: PpoSettings = field(
        default_factory=lambda: PpoSettings(
            scenes=32, total_steps=400_000, least_steps=20_000, stop_at=0.95, minibatch=256, anneal_steps=80_000
        )
    )
    elsewhere: int = 60
    """The same, for each other object that the failed skill can be applied to: a recovery is planned for these, too."""
    judged: JudgedSettings = field(default_factory=JudgedSettings)
    width: int = 128
    depth: int = 2
    roll_outs: int = 80
    """Of the finished policy, from which the terminal function is learned."""
    judged_every: int = 2
    """Actions between two verdicts in these."""


@dataclass(frozen=True)
class Problem:
    """The recovery problem of one stage.

    Attributes:
        starts: D^F, the states in which the skill had failed.
        judge: whether it succeeds now.
        view: what the recovery sees.
    """

    embodiment: Embodiment
    stage: Stage
    explanation: Explanation
    starts: tuple[Start, ...]
    judge: Judge
    view: RelationalView

    @property
    def about(self) -> Object:
        """o^R."""
        return self.explanation.objects[self.explanation.argument]


def pose_problem(
    domain: Domain, stage: Stage, model: Model, explanation: Explanation, failures: Sequence[FailedAttempt]
) -> Problem:
    """What is to be learned. Raises TrainingError where the domain declares no embodiment."""
    if domain.embodiment is None:
        raise TrainingError(f"the domain {domain.name} declares no embodiment", "see docs/own-domain.md")
    operator = next(o for o in model.operators if o.name == explanation.skill)
    judge = Judge(
        model.skill(explanation.skill).ground(explanation.objects),
        operator.ground(explanation.objects).add,
        model.abstraction.true_atoms,
    )
    starts = tuple(Start(f.task, f.state) for f in failures)
    view = RelationalView(explanation.projected, domain.relations)
    return Problem(domain.embodiment, stage, explanation, starts, judge, view)


def free_starts(domain: Domain, problem: Problem, first_seed: int, count: int) -> list[Start]:
    """States in which nothing obstructs anything, and everything is there that the recovery is about."""
    if domain.free is None:
        return []
    # One more of what the failure is about: the recovery may be applied to that one instead.
    counts = Counter([o.type for o in problem.view.objects[1:]] + [problem.about.type])
    tasks = [domain.free(np.random.default_rng(s), s, counts) for s in range(first_seed, first_seed + count)]
    return [Start(t, t.initial) for t in tasks if set(problem.view.objects) <= set(t.objects)]


def applied_elsewhere(domain: Domain, problem: Problem, seed: int) -> list[Problem]:
    """The same problem about each other object of the type, as free tasks have them."""
    taken = {*problem.explanation.objects, *problem.explanation.culprits}
    objects = {o for start in free_starts(domain, problem, seed, 1) for o in start.task.objects}
    others = sorted(o for o in objects - taken if o.type == problem.about.type)
    return [_about(problem, other) for other in others]


def attempts_elsewhere(
    domain: Domain, other: Problem, problem: Problem, first_seed: int, count: int
) -> Iterator[tuple[Float[np.ndarray, "n d"], Bool[np.ndarray, "n"]]]:
    """Attempts of a problem about another object: where nothing obstructs, and where what was run into lies beside it
    as it lay in the failures. Nothing, if the skill cannot be applied to it anyway."""
    rng = np.random.default_rng(first_seed)
    free = free_starts(domain, other, first_seed, count)
    if not free:
        return
    features, succeeded = try_from(other.embodiment, free, other.judge, other.view)
    if not succeeded.any():
        return
    yield features, succeeded
    obstructed = []
    for task in (start.task for start in free):
        state = problem.starts[int(rng.integers(len(problem.starts)))].state
        for culprit in problem.explanation.culprits:
            lay = relations.seen(state, culprit, problem.about, domain.relations)
            task = domain.relocate(task, culprit, other.about, lay, rng)
        if other.embodiment.simulate(task).reset(task.initial):
            obstructed.append(Start(task, task.initial))
    if obstructed:
        yield try_from(other.embodiment, obstructed, other.judge, other.view)


def _about(problem: Problem, other: Object) -> Problem:
    """The same problem about another object."""
    binding: dict[Term, Term] = {problem.about: other}
    objects = tuple(other if o == problem.about else o for o in problem.explanation.objects)
    explanation = replace(problem.explanation, objects=objects)
    effects = frozenset(a.substitute(binding) for a in problem.judge.effects)
    judge = replace(problem.judge, failed=problem.judge.failed.skill.ground(objects), effects=effects)
    return replace(
        problem, explanation=explanation, judge=judge, view=replace(problem.view, objects=explanation.projected)
    )


def learn_recovery(
    domain: Domain,
    problem: Problem,
    seed: int,
    checkpoint: Path,
    progress: Progress,
    settings: RecoverySettings | None = None,
) -> tuple[LearnedRecovery, dict[str, Any]]:
    """Learn the stage's recovery; resumes from `checkpoint` where one lies.

    Returns:
        The recovery, and figures: the learning curve, attempts made, verdicts asked for, accuracy of the terminal.

    Raises:
        TrainingError: a terminal function cannot be learned, for the policy hardly ever recovers.
    """
    s = settings or RecoverySettings()
    first = 1_000_000 * (seed + 1)
    tried = [Start(start.task, start.task.initial) for start in problem.starts[: s.attempts // 4]]
    tried += [*problem.starts[: s.attempts // 4], *free_starts(domain, problem, first, s.attempts // 2)]
    features, succeeded = try_from(problem.embodiment, tried, problem.judge, problem.view)
    model = SuccessModel(problem.view.size, seed)
    model.add(features, succeeded)
    for other in applied_elsewhere(domain, problem, first):
        for attempts in attempts_elsewhere(domain, other, problem, first, s.elsewhere // 2):
            model.add(*attempts)
    made = model.attempts
    if model.has_both:
        model.fit()
    opened: list[RecoveryEnv] = []

    @contextmanager
    def open_environment(done: int) -> Iterator[Environment]:
        env = RecoveryEnv(
            problem.embodiment,
            problem.starts,
            problem.judge,
            problem.view,
            model,
            count=s.ppo.scenes,
            horizon=problem.stage.horizon,
            seed=seed + done,
            gamma=s.ppo.gamma,
            settings=s.judged,
        )
        opened.append(env)
        yield env

    torch.manual_seed(seed)
    net = ActorCritic(s.width, s.depth, problem.view.size, len(problem.embodiment.actions))
    curve = train_policy(net, open_environment, s.ppo, seed, checkpoint, progress)
    net.eval()
    more, later = roll_out(problem, net, s.roll_outs, s.judged_every)
    # Every verdict that was asked for says where the skill succeeds, and so when the recovery is done.
    known, verdicts = model.remembered()
    x, y = np.concatenate([known, more]), np.concatenate([verdicts, later])
    done, accuracy = train_terminal(torch.as_tensor(x, dtype=torch.float32), torch.as_tensor(y).long(), seed)
    explanation, types = problem.explanation, tuple(o.type for o in problem.view.objects)
    recovery = LearnedRecovery(
        name=problem.stage.recovery,
        types=types,
        failed_skill=explanation.skill,
        arguments=tuple(_place(problem.view.objects, o) for o in explanation.objects),
        horizon=problem.stage.horizon,
        policy=net,
        done=done,
    )
    figures = {
        "curve": curve,
        "attempts": made,
        "verdicts": sum(env.judged for env in opened),
        "terminal_accuracy": round(accuracy, 4),
    }
    return recovery, figures


def roll_out(
    problem: Problem, net: ActorCritic, count: int, judged_every: int
) -> tuple[Float[np.ndarray, "n d"], Bool[np.ndarray, "n"]]:
    """States that the policy passes from failures on, and a little beyond success; from which the skill succeeds."""
    limits = np.array(list(problem.embodiment.actions.values()))
    middle, half = limits.mean(1), (limits[:, 1] - limits[:, 0]) / 2
    features, labels = [], []
    for start in problem.starts[:count]:
        simulator = problem.embodiment.simulate(start.task)
        simulator.reset(start.state)
        since = 0
        for step in range(problem.stage.horizon):
            seen = problem.view(simulator.observe(live=True).state)
            if step % judged_every == 0:
                features.append(seen)
                labels.append(problem.judge(simulator))
                since += labels[-1]
            # What comes after it is done, the terminal function has to know as well.
            if since > 3:
                break
            with torch.no_grad():
                action = net.act(torch.as_tensor(seen, dtype=torch.float32)[None])[0].clamp(-1, 1).double().numpy()
            simulator.act(middle + half * action, 1.0 / problem.embodiment.rate_hz)
    return np.stack(features), np.array(labels)


def _place(objects: Sequence[Any], obj: Any) -> int:
    """Of an argument of the failed skill among the recovery's own; what the recovery is not about has no place there.

    Raises:
        TrainingError: the failed skill has such an argument.
    """
    if obj not in objects:
        raise TrainingError(
            f"the failed skill takes {obj}, which the recovery does not see",
            "let the failure be about it, or give the skill fewer arguments",
        )
    return list(objects).index(obj)
