"""What Blocked Stacking is like: how fast, how fair, whether its recoveries can be done, and whether they are learned.

python tests/benchmarks/blocked_stacking.py speed
python tests/benchmarks/blocked_stacking.py given [--worlds 60]
python tests/benchmarks/blocked_stacking.py scripted [--worlds 50] [--pictures FOLDER]
python tests/benchmarks/blocked_stacking.py learn --stage 1 [--scenario 6] [--seed 0] [--pictures FOLDER]
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from resync_robot.core.task import Task
from resync_robot.planning.abstract import Abstraction
from resync_robot.planning.execute import ExecuteSettings, Listener, Model, plan_and_execute
from resync_robot.planning.skill_run import run_skill
from resync_robot.sim_training.domains import find_domain
from resync_robot.sim_training.domains.blocked_stacking.layouts import UNSEEN, USUAL, Layout
from resync_robot.sim_training.failure_mining import FailedAttempt, attempt

DOMAIN = find_domain("blocked-stacking")
BODY = DOMAIN.embodiment
assert BODY is not None
MODEL = Model({s.name: s for s in BODY.skills()}, Abstraction(DOMAIN.predicates, DOMAIN.classifiers), DOMAIN.operators)
DURATION = 1.0 / BODY.rate_hz

Actions = Sequence[tuple[float, ...]]
SCRIPTED: Mapping[str, tuple[str, Actions]] = {
    "Punch": (
        "0",
        # Aside of the slab, down onto the block, and off with it to the left.
        [(-0.05, 0, 0, 0, 0)] * 3 + [(0, -0.05, 0, 0.1, 0)] + [(-0.05, -0.03, 0, 0.05, 0)] * 6,
    ),
    "Wiggle": (
        "6",
        # Down between crate and block, and to the left.
        [(0.05, 0.03, 0, 0, 0)] * 2 + [(0, -0.05, 0, 0.05, 0)] + [(-0.05, -0.01, 0, 0, 0)] * 6,
    ),
    "Fiddle": (
        "14",
        # As Punch, to the right.
        [(0.05, 0, 0, 0, 0)] * 2 + [(0, -0.05, 0, 0.1, 0)] + [(0.05, -0.03, 0, 0.05, 0)] * 7,
    ),
}
"""Recovery -> a scenario with its obstruction alone, and actions that are the same in all worlds."""


def failures(scenario: str, seeds: Sequence[int]) -> Iterator[FailedAttempt]:
    for seed in seeds:
        found = attempt(BODY, DOMAIN.scenario(scenario).sample(np.random.default_rng(seed), seed), MODEL)
        if found is not None:
            yield found


def recovers(found: FailedAttempt, actions: Actions, frames: list[np.ndarray] | None = None) -> bool:
    """Whether the skill that failed succeeds after these actions."""
    world = BODY.simulate(found.task)
    world.reset(found.state)
    for action in actions:
        if frames is not None:
            frames.append(world.picture())
        world.act(np.array(action), DURATION)
    if frames is not None:
        frames.append(world.picture())
    run_skill(world, MODEL.skill(found.skill).ground(found.objects))
    operator = next(o for o in DOMAIN.operators if o.name == found.skill)
    return operator.ground(found.objects).add <= MODEL.abstraction.true_atoms(world.perceive())


def strip(frames: Sequence[np.ndarray], path: Path, x: float) -> None:
    """Frames beside each other, around x in m."""
    middle = min(max(int(x * 160), 110), frames[0].shape[1] - 110)
    Image.fromarray(np.hstack([f[60:, middle - 110 : middle + 110] for f in frames])).save(path)


def speed() -> None:
    rng, low, high = np.random.default_rng(0), *np.array(list(BODY.actions.values())).T
    for name in ("free", *(s.scenario for s in DOMAIN.stages)):
        if name == "free":
            world = BODY.simulate(DOMAIN.free(rng, 0, {}))
        else:
            found = next(failures(name, range(9)))
            world = BODY.simulate(found.task)
            world.reset(found.state)
        kept, begun, count = world.save(), time.process_time(), 1000
        for i in range(count):
            if i % 10 == 0:
                world.restore(kept)
            world.act(rng.uniform(low, high), DURATION)
        what = "where nothing is near" if name == "free" else f"where the skill failed in scenario {name}"
        print(f"{1e3 * (time.process_time() - begun) / count:.3f} ms a random action {what}")


class _Count(Listener):
    actions = 0

    def on_control(self, observation: Any, action: Any) -> None:
        self.actions += 1


def given(worlds: int) -> None:
    """The given model alone."""

    def unobstructed(seed: int) -> Task:
        return Layout().draw(np.random.default_rng(seed), seed, UNSEEN if seed % 2 else USUAL)

    def anything(seed: int) -> Task:
        return DOMAIN.free(np.random.default_rng(seed), seed, dict.fromkeys(DOMAIN.types, 1))

    ways = {"nothing": unobstructed, "aside": anything}
    ways |= {n: lambda seed, s=s: s.sample(np.random.default_rng(seed), seed) for n, s in DOMAIN.scenarios.items()}
    for name, draw in ways.items():
        won, lengths, reasons = 0, [], Counter[str]()
        for seed in range(5000, 5000 + worlds):
            task, count = draw(seed), _Count()
            result = plan_and_execute(BODY.simulate(task), MODEL, task.goal, ExecuteSettings(max_failures=1), count)
            won += result.success
            lengths.append(count.actions)
            reasons[result.reason.split(" did not")[0]] += not result.success
        why = ", ".join(f"{what} {n}" for what, n in reasons.items() if n)
        least, median, most = np.percentile(lengths, [0, 50, 100]).astype(int)
        print(f"{name:8} {won} of {worlds}, {least}-{most} actions, median {median}; failed at: {why or 'nothing'}")


def scripted(worlds: int, pictures: Path | None) -> None:
    for name, (scenario, actions) in SCRIPTED.items():
        done = 0
        for i, found in enumerate(failures(scenario, range(worlds))):
            frames: list[np.ndarray] | None = [] if pictures is not None and i < 2 else None
            done += recovers(found, actions, frames)
            if frames and pictures is not None:
                strip(frames, pictures / f"scripted-{name}-{i}.png", found.state[found.objects[1]][0])
        print(f"{name}: {done} of {worlds} by {len(actions)} scripted actions in scenario {scenario}")


def learn(number: int, scenario: str | None, seed: int, pictures: Path | None) -> None:
    import tempfile

    import torch

    from resync_robot.sim_training.failure_mining import explain, mine_stage
    from resync_robot.sim_training.learn_recovery import learn_recovery
    from resync_robot.sim_training.recovery_problem import Start, pose_problem

    torch.set_num_threads(1)
    stage = DOMAIN.stages[number - 1]
    stage = replace(stage, scenario=scenario or stage.scenario)
    begun, cpu = time.monotonic(), time.process_time()
    mined = mine_stage(DOMAIN, BODY, stage, MODEL, 10_000 * seed, 100)
    about = explain(DOMAIN, mined)
    print(
        f"{about.skill}{tuple(o.name for o in about.objects)} ran into {[o.name for o in about.culprits]}", flush=True
    )
    problem = pose_problem(DOMAIN, BODY, stage, MODEL, about, [Start(f.task, f.state) for f in mined])
    told = [0.0]

    def progress(steps: int, most: int, rate: float) -> None:
        if time.monotonic() - told[0] > 30:
            told[0] = time.monotonic()
            print(f"{steps} of {most} actions, {rate:.3f}, {time.process_time() - cpu:.0f} s", flush=True)

    with tempfile.TemporaryDirectory() as folder:
        learned = learn_recovery(problem, seed, Path(folder) / "ppo.safetensors", progress)
    recovery, figures = learned.recovery, learned.figures
    curve = figures["curve"]
    print(
        f"{stage.recovery} in scenario {stage.scenario}: {curve['steps'][-1]} actions, {figures['verdicts']} verdicts, "
        f"sampled success {curve['success'][-1]:.3f}, terminal {figures['terminal_accuracy']}, "
        f"{time.process_time() - cpu:.0f} s of one core, {time.monotonic() - begun:.0f} s by the clock",
        flush=True,
    )
    skill = recovery.skill(MODEL.skill(about.skill), BODY, DOMAIN.relations).ground(about.projected)
    fresh, said, good = 200, 0, 0
    for i in range(fresh):
        task = DOMAIN.scenario(stage.scenario).sample(np.random.default_rng(900_000 + i), i)
        world = BODY.simulate(task)
        listener = _Frames(world)
        done = run_skill(world, skill, listener).done
        said += done
        good += done and problem.judge(world, task.initial)
        if pictures is not None and i < 3:
            frames = [*listener.frames[-12:], world.picture()]
            strip(frames, pictures / f"{stage.recovery}-{stage.scenario}-{i}.png", task.initial[about.objects[1]][0])
    print(f"executed in fresh tasks: says that it is done in {said}, and {about.skill} succeeds in {good} of {fresh}")


class _Frames(Listener):
    def __init__(self, world: Any) -> None:
        self._world = world
        self.frames: list[np.ndarray] = []

    def on_control(self, observation: Any, action: Any) -> None:
        self.frames.append(self._world.picture())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["speed", "given", "scripted", "learn"])
    parser.add_argument("--worlds", type=int, default=60)
    parser.add_argument("--stage", type=int, default=1)
    parser.add_argument("--scenario")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--pictures", type=Path)
    args = parser.parse_args()
    if args.what == "speed":
        speed()
    elif args.what == "given":
        given(args.worlds)
    elif args.what == "scripted":
        scripted(args.worlds, args.pictures)
    else:
        learn(args.stage, args.scenario, args.seed, args.pictures)


if __name__ == "__main__":
    main()
