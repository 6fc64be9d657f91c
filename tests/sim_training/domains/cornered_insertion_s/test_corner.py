"""One corner stands for all of them, and the numbers that the shipped library was trained on are what they were."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from resync_robot.core.library import load_library
from resync_robot.core.relations import between, moved, seen
from resync_robot.core.state import State
from resync_robot.core.vocabulary import BLOCK, BOX
from resync_robot.learning.classifiers import KIND, NeuralClassifier
from resync_robot.learning.failures import PairGaussian
from resync_robot.learning.features import relative_features
from resync_robot.library_models import shipped_library
from resync_robot.sim_training.domains import find_domain
from resync_robot.sim_training.domains.cornered_insertion_s.corner import CORNER, RELATIONS, in_corner
from tests import scenes
from tests.libraries import DOMAIN
from tests.scenes import B0, THE_BOX

CORNERED = find_domain(DOMAIN)


@pytest.fixture(scope="module")
def frozen() -> dict[str, Any]:
    """Scenes with blocks in, at and outside of boxes, upright and tilted, as they were seen when the library was
    trained, and worlds as they were drawn."""
    return json.loads((Path(__file__).parent / "frozen" / "corner.json").read_text("utf-8"))


def test_the_shipped_library_sees_what_it_was_trained_on(frozen: dict[str, Any]) -> None:
    block, box = np.array(frozen["block"]), np.array(frozen["box"])
    assert CORNERED.relations == RELATIONS
    features = relative_features((BLOCK, BOX), (block, box), CORNERED.relations)
    np.testing.assert_allclose(features, frozen["features"], rtol=0, atol=1e-9)
    np.testing.assert_allclose(relative_features((BLOCK,), (block,)), frozen["alone"], rtol=0, atol=1e-9)
    np.testing.assert_allclose(CORNER.see(block, box), frozen["relative"], rtol=0, atol=1e-9)
    library = load_library(shipped_library(DOMAIN))
    types = {t.name: t for t in CORNERED.types}
    neural = {name: r for name, r in library.predicates.items() if r.meta["kind"] == KIND}
    assert set(neural) == set(frozen["probabilities"])
    for name, record in neural.items():
        classifier = NeuralClassifier.from_record(name, record, types, CORNERED.relations)
        said = classifier.probabilities((block, box))
        np.testing.assert_allclose(said, frozen["probabilities"][name], rtol=0, atol=1e-6)
        assert said.min() < 0.2 and said.max() > 0.9, "they tell these scenes apart"


def test_scenarios_draw_the_worlds_that_they_drew(frozen: dict[str, Any]) -> None:
    for name, scenario in CORNERED.scenarios.items():
        same_world(scenario.sample(np.random.default_rng(5), 5).initial, frozen["worlds"][name])


def test_demonstrations_begin_as_they_did_with_the_shipped_gaussians(frozen: dict[str, Any]) -> None:
    from resync_robot.sim_training.demonstrations.starts import draw_start

    failure = load_library(shipped_library(DOMAIN)).stages[0].failure
    gaussians = {
        "before": PairGaussian.from_json(failure.before["box"], 4),
        "after": PairGaussian.from_json(failure.after["box"], 4),
    }
    for i in range(4):
        same_world(draw_start(CORNERED, gaussians, i).task.initial, frozen["worlds"][f"start{i}"])


def same_world(state: State, before: dict[str, list[float]]) -> None:
    assert {o.name for o in state} == set(before)
    for obj in state:
        np.testing.assert_allclose(state[obj], before[obj.name], rtol=0, atol=1e-9)


def placed(x: float, y: float, yaw: float, box: np.ndarray) -> State:
    return State({B0: scenes.block_features(x, y, yaw, box=box), THE_BOX: box})


@given(
    smaller=st.floats(-0.01, 0.05),
    more=st.floats(1e-6, 0.04),
    angle=st.floats(-0.78, 0.78),
    box_yaw=st.floats(-3, 3),
    seed=st.integers(0, 1000),
)
def test_a_placed_block_is_seen_as_it_was_wanted(
    smaller: float, more: float, angle: float, box_yaw: float, seed: int
) -> None:
    state = placed(0.0, 0.0, 0.0, scenes.box_features(box_yaw, (0.29, 0.31)))
    wanted = in_corner(smaller, smaller + more, angle)
    for a, b in ((B0, THE_BOX), (THE_BOX, B0)):
        after = moved(state, a, b, wanted, np.random.default_rng(seed), RELATIONS)
        np.testing.assert_allclose(seen(after, a, b, RELATIONS), wanted, atol=1e-6)
        np.testing.assert_array_equal(after[b], state[b])
    # Gaps that a Gaussian draws in the wrong order are those of the same corner.
    turned = np.array([wanted[1], wanted[0], *wanted[2:]])
    again = CORNER.place(state[B0], state[THE_BOX], turned, np.random.default_rng(seed))
    np.testing.assert_array_equal(again, CORNER.place(state[B0], state[THE_BOX], wanted, np.random.default_rng(seed)))


def test_placing_reaches_every_corner_and_both_axes() -> None:
    rng, state = np.random.default_rng(0), placed(0.0, 0.0, 0.0, scenes.box_features())
    wanted = in_corner(0.0, 0.06, 0.1)
    blocks = np.stack([CORNER.place(state[B0], state[THE_BOX], wanted, rng) for _ in range(100)])
    x, y = (blocks[:, :2] - state[THE_BOX][:2]).T
    assert len(set(zip(x > 0, y > 0, np.abs(x) > np.abs(y), strict=True))) == 8


@given(
    x=st.floats(0.01, 0.11),
    y=st.floats(0.01, 0.11),
    yaw=st.floats(-3, 3),
    quarters=st.integers(0, 3),
    flip=st.sampled_from([(1, 1), (1, -1), (-1, 1), (-1, -1)]),
)
def test_one_corner_stands_for_all(x: float, y: float, yaw: float, quarters: int, flip: tuple[int, int]) -> None:
    # On the diagonal a heading has no sense of turn to keep.
    assume(abs(x - y) > 1e-6)
    box = scenes.box_features()
    here = seen(placed(x, y, yaw, box), B0, THE_BOX, RELATIONS)
    mirrored = placed(flip[0] * x, flip[1] * y, flip[0] * flip[1] * yaw + quarters * np.pi / 2, box)
    np.testing.assert_allclose(seen(mirrored, B0, THE_BOX, RELATIONS), here, atol=1e-6)
    np.testing.assert_allclose(seen(placed(y, x, -yaw, box), B0, THE_BOX, RELATIONS), here, atol=1e-6)


def test_only_the_corner_is_declared() -> None:
    assert list(RELATIONS) == [(BLOCK, BOX)]
    assert len(CORNER.names) == len(CORNER.resolution) == 4
    assert between(BLOCK, BLOCK, RELATIONS).names == ("x", "y", "z", "up_x", "up_y", "up_z", "cos", "sin")
