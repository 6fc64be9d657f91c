"""A library that is whole and knows nothing: a random recovery policy, and the given model of its domain."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import torch

from resync_robot.core.library import LearnedFailure, LearnedStage, Library, Record
from resync_robot.core.rig import load_rig
from resync_robot.core.task import Domain
from resync_robot.learning.failures import PairGaussian
from resync_robot.learning.learned_recovery import LearnedRecovery
from resync_robot.learning.recovery_policy import OBSERVATION_SIZE, ActorCritic
from resync_robot.learning.terminals import Terminal
from resync_robot.planning.pddl import domain_to_pddl
from resync_robot.sim_training.domains import find_domain

DOMAIN = "cornered-insertion-s"


def recovery_record(failed: float | None = None) -> Record:
    """A recovery skill's record; its failure detector answers `failed` whatever it sees, where that is given."""
    torch.manual_seed(0)
    policy, terminal, detector = ActorCritic(width=8, depth=1), Terminal(OBSERVATION_SIZE), Terminal(OBSERVATION_SIZE)
    tensors = {f"policy.{k}": v for k, v in policy.to_tensors().items()}
    for name, net in (("terminal", terminal), ("failed", detector)):
        tensors |= {f"{name}.{k}": v for k, v in net.to_record().tensors.items()}
    if failed is not None:
        tensors["failed.net.12.weight"] = np.zeros_like(tensors["failed.net.12.weight"])
        tensors["failed.net.12.bias"] = np.array([np.log(failed / (1 - failed))], dtype=np.float32)
    inputs = {"inputs": OBSERVATION_SIZE}
    return Record({"policy": {"width": 8, "depth": 1}, "terminal": inputs, "failed": inputs}, tensors)


def cornered(before: Any, after: Any) -> LearnedFailure:
    """Pick fails on its block, for which the box is to blame; with these pair Gaussians."""
    return LearnedFailure(
        skill="Pick", argument=1, objects={"box": "box"}, before={"box": before}, after={"box": after}
    )


def gaussians_of(library: Library) -> dict[str, PairGaussian]:
    """Those of where the block lies in the box, before and after the recovery."""
    failure = library.stages[0].failure
    return {
        "before": PairGaussian.from_json(failure.before["box"]),
        "after": PairGaussian.from_json(failure.after["box"]),
    }


def with_camera_policy(recovered: int, worlds: int) -> Library:
    """That library with a camera policy that nobody can load, and how it did in its trials."""
    points = [{"step": 1, "success": worlds, "worlds": worlds}, {"step": 2, "success": recovered, "worlds": worlds}]
    library = given_library()
    stage = replace(library.stages[0], figures={"distil": {"points": points, "chosen": 2}})
    return replace(library, policies={"Recover": {"config.json": b"{}"}}, stages=(stage,))


def given_library() -> Library:
    """The given predicates and operators as a library, with that recovery beside them."""
    domain = find_domain(DOMAIN)
    return Library(
        domain=domain.name,
        rig_hash=load_rig().hash,
        domain_pddl=domain_to_pddl(domain.name, domain.types, domain.predicates, domain.operators),
        predicates={},
        skills={domain.recovery: recovery_record()},
        stages=(LearnedStage(recovery=domain.recovery, scenario="s0", failure=cornered({}, {})),),
        provenance={"seed": 0},
    )


def own_library(domain: Domain) -> Library:
    """The same of a domain with a robot of its own, for its first stage."""
    stage = domain.stages[0]
    failed, cause = domain.operators[0], domain.fixed[0] if domain.fixed else domain.types[-1]
    types = (*(v.type for v in failed.parameters), cause)
    recovery = LearnedRecovery(
        name=stage.recovery,
        types=types,
        sees=len(types),
        failed_skill=failed.name,
        arguments=tuple(range(len(failed.parameters))),
        horizon=stage.horizon,
        policy=ActorCritic(width=8, depth=1, observations=4, actions=3),
        done=Terminal(4),
    )
    failure = LearnedFailure(
        skill=failed.name, argument=1, objects={cause.name: cause.name}, before={cause.name: {}}, after={cause.name: {}}
    )
    return Library(
        domain=domain.name,
        rig_hash="",
        domain_pddl=domain_to_pddl(domain.name, domain.types, domain.predicates, domain.operators),
        predicates={},
        skills={stage.recovery: recovery.to_record()},
        stages=(LearnedStage(recovery=stage.recovery, scenario=stage.scenario, failure=failure),),
        provenance={"seed": 0},
        types_hash=domain.types_hash,
    )
