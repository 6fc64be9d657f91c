"""Learns the recoveries of Icy Transport: how often they succeed in fresh tasks, and where they were not learned.

python tests/benchmarks/icy_recoveries.py [--stage 1] [--seed 0] [--worlds 100] [--pictures FOLDER]
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
from PIL import Image

from resync_robot.core.embodiment import TrainingSimulator
from resync_robot.core.skill import GroundSkill, Skill
from resync_robot.core.task import Task
from resync_robot.planning.abstract import Abstraction
from resync_robot.planning.execute import ExecuteSettings, Listener, Model, plan_and_execute
from resync_robot.planning.skill_run import run_skill
from resync_robot.sim_training.domains.icy_transport import ICY_TRANSPORT
from resync_robot.sim_training.failure_mining import explain, mine_stage
from resync_robot.sim_training.learn_recovery import learn_recovery
from resync_robot.sim_training.recovery_problem import Problem, Start, pose_problem

BODY = ICY_TRANSPORT.embodiment
assert BODY is not None
MODEL = Model(
    {s.name: s for s in BODY.skills()},
    Abstraction(ICY_TRANSPORT.predicates, ICY_TRANSPORT.classifiers),
    ICY_TRANSPORT.operators,
)
FRESH = 900_000_000
"""First world seed; training seeds stay far below it."""
ELSEWHERE = {
    "IcyDrive": (("1", "o2", "ice"), ("2", "target", "ice"), ("5", "o1", "ice"), ("9", "o2", "ice")),
    "MuddyDrive": (("4", "o2", "mud"), ("7", "target", "mud"), ("5", "o2", "mud"), ("10", "o1", "mud")),
}
"""Scenarios in which a recovery was not learned, and what it is applied to there."""


class Film(Listener):
    """Counts the actions, and those after the car was caught; keeps a picture of every fifth of these."""

    def __init__(self, simulator: TrainingSimulator) -> None:
        self._simulator = simulator
        self.steps, self.caught, self.pictures = 0, 0, list[np.ndarray]()

    def on_control(self, observation: object, action: object) -> None:
        self.steps += 1
        if self.caught or self._simulator.contacts():
            if self.caught % 5 == 0:
                self.pictures.append(self._simulator.picture())
            self.caught += 1


def fresh(problem: Problem, ground: GroundSkill, worlds: int, unseen: bool, strips: list[np.ndarray]) -> None:
    """Succeeds, if it says that it is done and the failed skill then reaches its effects."""
    scenario, ends, actions = ICY_TRANSPORT.scenario(problem.stage.scenario), Counter[str](), []
    for seed in range(FRESH, FRESH + worlds):
        sample = scenario.sample_unseen if unseen else scenario.sample
        task = sample(np.random.default_rng(seed), seed)
        simulator = BODY.simulate(task)
        film = Film(simulator)
        outcome = run_skill(simulator, ground, film)
        good = outcome.done and problem.judge(simulator, task.initial)
        ends["recovered" if good else f"not recovered ({outcome.ending.value})"] += 1
        actions.append(film.caught)
        if len(strips) < 4:
            strips.append(np.hstack([*film.pictures, *[simulator.picture()] * 8][:8]))
    words = ", ".join(f"{n} {what}" for what, n in ends.most_common())
    physics = "physics that training never draws" if unseen else "fresh tasks"
    print(f"{physics}: {words}; {min(actions)} to {max(actions)} actions, median {np.median(actions):.0f}", flush=True)


def elsewhere(skill: Skill, name: str, arguments: tuple[str, str], worlds: int) -> None:
    """From the beginning of a task: is the region off afterwards?"""
    off, ends, steps = 0, Counter[str](), []
    for seed in range(FRESH, FRESH + worlds):
        task: Task = ICY_TRANSPORT.scenario(name).sample(np.random.default_rng(seed), seed)
        simulator = BODY.simulate(task)
        named = {o.name: o for o in task.objects}
        film = Film(simulator)
        outcome = run_skill(simulator, skill.ground(tuple(named[a] for a in ("robot", *arguments))), film)
        crossed = simulator.perceive().get(named[arguments[1]], "active")[0] == 0
        off += crossed
        ends[f"{outcome.ending.value}, {'crossed' if crossed else 'not crossed'}"] += 1
        plan_and_execute(simulator, MODEL, task.goal, ExecuteSettings(max_failures=1), film)
        steps.append(film.steps)
    words = ", ".join(f"{n} {what}" for what, n in ends.most_common())
    print(f"scenario {name}, {arguments}: {off} of {worlds}; {words}; {min(steps)} to {max(steps)} actions in all")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--stage", type=int, default=1, choices=[1, 2])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--worlds", type=int, default=100)
    parser.add_argument("--pictures", type=Path, help="folder for a picture of what the recovery does")
    args = parser.parse_args()
    stage, begun = ICY_TRANSPORT.stages[args.stage - 1], time.monotonic()
    failures = mine_stage(ICY_TRANSPORT, BODY, stage, MODEL, 1_000_000 * args.seed, 200)
    found = explain(ICY_TRANSPORT, failures)
    problem = pose_problem(ICY_TRANSPORT, BODY, stage, MODEL, found, [Start(f.task, f.state) for f in failures])
    with tempfile.TemporaryDirectory() as folder:
        learned = learn_recovery(problem, args.seed, Path(folder) / "ppo.safetensors", lambda *_: None)
    recovery, figures = learned.recovery, learned.figures
    curve = figures.pop("curve")
    print(f"{stage.recovery}: {time.monotonic() - begun:.0f} s, {curve['steps'][-1]:.0f} steps, {figures}", flush=True)
    skill = recovery.skill(MODEL.skill(found.skill), BODY, ICY_TRANSPORT.relations)
    strips: list[np.ndarray] = []
    for unseen in (False, True):
        fresh(problem, skill.ground(found.projected), args.worlds, unseen, strips)
    for name, *arguments in ELSEWHERE[stage.recovery]:
        elsewhere(skill, name, (arguments[0], arguments[1]), args.worlds // 2)
    if args.pictures is not None:
        args.pictures.mkdir(parents=True, exist_ok=True)
        Image.fromarray(np.vstack(strips)).save(args.pictures / f"{stage.recovery}.png")


if __name__ == "__main__":
    main()
