"""The skill that a stage learned, in any domain: the failed skill until it fails, then the policy until it is done."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from resync_robot.core.damage import Shape, check_shape
from resync_robot.core.embodiment import Embodiment
from resync_robot.core.errors import LibraryError
from resync_robot.core.library import RETRAIN, Record
from resync_robot.core.relations import Relations
from resync_robot.core.skill import Policy, Skill, SkillEnd, SkillOutcome
from resync_robot.core.symbols import Object, Type
from resync_robot.core.world import Observation
from resync_robot.learning.recovery_policy import ActorCritic
from resync_robot.learning.relational_view import RelationalView
from resync_robot.learning.terminals import Terminal

FIELDS: Mapping[str, Shape] = {
    "signature": [str],
    "sees": int,
    "failed_skill": str,
    "arguments": [int],
    "horizon": int,
    "sure": float,
    "policy": dict,
    "terminal": dict,
}
"""Of the record's JSON."""
SURE = (0.85, 0.95, 0.99)
"""Probabilities of beta_N at which the recovery may be done, of which trials choose: a moment more mostly costs less
than to be taken for done wrongly."""
PATIENCE = 2
"""How many times as long as an episode of training the policy may take: what it does next does not hang on the time
that has passed, and a robot with something in its hand is slower."""


@dataclass(frozen=True, kw_only=True)
class LearnedRecovery:
    """What a stage learned to do about a failure.

    Attributes:
        name: of the skill.
        types: of the skill's parameters: the robot, o^R, every o^F, and what else the failed skill takes.
        sees: how many of these it sees, from the first one on.
        failed_skill: C^F, by its name.
        arguments: for each argument of the failed skill which of the recovery's own it is.
        horizon: actions of an episode of training; the policy gives up after `PATIENCE` times as many.
        policy: over the relational view of the parameters.
        done: beta_N, over the same view: the failed skill succeeds from here.
        sure: the probability of beta_N at which it is done.
    """

    name: str
    types: tuple[Type, ...]
    sees: int
    failed_skill: str
    arguments: tuple[int, ...]
    horizon: int
    policy: ActorCritic
    done: Terminal
    sure: float = SURE[0]

    def skill(self, failed: Skill, embodiment: Embodiment, relations: Relations) -> Skill:
        """The skill for an executive; `failed` is the given skill that it begins with."""
        limits = np.array(list(embodiment.actions.values()))

        def start(objects: tuple[Object, ...], first: Observation) -> Policy:
            begun = failed.start(tuple(objects[i] for i in self.arguments), first)
            longest = round(failed.time_limit_s * embodiment.rate_hz)
            return _Run(self, RelationalView(objects[: self.sees], relations), begun, longest, limits)

        limit = failed.time_limit_s + (PATIENCE * self.horizon + 2) / embodiment.rate_hz
        return Skill(
            self.name,
            self.types,
            start,
            embodiment.rate_hz,
            limit,
            live_state=True,
            begins_with=lambda objects: failed.ground(tuple(objects[i] for i in self.arguments)),
        )

    def to_record(self) -> Record:
        """Weights and what they are for."""
        tensors = {f"policy.{k}": v for k, v in self.policy.to_tensors().items()}
        tensors |= {f"terminal.{k}": v for k, v in self.done.to_record().tensors.items()}
        meta = {
            "signature": [t.name for t in self.types],
            "sees": self.sees,
            "failed_skill": self.failed_skill,
            "arguments": list(self.arguments),
            "horizon": self.horizon,
            "sure": self.sure,
            "policy": self.policy.shape,
            "terminal": self.done.to_record().meta,
        }
        return Record(meta, tensors)

    @staticmethod
    def from_record(name: str, record: Record, types: Mapping[str, Type]) -> LearnedRecovery:
        """The inverse of `to_record`. Raises LibraryError where something is missing or does not fit.

        Args:
            types: of the domain, by name.
        """
        meta = record.meta
        try:
            check_shape(meta, FIELDS)
            policy = ActorCritic.from_record(Record(meta["policy"], _part(record, "policy.")))
            done = Terminal.from_record(Record(meta["terminal"], _part(record, "terminal.")))
            return LearnedRecovery(
                name=name,
                types=tuple(types[t] for t in meta["signature"]),
                sees=meta["sees"],
                failed_skill=meta["failed_skill"],
                arguments=tuple(meta["arguments"]),
                horizon=meta["horizon"],
                policy=policy,
                done=done,
                sure=meta["sure"],
            )
        except (KeyError, ValueError) as error:
            raise LibraryError(f"the record of {name} is no recovery: {error}", RETRAIN) from None


def _part(record: Record, prefix: str) -> dict[str, np.ndarray]:
    return {k.removeprefix(prefix): v for k, v in record.tensors.items() if k.startswith(prefix)}


class _Run:
    """One run of the skill."""

    def __init__(
        self, recovery: LearnedRecovery, view: RelationalView, failed: Policy, longest: int, limits: np.ndarray
    ) -> None:
        self._recovery, self._view, self._failed, self._longest = recovery, view, failed, longest
        self._middle, self._half = limits.mean(1), (limits[:, 1] - limits[:, 0]) / 2
        self._approaching, self._steps = True, 0

    def step(self, observation: Observation) -> Any:
        # Whether it is needed the failed skill tells best: beta_N has seen states like those in which that one ends.
        # What it looks like is dear to tell, and the failed skill, which may take thousands of actions, need not know.
        if self._approaching:
            answer = self._failed.step(observation)
            self._longest -= 1
            # To run out of its time is one of the ways in which it fails.
            if not isinstance(answer, SkillOutcome) and self._longest > 0:
                return answer
            if isinstance(answer, SkillOutcome) and answer.ending in (SkillEnd.DONE, SkillEnd.NEEDLESS):
                return SkillOutcome(SkillEnd.NEEDLESS, f"{self._recovery.failed_skill} does not fail here")
            self._approaching = False
        seen = self._see(observation)
        if self._steps and self._is_done(seen):
            return SkillOutcome(SkillEnd.DONE)
        if self._steps >= PATIENCE * self._recovery.horizon:
            return SkillOutcome(SkillEnd.TIMEOUT, f"not done after {self._steps} actions")
        self._steps += 1
        with torch.no_grad():
            action = self._recovery.policy.act(seen)[0].clamp(-1, 1).double().numpy()
        return self._middle + self._half * action

    def _see(self, observation: Observation) -> Tensor:
        """(1, d)"""
        return torch.as_tensor(self._view(observation.state), dtype=torch.float32)[None]

    def _is_done(self, seen: Tensor) -> bool:
        return float(self._recovery.done.probability(seen)) > self._recovery.sure
