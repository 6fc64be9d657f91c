"""What the first stages of training leave in the run folder, and how later ones read it.

Each reader takes a missing file for a stage that was not finished, so that a damaged one can be removed and done again.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from safetensors.numpy import load_file

from resync_robot.core.damage import Shape, check_shape, reading
from resync_robot.core.errors import UnknownNameError
from resync_robot.core.files import read_json
from resync_robot.core.library import Record
from resync_robot.core.relations import between
from resync_robot.core.symbols import Object
from resync_robot.core.task import Domain, Task
from resync_robot.core.vocabulary import TYPES
from resync_robot.learning.failures import Culprit, PairGaussian
from resync_robot.learning.terminals import Terminal
from resync_robot.policies.state_recovery import recovery_nets
from resync_robot.sim_training.mine import resample_failure

GAUSSIAN: Shape = {"mean": [float], "covariance": [[float]]}
MINED: Shape = {
    "skill": str,
    "failure_object": str,
    "failure_object_type": str,
    "relevant": str,
    "relevant_type": str,
    "relevant_argument": int,
    "before": GAUSSIAN,
    "seeds": [int],
    "scenario": str,
}
"""The fields of failures.json."""
LEARNED: Shape = {
    "policy": dict,
    "terminal": dict,
    "failed": dict,
    "signature": [str],
    "failed_skill": str,
    "after": GAUSSIAN,
}
"""The fields of recovery.json."""


@dataclass(frozen=True)
class Mined:
    """D^F: who failed on what, and world seeds whose resampled states really fail."""

    culprit: Culprit
    relevant: Object
    before: PairGaussian
    seeds: tuple[int, ...]
    scenario: str

    def to_json(self) -> dict[str, Any]:
        """For failures.json; `read_mined` is the inverse."""
        return {
            "skill": self.culprit.skill,
            "failure_object": self.culprit.failure_object.name,
            "failure_object_type": self.culprit.failure_object.type.name,
            "relevant": self.relevant.name,
            "relevant_type": self.relevant.type.name,
            "relevant_argument": self.culprit.relevant_argument,
            "before": self.before.to_json(),
            "seeds": list(self.seeds),
            "scenario": self.scenario,
        }

    def tasks(self, domain: Domain) -> list[Task]:
        pair = self.relevant, self.culprit.failure_object
        return [resample_failure(domain, self.scenario, *pair, self.before, s) for s in self.seeds]


def read_mined(path: Path, domain: Domain) -> Mined | None:
    """What `stages.mine` left; None where that is nothing. Raises TrainingError where it cannot be used."""
    with reading(path):
        saved = read_json(path)
        if saved is None and not path.exists():
            return None
        check_shape(saved, MINED)
        operator = next((o for o in domain.operators if o.name == saved["skill"]), None)
        if operator is None:
            raise UnknownNameError("skill", saved["skill"], [o.name for o in domain.operators])
        if not 0 <= saved["relevant_argument"] < len(operator.parameters):
            raise ValueError(f"{operator.name} has no argument {saved['relevant_argument']}")
        if not saved["seeds"] or min(saved["seeds"]) < 0:
            raise ValueError("'seeds' should be whole numbers from 0 on, at least one")
        culprit = Culprit(
            saved["skill"], TYPES[saved["failure_object_type"]](saved["failure_object"]), saved["relevant_argument"]
        )
        relevant = TYPES[saved["relevant_type"]](saved["relevant"])
        relation = between(relevant.type, culprit.failure_object.type, domain.relations)
        return Mined(
            culprit,
            relevant,
            PairGaussian.from_json(saved["before"], len(relation.names)),
            tuple(saved["seeds"]),
            domain.scenario(saved["scenario"]).name,
        )


def read_learned(meta: Path, weights: Path, columns: int) -> tuple[Record, PairGaussian] | None:
    """What `stages.learn_recovery` left; None where a file of it is missing. Raises TrainingError on a damaged one.

    Args:
        columns: of the relation between the relevant object and the failure object.
    """
    with reading(meta):
        saved = read_json(meta)
        if saved is None and not meta.exists():
            return None
        check_shape(saved, LEARNED)
        after = PairGaussian.from_json(saved["after"], columns)
    if not weights.exists():
        return None
    with reading(weights):
        record = Record({k: v for k, v in saved.items() if k != "after"}, load_file(weights))
        recovery_nets(record)
        detector = {k.removeprefix("failed."): v for k, v in record.tensors.items() if k.startswith("failed.")}
        Terminal.from_record(Record(saved["failed"], detector))
    return record, after
