from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from resync_robot.core import spatial
from resync_robot.core.rig import CameraRig, load_rig
from resync_robot.core.sensor_noise import SensorNoise
from resync_robot.core.world import CameraFrame
from resync_robot.sim_training.physics.camera_noise import NoisySensor, Tone

UNIT = CameraFrame.DEPTH_UNIT_M
WRIST = load_rig().camera("wrist")
FOCAL_BASELINE = 447.0 * WRIST.width / 848 * 0.050
ONLY_NOISE = SensorNoise(ripple_px=0.0, disparity_step_px=1e-6, hole_share=0.0)


def plane(z: float) -> CameraFrame:
    shape = (WRIST.height, WRIST.width)
    depth = np.full(shape, round(z / UNIT), np.uint16)
    return CameraFrame("wrist", np.full((*shape, 3), 128, np.uint8), depth, WRIST.intrinsics, np.eye(4), 0.0)


def measured(frame: CameraFrame) -> np.ndarray:
    return frame.depth[frame.depth > 0] * UNIT


@settings(max_examples=12, deadline=None)
@given(z=st.floats(0.25, 1.5))
def test_noise_grows_with_the_square_of_the_distance(z: float) -> None:
    values = measured(NoisySensor(1, WRIST, ONLY_NOISE).apply(plane(z)))
    assert np.std(values) == pytest.approx(z**2 * 0.08 / FOCAL_BASELINE, rel=0.05)
    assert np.mean(values) == pytest.approx(z, abs=0.1 * np.std(values) + UNIT)


def test_left_band_has_no_depth() -> None:
    depth = NoisySensor(1, WRIST, ONLY_NOISE).apply(plane(0.5)).depth
    band = int(FOCAL_BASELINE / 0.5)
    assert not depth[:, :band].any()
    assert depth[:, band + 1 :].all()


def test_nearer_than_the_least_depth_is_invalid() -> None:
    assert len(measured(NoisySensor(1, WRIST).apply(plane(0.09)))) == 0
    assert len(measured(NoisySensor(1, WRIST).apply(plane(0.15)))) > 0


def test_edges_have_flying_pixels_holes_and_a_shadow_on_their_left() -> None:
    frame = plane(0.5)
    frame.depth[80:160, 180:260] = round(0.4 / UNIT)
    depth = NoisySensor(1, WRIST).apply(frame).depth.astype(float) * UNIT
    between = (depth > 0.42) & (depth < 0.48)
    near_edge = np.zeros_like(between)
    near_edge[77:163, 165:263] = True
    near_edge[84:156, 184:256] = False
    assert between[near_edge].sum() > 30
    assert between[~near_edge].sum() == 0
    shadow = int(FOCAL_BASELINE * (1 / 0.4 - 1 / 0.5))
    left, right = depth[90:150, 180 - shadow + 1 : 179], depth[90:150, 262 : 262 + shadow]
    assert np.mean(left == 0) > 0.8
    assert np.mean(right == 0) < 0.1


def test_holes_are_as_frequent_as_asked() -> None:
    depth = NoisySensor(1, WRIST, SensorNoise(hole_share=0.05)).apply(plane(0.5)).depth
    assert np.mean(depth[:, 60:] == 0) == pytest.approx(0.05, abs=0.01)


def test_ripple_repeats_with_the_disparity() -> None:
    sensor = NoisySensor(1, WRIST, SensorNoise(disparity_sigma_px=0.0, hole_share=0.0, disparity_step_px=1e-6))

    def error(disparity: float) -> float:
        z = FOCAL_BASELINE / disparity
        return float(FOCAL_BASELINE / np.median(measured(sensor.apply(plane(z))))) - FOCAL_BASELINE / (
            round(z / UNIT) * UNIT
        )

    assert error(20.25) == pytest.approx(0.03, abs=0.006)
    assert error(20.75) == pytest.approx(-0.03, abs=0.006)


def test_wrist_pose_error_is_new_in_every_view_and_as_large_as_the_rig_says() -> None:
    sensor, frame = NoisySensor(1, WRIST), plane(0.5)
    frame = replace(frame, colour=frame.colour[:9, :16], depth=frame.depth[:9, :16])
    poses = np.array([sensor.apply(frame).world_T_cam for _ in range(400)])
    assert np.std(poses[:, :3, 3], axis=0) == pytest.approx([WRIST.position_sigma] * 3, rel=0.15)
    turns = np.array([spatial.rotation_vector(p[:3, :3]) for p in poses])
    assert np.std(turns, axis=0) == pytest.approx([WRIST.rotation_sigma] * 3, rel=0.15)


def test_a_camera_that_stands_keeps_its_error() -> None:
    front: CameraRig = load_rig().camera("front")
    sensor, frame = NoisySensor(1, front), plane(0.5)
    first, second = sensor.apply(frame).world_T_cam, sensor.apply(frame).world_T_cam
    assert np.array_equal(first, second)
    assert not np.allclose(first, frame.world_T_cam, atol=1e-5)


def test_same_seed_same_frames() -> None:
    first, second = NoisySensor(7, WRIST).apply(plane(0.4)), NoisySensor(7, WRIST).apply(plane(0.4))
    assert np.array_equal(first.depth, second.depth)
    assert np.array_equal(first.colour, second.colour)
    assert not np.array_equal(first.depth, NoisySensor(8, WRIST).apply(plane(0.4)).depth)


def test_an_empty_picture_stays_empty() -> None:
    frame = plane(0.5)
    frame.depth[:] = 0
    assert not NoisySensor(1, WRIST).apply(frame).depth.any()


def test_a_frame_costs_little() -> None:
    sensor, frame = NoisySensor(1, WRIST), plane(0.5)
    spent = []
    for _ in range(15):
        begun = time.process_time()
        sensor.apply(frame)
        spent.append(time.process_time() - begun)
    assert min(spent) < 0.015


def test_a_camera_as_a_world_has_it_when_nothing_is_said_leaves_colours_alone() -> None:
    picture = np.random.default_rng(0).integers(0, 256, (8, 8, 3)).astype(np.uint8)
    np.testing.assert_array_equal(Tone.of({}).apply(picture), picture)


def test_gamma_darkens_middle_tones_and_white_balance_tints() -> None:
    grey = np.full((2, 2, 3), 110, dtype=np.uint8)
    assert Tone(gamma=1.0).apply(grey).max() < 60
    assert Tone(gamma=1.0).apply(np.full((1, 1, 3), 255, np.uint8)).min() == 255, "white stays"
    red, green, _ = Tone(white_balance=(1.1, 1.0, 0.9)).apply(grey)[0, 0].astype(int)
    assert red > green == 110
    sensed = NoisySensor(0, WRIST, ONLY_NOISE, Tone(gamma=1.0)).colour(np.full((40, 40, 3), 110, np.uint8))
    assert sensed.mean() < 60, "the sensor sees through it"


def test_a_camera_that_watches_one_scene_keeps_its_exposure_but_for_a_slow_drift() -> None:
    quiet = replace(WRIST.noise, colour_sigma=0.0)
    grey = np.full((4, 4, 3), 110, np.uint8)

    def levels(seed: int, times: Sequence[float], steady: bool = True) -> np.ndarray:
        sensor = NoisySensor(seed, WRIST, quiet, steady=steady)
        return np.array([sensor.colour(grey, time).mean() for time in times])

    seconds = np.arange(0.0, 10.0, 0.1)
    slow, anew = levels(0, seconds), levels(0, seconds, steady=False)
    assert np.abs(np.diff(slow)).max() <= 2.0 < np.abs(np.diff(anew)).max()
    # Episodes, and moments far apart, differ by as much as pictures that are drawn anew.
    for drawn in (np.array([levels(k, [0.0])[0] for k in range(300)]), levels(0, 3600.0 * np.arange(300))):
        assert np.std(np.log(drawn)) == pytest.approx(quiet.exposure_sigma, rel=0.15)


@pytest.mark.parametrize("steady", [False, True])
def test_however_often_a_film_looks_the_pictures_that_are_asked_for_stay_the_same(steady: bool) -> None:
    plain, filmed = (NoisySensor(7, WRIST, steady=steady) for _ in range(2))
    frame = plane(0.4)
    for k in range(3):
        for i in range(3 * k):
            filmed.glimpse(frame.colour, 30.0 * k - i)
        first, second = (sensor.apply(replace(frame, time=30.0 * k)) for sensor in (plain, filmed))
        np.testing.assert_array_equal(first.colour, second.colour)
        np.testing.assert_array_equal(first.depth, second.depth)
        np.testing.assert_array_equal(first.world_T_cam, second.world_T_cam)
    assert (filmed.glimpse(frame.colour) != filmed.glimpse(frame.colour)).any()
