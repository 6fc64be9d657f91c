"""What was learned goes on learning from the dreams of a new stage, and never at the cost of the stages before it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from resync_robot.core.symbols import Predicate
from resync_robot.core.trajectory import Trajectory
from resync_robot.core.vocabulary import BLOCK, BOX, ROBOT
from resync_robot.learning import tuning
from resync_robot.learning.dataset import Dataset, merged_dataset
from resync_robot.learning.effect_vectors import candidate_to_json
from resync_robot.learning.effects import Attempts, Candidate, Effect, supervise
from resync_robot.learning.fit import FitConfig, fit
from resync_robot.learning.model import Concepts
from resync_robot.learning.tuning import TuneConfig, tune, tune_known
from resync_robot.planning.abstract import Abstraction
from tests.learning.conftest import one_thread
from tests.learning.toy import DOMAIN, Toy

READY = Predicate("Ready", (BLOCK, BOX))
CANDIDATE = Candidate(READY.types, (Effect("Recover", (1, 2), 1),), Attempts("Pick", (1, None)))
SIGNATURES = {
    "Pick": (ROBOT, BLOCK),
    "Insert": (ROBOT, BLOCK, BLOCK),
    "Recover": (ROBOT, BLOCK, BOX),
    "Nudge": (ROBOT, BLOCK, BOX),
}
FIT = FitConfig(widths=(32,), epochs=6, learning_rate=3e-3)


def nudged(t: Trajectory) -> Trajectory:
    """The same with another recovery, which nothing is known of."""
    steps = tuple(replace(x, skill="Nudge") if x.skill == "Recover" else x for x in t.transitions)
    return replace(t, transitions=steps)


@dataclass(frozen=True)
class Known:
    """A predicate learned from the runs of a first stage, and the data of both."""

    concepts: Concepts
    dataset: Dataset


@pytest.fixture(scope="module")
def known() -> Known:
    old = Toy(0).dreams(40)
    alone = merged_dataset([old], ("Recover",), SIGNATURES)
    with one_thread():
        found = fit(alone, CANDIDATE, supervise(alone, CANDIDATE), 0, FIT, DOMAIN.relations)
    record = found.classifier.to_record({"stage": 1, **candidate_to_json(CANDIDATE)})
    classifiers = {**DOMAIN.classifiers, READY.name: found.classifier}
    concepts = Concepts((*DOMAIN.predicates, READY), classifiers, DOMAIN.operators, {READY.name: record}, {})
    new = [nudged(t) for t in Toy(1).dreams(40)]
    return Known(concepts, merged_dataset([old, new], ("Recover", "Nudge"), SIGNATURES))


def tune_all(known: Known) -> tuple[Concepts, list[dict[str, object]]]:
    judge = Abstraction(known.concepts.predicates, known.concepts.classifiers)
    truth = [judge.true_atoms(known.dataset.state_at(m)) for m in range(len(known.dataset.moments))]
    columns = [dict.fromkeys(SIGNATURES, ()) for _ in judge.predicates]
    recoveries = ("Recover", "Nudge")
    with one_thread():
        return tune_known(known.concepts, known.dataset, truth, columns, recoveries, 0, FIT, TuneConfig())


def test_an_effect_of_the_new_skill_comes_to_the_vector_and_both_stages_fit_no_worse(known: Known) -> None:
    found, (entry,) = tune_all(known)
    record = found.records["Ready"]
    assert record.meta["effects"] == {"Recover": [[[1, 2], 1]], "Nudge": [[[1, 2], 1]]}
    assert record.meta["attempts"] == {"skill": "Pick", "slots": [1, None]} and record.meta["stage"] == 1
    assert entry["verdict"] == "tuned" and record.meta["tuned"] == 2, entry
    assert all(a <= b for a, b in zip(entry["loss"], entry["loss_before"], strict=True))  # type: ignore[call-overload]
    old, new = known.concepts.classifiers["Ready"], found.classifiers["Ready"]
    assert not np.array_equal(old.layers[0][0], new.layers[0][0])  # type: ignore[union-attr]
    np.testing.assert_array_equal(record.tensors["layer0.weight"], new.layers[0][0])  # type: ignore[union-attr]


def test_a_failure_whose_cause_may_be_the_new_one_labels_nothing(known: Known, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    monkeypatch.setattr(tuning, "tune", lambda dataset, wider, supervision, *_: seen.append(supervision))
    found, _ = tune_all(known)
    told = {(known.dataset.runs[label.run].stage, label.value) for label in seen[0].labels if label.direct}
    assert told == {(1, 0), (1, 1), (2, 1)}
    assert found.classifiers == known.concepts.classifiers


def test_what_would_cost_the_earlier_stage_is_not_kept(known: Known) -> None:
    """New dreams that say the opposite of the old ones."""
    told = supervise(known.dataset, CANDIDATE)
    new = {i for i, run in enumerate(known.dataset.runs) if run.stage == 2}
    lies = tuple(replace(x, value=1 - x.value) if x.run in new else x for x in told.labels)
    start = known.concepts.classifiers["Ready"]
    with one_thread():
        found = tune(known.dataset, CANDIDATE, replace(told, labels=lies), start, 0, FIT, TuneConfig())
    assert found is not None and not found.kept and found.classifier is start


def test_without_data_of_an_earlier_stage_nothing_is_tuned(known: Known) -> None:
    told, start = supervise(known.dataset, CANDIDATE), known.concepts.classifiers["Ready"]
    one = replace(known.dataset, runs=tuple(replace(run, stage=2) for run in known.dataset.runs))
    assert tune(one, CANDIDATE, told, start, 0, FIT, TuneConfig()) is None
