"""Dreaming: counterfactual tasks before and after the recovery, around every object it could be about (section 3.2).

A dream puts one block, the reference, into a relative pose drawn from the Gaussian of states before or after the
recovery, and solves a task with the given skills and the new one. The reference is the block to be picked, the base,
or a bystander: only so does the data tell "this block is free" from "every block is free".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from resync_robot.core.rig import Rig
from resync_robot.core.skill import GroundSkill
from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.core.task import Domain, Task
from resync_robot.core.trajectory import Trajectory, Transition
from resync_robot.core.vocabulary import BLOCK, BOX, ROBOT
from resync_robot.learning.failures import PairGaussian
from resync_robot.planning.execute import ExecuteSettings, Model, plan_and_execute, run_skill
from resync_robot.sim_training.mine import is_at_rest
from resync_robot.sim_training.physics.world import SimWorld

WHEN = ("before", "after")
REFERENCES = {"picked": "b0", "base": "b1", "bystander": "b2"}
COMBINATIONS = tuple(product(WHEN, REFERENCES))


@dataclass(frozen=True)
class DreamSpec:
    """Which dream to have. `when` is "attempt" for one at a random pose without recovery."""

    when: str
    reference: str
    seed: int

    @property
    def source(self) -> str:
        return f"{self.when}@{self.reference}" if self.reference else self.when


def dream_specs(dreams: int, attempts: int, first_seed: int) -> list[DreamSpec]:
    """An equal quota for every combination of {before, after} x reference, then the practice attempts."""
    specs = [DreamSpec(*COMBINATIONS[i % len(COMBINATIONS)], first_seed + i) for i in range(dreams)]
    return specs + [DreamSpec("attempt", "", first_seed + dreams + i) for i in range(attempts)]


def dream_task(spec: DreamSpec, domain: Domain, gaussians: Mapping[str, PairGaussian]) -> Task:
    """The counterfactual initial state."""
    rng = np.random.default_rng(spec.seed)
    if spec.when == "attempt" and domain.practice is not None:
        return domain.practice(rng, spec.seed)
    blocks = 3 if spec.reference == "bystander" else int(rng.integers(2, 4))
    task = domain.dream(rng, spec.seed, blocks)
    reference, box = BLOCK(REFERENCES[spec.reference]), task.initial.of_type(BOX)[0]
    return domain.relocate(task, reference, box, gaussians[spec.when].sample(rng), rng)


def dream(
    spec: DreamSpec, domain: Domain, gaussians: Mapping[str, PairGaussian], model: Model, rig: Rig
) -> list[Trajectory]:
    """Live through one dream; empty where its initial state does not stand still.

    A failed Pick is followed by the recovery at once. A failed Insert leaves a block in the hand, and nothing can be
    recovered; so the dream begins again with the recovery first, which only a resettable world allows. Failed
    attempts are kept: they are what tells a classifier where its boundary lies.
    """
    task = dream_task(spec, domain, gaussians)
    world = SimWorld(task, rig)
    if not is_at_rest(world):
        return []
    recovery, settings = model.skill(domain.recovery), ExecuteSettings(max_failures=1)
    if spec.when == "attempt":
        result = plan_and_execute(world, model, task.goal, settings)
        return [Trajectory(result.transitions, task.goal, result.success, spec.source)]

    def react(failed: GroundSkill, state: State) -> GroundSkill | None:
        return recover(recovery.ground, failed, state) if spec.when == "before" else None

    result = plan_and_execute(world, model, task.goal, ExecuteSettings(max_failures=2), reaction=react)
    found = [Trajectory(result.transitions, task.goal, result.success, spec.source)]
    stuck_in_hand = result.transitions and not result.success and result.transitions[-1].skill != "Pick"
    if spec.when == "before" and spec.reference == "base" and stuck_in_hand:
        again = SimWorld(task, rig)
        is_at_rest(again)
        state = again.perceive()
        ground = recovery.ground(_arguments(state, BLOCK(REFERENCES[spec.reference])))
        outcome = run_skill(again, ground)
        after = again.perceive()
        first = Transition(state, ground.name, ground.objects, after, outcome.done)
        rest = plan_and_execute(again, model, task.goal, settings)
        found.append(Trajectory((first, *rest.transitions), task.goal, rest.success and outcome.done, spec.source))
    return found


def recover(ground, failed: GroundSkill, state: State) -> GroundSkill | None:  # type: ignore[no-untyped-def]
    """The recovery for the object that a failed skill was about, if the hand is free for it."""
    block = next((o for o in reversed(failed.objects) if o.type == BLOCK), None)
    return None if block is None or failed.name != "Pick" else ground(_arguments(state, block))


def _arguments(state: State, block: Object) -> tuple[Object, ...]:
    return state.of_type(ROBOT)[0], block, state.of_type(BOX)[0]


def useful(trajectories: Sequence[Trajectory]) -> tuple[list[Trajectory], dict[str, dict[str, int]]]:
    """What concept learning is fed, and a count by source of what was dreamed, solved and kept.

    A combination in which "before" never led to the recovery, or "after" needed it, did not hold and is not a
    demonstration; its attempts are kept as labels all the same.
    """
    counts: dict[str, dict[str, int]] = {}
    for t in trajectories:
        row = counts.setdefault(t.source, {"dreamed": 0, "solved": 0})
        row["dreamed"] += 1
        row["solved"] += t.solved
    return [t for t in trajectories if t.transitions], counts
