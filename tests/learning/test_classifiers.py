from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from resync_robot.core.errors import LibraryError, TrainingError
from resync_robot.core.library import Library, Record, load_library, save_library
from resync_robot.core.vocabulary import BLOCK, BOX, ROBOT, TYPES
from resync_robot.learning.classifiers import NeuralClassifier
from resync_robot.learning.dataset import merged_dataset
from resync_robot.learning.effects import Attempts, Candidate, Effect, supervise
from resync_robot.learning.fit import SCREENING, FitConfig, fit
from resync_robot.sim_training.domains.cornered_insertion_s.corner import RELATIONS
from tests.learning.toy import BOX_0, Toy

SIGNATURES = {"Pick": (ROBOT, BLOCK), "Insert": (ROBOT, BLOCK, BLOCK), "Recover": (ROBOT, BLOCK, BOX)}
READY = Candidate((BLOCK, BOX), (Effect("Recover", (1, 2), 1),), Attempts("Pick", (1, None)))
QUICK = FitConfig(widths=(64, 64), epochs=20, learning_rate=3e-3)


@pytest.fixture(scope="module", autouse=True)
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def data():
    toy = Toy(3)
    return merged_dataset([toy.dreams(60) + toy.attempts(80, covered=False)], ("Recover",), SIGNATURES)


@pytest.fixture(scope="module")
def fitted(data):
    return fit(data, READY, supervise(data, READY), 0, QUICK, RELATIONS)


def test_it_learns_the_boundary_in_every_corner(fitted) -> None:
    toy = Toy(9, noise=False)
    right = []
    for kind in ["corner", "wall", "after", "free", "outside"] * 20:
        state = toy.scene(1, lambda i, k=kind: k)
        right.append((fitted.classifier(state, (BLOCK("b0"), BOX_0)) > 0.5) == (toy.gap(state, BLOCK("b0")) > 0.028))
    assert np.mean(right) > 0.93
    assert fitted.accuracy > 0.9 and fitted.loss < 0.3


def test_one_seed_gives_one_classifier(data, fitted) -> None:
    again = fit(data, READY, supervise(data, READY), 0, QUICK, RELATIONS)
    for (a, b), (c, d) in zip(fitted.classifier.layers, again.classifier.layers, strict=True):
        assert np.array_equal(a, c) and np.array_equal(b, d)
    other = fit(data, READY, supervise(data, READY), 1, QUICK, RELATIONS)
    assert not np.array_equal(fitted.classifier.layers[0][0], other.classifier.layers[0][0])


def test_training_leaves_the_global_random_state_alone(data) -> None:
    torch.manual_seed(5)
    expected = torch.rand(3)
    torch.manual_seed(5)
    fit(data, READY, supervise(data, READY), 0, replace(SCREENING, epochs=1), RELATIONS)
    assert torch.equal(torch.rand(3), expected)


def test_batch_agrees_with_single_calls(fitted) -> None:
    state = Toy(1).scene(3, lambda i: "free")
    groundings = [(b, BOX_0) for b in state.of_type(BLOCK)]
    np.testing.assert_allclose(
        fitted.classifier.batch(state, groundings), [fitted.classifier(state, g) for g in groundings], rtol=1e-5
    )
    assert fitted.classifier.batch(state, []).shape == (0,)


def test_it_survives_a_library_folder(fitted, tmp_path) -> None:
    record = fitted.classifier.to_record({"loss": 0.1})
    library = Library("d", "hash", "(define (domain d))", {"Ready": record}, {}, (), {})
    save_library(library, tmp_path / "library")
    loaded = NeuralClassifier.from_record(
        "Ready", load_library(tmp_path / "library").predicates["Ready"], TYPES, RELATIONS
    )
    state = Toy(1).scene(2, lambda i: "corner")
    assert loaded(state, (BLOCK("b0"), BOX_0)) == fitted.classifier(state, (BLOCK("b0"), BOX_0))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda r: Record(r.meta, {k: v for k, v in r.tensors.items() if "normaliser" not in k}), "normaliser.mean"),
        (lambda r: Record(r.meta, {**r.tensors, "layer0.weight": r.tensors["layer0.weight"][:, 1:]}), "has shape"),
        (lambda r: Record(r.meta, {**r.tensors, "layer1.bias": r.tensors["layer1.bias"] * np.nan}), "not finite"),
        (lambda r: Record({**r.meta, "types": ["brick"]}, r.tensors), "brick"),
        (lambda r: Record({**r.meta, "layers": 9}, r.tensors), "has shape|no tensor"),
    ],
)
def test_a_broken_record_is_refused(fitted, change, message) -> None:
    with pytest.raises(LibraryError, match=message):
        NeuralClassifier.from_record("Ready", change(fitted.classifier.to_record()), TYPES, RELATIONS)


def test_nothing_to_tell_apart_is_an_error(data) -> None:
    unseen = Candidate((BLOCK, BOX), (Effect("Fly", (1, 2), 1),))
    with pytest.raises(TrainingError, match="nothing tells true from false"):
        fit(data, unseen, supervise(data, unseen), 0, QUICK, RELATIONS)
