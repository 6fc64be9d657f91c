"""A thing that was recorded here and then there went there in the hand."""

from __future__ import annotations

import numpy as np
import pytest

from resync_robot.core import spatial
from resync_robot.core.state import State
from resync_robot.core.tracks import Tracks
from resync_robot.core.vocabulary import BLOCK

B0, B1 = BLOCK("b0"), BLOCK("b1")
SIZE = (0.06, 0.06, 0.045)
TIMES = np.linspace(0.0, 10.0, 251)


def features(position: np.ndarray, yaw: float = 0.0) -> np.ndarray:
    return np.concatenate([position, spatial.quat_from_yaw(yaw), SIZE])


def tips() -> np.ndarray:
    """Comes down onto the place of a block until 3 s, rests, carries it 0.3 m aside from 4 to 7 s, goes up."""
    x = np.interp(TIMES, [0, 4, 7, 10], [0.3, 0.3, 0.6, 0.6])
    z = np.interp(TIMES, [0, 3, 7, 10], [0.4, 0.05, 0.05, 0.4])
    yaw = np.interp(TIMES, [0, 4, 7, 10], [0.0, 0.0, 0.8, 0.8])
    return np.stack(
        [
            spatial.transform(spatial.rotation_about("z", a), np.array([px, 0.0, pz]))
            for px, pz, a in zip(x, z, yaw, strict=True)
        ]
    )


HAND = tips()
BEFORE, AFTER = features(np.array([0.3, 0.0, 0.03])), features(np.array([0.6, 0.0, 0.03]), 0.8)
ELSEWHERE = features(np.array([0.5, -0.4, 0.03]))


def test_a_carried_block_rests_goes_with_the_hand_and_rests() -> None:
    tracks = Tracks([(0.0, State({B0: BEFORE})), (10.0, State({B0: AFTER}))], TIMES, HAND)
    for time in np.linspace(0.0, 10.0, 101):
        tip = HAND[int(np.argmin(np.abs(TIMES - time)))]
        expected = BEFORE[:3] if time < 4 else AFTER[:3] if time > 7 else [tip[0, 3], 0.0, 0.03]
        np.testing.assert_allclose(tracks.at(time)[B0][:3], expected, atol=0.012)
    assert spatial.yaw_of(tracks.at(5.5)[B0][3:7]) == pytest.approx(0.4, abs=0.06)
    np.testing.assert_allclose(tracks.at(10.0)[B0], AFTER)


def test_what_the_hand_does_not_explain_is_made_up_for_on_the_way() -> None:
    """It slipped by 8 mm."""
    slipped = features(np.array([0.592, 0.0, 0.03]), 0.8)
    tracks = Tracks([(0.0, State({B0: BEFORE})), (10.0, State({B0: slipped}))], TIMES, HAND)
    way = np.array([tracks.at(t)[B0][0] for t in TIMES])
    assert np.abs(np.diff(way)).max() < 0.01, "no jump"
    np.testing.assert_allclose(tracks.at(9.0)[B0][:3], slipped[:3], atol=1e-6)


def test_what_the_hand_never_came_near_stays_until_it_is_seen_elsewhere() -> None:
    moved = features(np.array([0.5, -0.3, 0.03]))
    tracks = Tracks([(0.0, State({B1: ELSEWHERE})), (10.0, State({B1: moved}))], TIMES, HAND)
    np.testing.assert_allclose(tracks.at(9.9)[B1], ELSEWHERE)
    np.testing.assert_allclose(tracks.at(10.0)[B1], moved)


def test_nothing_is_known_before_it_was_recorded_and_what_is_lost_is_gone() -> None:
    tracks = Tracks([(2.0, State({B0: BEFORE, B1: ELSEWHERE})), (5.0, State({B1: ELSEWHERE}))], TIMES, HAND)
    assert tracks.at(1.0) == {}
    assert set(tracks.at(4.0)) == {B0, B1} and set(tracks.at(6.0)) == {B1}
    assert Tracks([], TIMES, HAND).at(3.0) == {}
