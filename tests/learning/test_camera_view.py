"""What a camera policy sees and does: windows that stay in the picture, axes that turn back, chunks without a jump."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from resync_robot.core import spatial
from resync_robot.core.rig import load_rig
from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.core.vocabulary import BLOCK, BOX
from resync_robot.learning.camera_view import (
    BLEND,
    EXECUTE,
    SPAN,
    STATE_NAMES,
    VIEWS,
    Chunks,
    Scanned,
    from_hand,
    state_seen,
    to_hand,
    window_at,
)
from resync_robot.learning.recovery_policy import STUD, wall_gaps

RIG = load_rig()
coordinate = st.floats(-1.5, 1.5)
angle = st.floats(-4.0, 4.0)


@given(st.sampled_from(VIEWS), coordinate, coordinate, coordinate)
def test_a_window_lies_in_the_picture_wherever_the_hand_is(view: str, x: float, y: float, z: float) -> None:
    camera = RIG.camera(view)
    window = window_at(camera, RIG.camera_pose(camera, RIG.arm.home), np.array([x, y, z]))
    assert window.width > 0 and window.height > 0
    assert window.left >= -1e-9 and window.left + window.width <= camera.width + 1e-9
    assert window.top >= -1e-9 and window.top + window.height <= camera.height + 1e-9


@pytest.mark.parametrize("view", ["front", "side"])
@pytest.mark.parametrize("tip", [(0.48, 0.0, 0.05), (0.40, 0.1, 0.10), (0.55, -0.1, 0.03)])
def test_a_standing_camera_s_window_is_around_the_tip_and_shows_its_span(view: str, tip: tuple[float, ...]) -> None:
    camera = RIG.camera(view)
    window = window_at(camera, camera.pose, np.array(tip))
    seen = spatial.inverse(camera.pose) @ np.array([*tip, 1.0])
    pixel = (camera.intrinsics @ seen[:3])[:2] / seen[2] + 0.5
    centre = np.array([window.left + window.width / 2, window.top + window.height / 2])
    np.testing.assert_allclose(pixel, centre, atol=1e-6)
    assert window.width * seen[2] / camera.fx == pytest.approx(SPAN)


@given(st.lists(coordinate, min_size=3, max_size=3), angle)
def test_turning_into_the_hand_s_axes_and_back_changes_nothing(vector: list[float], yaw: float) -> None:
    v = np.array(vector)
    np.testing.assert_allclose(from_hand(to_hand(v, yaw), yaw), v, atol=1e-12)
    assert np.linalg.norm(to_hand(v, yaw)) == pytest.approx(np.linalg.norm(v), abs=1e-12)


def test_forward_is_where_the_hand_s_x_axis_points() -> None:
    np.testing.assert_allclose(to_hand(np.array([0.0, 1.0, 0.5]), np.pi / 2), [1.0, 0.0, 0.5], atol=1e-12)


def test_the_state_is_joints_tip_lead_and_what_the_scan_told() -> None:
    q, tip = np.arange(6.0), np.array([0.4, 0.1, 0.2])
    scanned = Scanned(tip + [0.0, 0.03, -0.06], tip[:2] + [-0.05, 0.0], np.array([0.05, 0.04]))
    state = state_seen(q, tip, tip + [0.0, 0.01, -0.02], np.pi / 2, scanned, np.array([0.0, 0.02]))
    assert state.shape == (len(STATE_NAMES),) and state.dtype == np.float32
    known = [0.03, 0.0, -0.06, 0.0, 0.05, 0.05, 0.04, 0.02, 0.0]
    np.testing.assert_allclose(state, [*q, *tip, 0.01, 0.0, -0.02, *known], atol=1e-6)


@given(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.floats(-0.2, 0.2))
def test_the_corner_is_as_far_from_the_block_as_its_walls_and_half_its_width(x: float, y: float, yaw: float) -> None:
    box, block = Object("box", BOX), Object("b0", BLOCK)
    pose = np.array([0.48, 0.01, 0.005, np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)])
    place = pose[:3] + from_hand(np.array([x, y, 0.02]), yaw)
    state = State(
        {
            box: np.array([*pose, 0.30, 0.28, 0.11, 0.03]),
            block: np.array([*place, *pose[3:], 0.05, 0.05, 0.04]),
        }
    )
    scanned = Scanned.of(state, block, box)
    row = torch.as_tensor(np.concatenate([np.zeros(6), state[block], state[box]]), dtype=torch.float32)[None]
    away = np.abs(to_hand(np.append(scanned.corner - place[:2], 0.0), yaw)[:2])
    np.testing.assert_allclose(away, wall_gaps(row)[0].numpy() + 0.025, atol=1e-6)
    assert scanned.stud[2] == pytest.approx(place[2] + 0.02 + STUD)


def ramp(start: float, count: int = 8) -> np.ndarray:
    return np.repeat(np.arange(start, start + count)[:, None], 3, axis=1)


def test_chunks_hand_out_their_steps_and_ask_for_more_in_time() -> None:
    chunks = Chunks()
    assert chunks.wanting and not chunks.next().any()
    chunks.push(ramp(0))
    taken = [chunks.next()[0] for _ in range(EXECUTE)]
    assert taken == list(range(EXECUTE)) and chunks.wanting
    # Nobody answered yet: what is left bridges the time.
    assert chunks.next()[0] == EXECUTE


def test_overlapping_chunks_are_blended_in_time() -> None:
    chunks = Chunks()
    chunks.push(ramp(0))
    for _ in range(EXECUTE):
        chunks.next()
    chunks.push(np.zeros((8, 3)))
    np.testing.assert_allclose([chunks.next()[0] for _ in range(2)], [BLEND * EXECUTE, BLEND * (EXECUTE + 1)])


@given(st.integers(0, 8))
def test_a_late_chunk_begins_where_it_is_by_now(late: int) -> None:
    chunks = Chunks()
    chunks.push(ramp(0), late)
    assert chunks.left == 8 - late
    assert chunks.next()[0] == (late if late < 8 else 0)
