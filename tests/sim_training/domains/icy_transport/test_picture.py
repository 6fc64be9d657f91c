"""Pictures show what there is, and what has changed."""

import numpy as np

from resync_robot.sim_training.domains.icy_transport.layouts import ROBOT, draw
from resync_robot.sim_training.domains.icy_transport.picture import draw as paint
from resync_robot.sim_training.domains.icy_transport.vocabulary import ICE


def _pixel(image: np.ndarray, x: float, y: float) -> list[int]:
    return list(image[round(490 - y * 96), round(10 + x * 96)])


def test_everything_is_where_the_state_has_it() -> None:
    state = draw(np.random.default_rng(0), 0, ice="o1").initial
    image = paint(state)
    assert image.shape == (500, 500, 3) and image.dtype == np.uint8
    red, green, blue = _pixel(image, *state[ROBOT][:2])
    assert blue > red and blue > green
    assert _pixel(image, *state[ICE("ice")][:2]) == [112, 196, 226]
    assert _pixel(image, 2.5, 3.75) == _pixel(image, 2.5, 0.4) != _pixel(image, 2.5, 1.25)


def test_what_is_crossed_looks_different() -> None:
    state = draw(np.random.default_rng(0), 0, ice="o1").initial
    assert (paint(state) != paint(state.with_features(ICE("ice"), active=0.0))).any()
