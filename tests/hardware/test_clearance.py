"""Distances between the arm's parts, checked against sampling and against poses that anybody can picture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from resync_robot.core import spatial
from resync_robot.core.machines import ARMS
from resync_robot.core.rig import Rig, load_rig
from resync_robot.hardware.clearance import NAMES, Clearance, Gap, Obstacle, _distance

RIG = load_rig()
CLEARANCE = Clearance(RIG)
ANGLES = arrays(float, 6, elements=st.floats(-3.1, 3.1))


def smallest(q: np.ndarray, clearance: Clearance = CLEARANCE) -> Gap:
    return clearance.smallest(clearance.frames(np.atleast_2d(q)))


@pytest.mark.parametrize("model", ARMS)
@given(ANGLES)
def test_frames_are_those_of_the_kinematics(model: str, q: np.ndarray) -> None:
    arm = replace(RIG.arm, model=model)
    frames = Clearance(replace(RIG, arm=arm)).frames(q[None])[0]
    np.testing.assert_allclose(frames[1:], arm.world_T_base @ arm.kinematics.link_frames(q), atol=1e-12)


@pytest.mark.parametrize("model", ARMS)
def test_no_arm_meets_itself_at_a_home_like_this_one(model: str) -> None:
    """A radius or an offset of another arm's would show: upright, and with the tool down, there is room."""
    clearance = Clearance(replace(RIG, arm=replace(RIG.arm, model=model)), table_z=-1.0)
    assert smallest(RIG.arm.home, clearance).distance > 0.02
    assert smallest(np.array([0.0, -np.pi / 2, 0.0, -np.pi / 2, -np.pi / 2, 0.0]), clearance).distance > 0.02


@given(arrays(float, (2, 2, 3), elements=st.floats(-1, 1)))
def test_distances_of_segments_agree_with_sampling(segments: np.ndarray) -> None:
    one, other = segments
    share = np.linspace(0, 1, 41)[:, None]
    a, b = (s[0] * (1 - share) + s[1] * share for s in (one, other))
    sampled = np.linalg.norm(a[:, None] - b[None], axis=-1).min()
    step = max(np.linalg.norm(one[1] - one[0]), np.linalg.norm(other[1] - other[0])) / 40
    got = float(_distance(one, other))
    assert sampled - step <= got <= sampled + 1e-9


@given(ANGLES, st.permutations([0, 1, 2]))
def test_the_smallest_of_many_is_the_smallest_of_each(q: np.ndarray, order: list[int]) -> None:
    many = np.array([RIG.arm.home, q, RIG.arm.home + 0.1])[order]
    assert smallest(many).distance == pytest.approx(min(smallest(one).distance for one in many))


WALL = Obstacle("box", spatial.transform(None, np.array([0.48, 0.0, 0.06])), np.array([0.18, 0.18, 0.06]))


@given(
    arrays(float, 6, elements=st.floats(-1.0, 1.0)),
    arrays(float, (12, 6), elements=st.floats(-0.1, 0.1)),
    st.floats(0.0, 0.1),
    st.booleans(),
)
def test_whoever_watches_an_arm_move_misses_no_narrow_gap(
    away: np.ndarray, steps: np.ndarray, margin: float, walled: bool
) -> None:
    watching = Clearance(RIG)
    watching.obstacles = (WALL,) if walled else ()
    for q in RIG.arm.home + away + np.cumsum(steps, axis=0):
        frames = watching.frames(np.array([q - 0.005, q]))
        narrow, below = watching.smallest(frames), watching.below(frames, margin)
        if abs(narrow.distance - margin) > 1e-9:
            assert (below is not None) == (narrow.distance < margin)
        assert below is None or below == narrow


@given(ANGLES, st.floats(-3, 3))
def test_turning_the_base_changes_nothing_between_the_parts(q: np.ndarray, turn: float) -> None:
    turned = q + np.array([turn, 0, 0, 0, 0, 0])
    assert smallest(turned).distance == pytest.approx(smallest(q).distance, abs=1e-9)


def test_home_has_room() -> None:
    assert smallest(RIG.arm.home).distance > 0.03


@pytest.mark.parametrize(
    ("q", "parts"),
    [
        ((0, -1.57, 3.0, 0, 0, 0), {"forearm", "wrist 1", "wrist 2", "wrist 3", "shoulder", "hand", "base"}),
        ((0, -1.57, 1.57, 0, 3.0, 0), {"hand", "wrist 3", "camera on the flange"}),
        ((0, 0.25, 0.0, 0, 0, 0), {"table"}),
    ],
    ids=["elbow folded", "hand folded in", "stretched into the table"],
)
def test_poses_that_cannot_be_are_negative_gaps(q: tuple[float, ...], parts: set[str]) -> None:
    gap = smallest(np.array(q, dtype=float))
    assert gap.distance < 0
    assert {gap.one, gap.other} & parts and gap.one in NAMES


def test_an_obstacle_is_measured_to_its_faces(rig: Rig) -> None:
    """A ceiling, turned about the vertical, 20 mm above the far end of the forearm: the highest part at home."""
    end = CLEARANCE.frames(rig.arm.home[None])[0, 3] @ np.array([0, 0, RIG.arm.facts.shape.elbow, 1.0])
    ceiling = spatial.transform(spatial.rotation_about("z", 0.6), end[:3] + np.array([0.1, 0, 0.050 + 0.020 + 0.5]))
    clearance = Clearance(rig)
    clearance.obstacles = (Obstacle("ceiling", ceiling, np.array([2.0, 2.0, 0.5])),)
    gap = smallest(rig.arm.home, clearance)
    assert gap.other == "ceiling" and gap.distance == pytest.approx(0.020)
    ceiling[2, 3] += 1.0
    assert smallest(rig.arm.home, clearance) == smallest(rig.arm.home)
