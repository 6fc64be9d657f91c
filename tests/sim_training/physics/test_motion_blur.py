"""Blur and smear: as far as the camera moves, along the way it moves, and none where it rests."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from resync_robot.core import spatial
from resync_robot.core.rig import load_rig
from resync_robot.core.sensor_noise import SensorNoise
from resync_robot.core.world import CameraFrame
from resync_robot.sim_training.physics.camera_noise import NoisySensor
from resync_robot.sim_training.physics.motion_blur import Motion, camera_motion, flow_of, smear_colour, smear_depth

RIG = load_rig()
WRIST = RIG.camera("wrist")
K, UNIT = WRIST.intrinsics, CameraFrame.DEPTH_UNIT_M
QUIET = SensorNoise(
    disparity_sigma_px=0.0,
    ripple_px=0.0,
    disparity_step_px=1e-6,
    hole_share=0.0,
    flying_share=0.0,
    edge_hole_share=0.0,
    exposure_sigma=0.0,
    white_balance_sigma=0.0,
    colour_sigma=0.0,
)
speeds = st.floats(-0.3, 0.3)


def frame(z: float = 0.4) -> CameraFrame:
    """A plane at z, its right half white."""
    shape = (WRIST.height, WRIST.width)
    colour = np.zeros((*shape, 3), np.uint8)
    colour[:, WRIST.width // 2 :] = 200
    return CameraFrame("wrist", colour, np.full(shape, round(z / UNIT), np.uint16), K, np.eye(4), 0.0)


@settings(max_examples=25, deadline=None)
@given(twist=st.tuples(*[speeds] * 6), u=st.integers(20, 400), v=st.integers(20, 220), z=st.floats(0.2, 1.0))
def test_flow_is_where_a_resting_point_goes(twist: tuple[float, ...], u: int, v: int, z: float) -> None:
    t = 1e-5
    motion = Motion(np.array(twist))
    point = z * np.linalg.solve(K, [u, v, 1.0])
    now_T_then = spatial.transform(spatial.rotation_from_vector(motion.twist[3:] * t), motion.twist[:3] * t)
    later = K @ spatial.apply(spatial.inverse(now_T_then), point[None])[0]
    flow = flow_of(motion, np.full((240, 424), z), K, np.eye(4))[v, u]
    assert flow == pytest.approx((later[:2] / later[2] - [u, v]) / t, rel=1e-3, abs=0.05)


@settings(max_examples=15, deadline=None)
@given(q=st.lists(st.floats(-0.2, 0.2), min_size=6, max_size=6), qd=st.lists(speeds, min_size=6, max_size=6))
def test_the_wrist_camera_moves_as_the_flange_carries_it(q: list[float], qd: list[float]) -> None:
    at, rate = RIG.arm.home + q, np.array(qd)
    motion = camera_motion(RIG, "wrist", at, rate)
    assert motion is not None
    world_R_cam = RIG.camera_pose(WRIST, at)[:3, :3]
    tip = RIG.tip_jacobian(at) @ rate
    lever = RIG.camera_pose(WRIST, at)[:3, 3] - RIG.tip_pose(at)[:3, 3]
    np.testing.assert_allclose(world_R_cam @ motion.twist[3:], tip[3:], atol=1e-4)
    np.testing.assert_allclose(world_R_cam @ motion.twist[:3], tip[:3] + np.cross(tip[3:], lever), atol=1e-4)
    assert camera_motion(RIG, "front", at, rate) is None


@pytest.mark.parametrize("speed", [0.0, 1e-3])
def test_a_resting_camera_gives_the_pictures_it_gave(speed: float) -> None:
    plain = NoisySensor(3, WRIST).apply(frame())
    resting = NoisySensor(3, WRIST).apply(frame(), Motion(np.array([speed, 0, 0, 0, 0, speed])))
    assert np.array_equal(plain.colour, resting.colour) and np.array_equal(plain.depth, resting.depth)
    never = replace(WRIST, noise=SensorNoise(exposure_time=0.0, depth_exposure_time=0.0))
    shut = NoisySensor(3, never).apply(frame(), Motion(np.array([0.3, 0, 0, 0, 0, 0])))
    assert np.array_equal(plain.colour, shut.colour) and np.array_equal(plain.depth, shut.depth)


@pytest.mark.parametrize("speed", [0.2, 0.5])
def test_an_edge_is_as_wide_as_the_camera_went_meanwhile(speed: float) -> None:
    seen = NoisySensor(0, WRIST, QUIET).apply(frame(), Motion(np.array([speed, 0, 0, 0, 0, 0]))).colour
    row = seen[120, :, 0]
    between = np.sum((row > 2) & (row < 198))
    assert between == pytest.approx(QUIET.exposure_time * speed / 0.4 * K[0, 0], abs=2)
    assert np.all(np.diff(row.astype(int)) >= 0), "one ramp"
    along = NoisySensor(0, WRIST, QUIET).apply(frame(), Motion(np.array([0, speed, 0, 0, 0, 0]))).colour
    assert np.array_equal(along, frame().colour), "along the edge nothing changes"


def test_depth_smears_between_near_and_far_and_nowhere_else() -> None:
    taken = frame(0.5)
    # On the other side the second eye's shadow hides it.
    taken.depth[:, :250] = round(0.3 / UNIT)
    moving = NoisySensor(0, WRIST, QUIET).apply(taken, Motion(np.array([0.6, 0, 0, 0, 0, 0]))).depth * UNIT
    between = (moving > 0.32) & (moving < 0.48)
    assert between[:, 240:262].any() and not between[:, :238].any() and not between[:, 264:].any()
    rest = NoisySensor(0, WRIST, QUIET).apply(taken).depth * UNIT
    assert not ((rest > 0.32) & (rest < 0.48)).any()
    assert np.median(moving[:, 100:200]) == pytest.approx(0.3, abs=2 * UNIT)


def test_what_rides_with_the_camera_stays_sharp() -> None:
    motion = camera_motion(RIG, "wrist", RIG.arm.home, np.array([0.5, 0, 0, 0, 0, 0]))
    assert motion is not None
    tips = spatial.apply(spatial.inverse(WRIST.pose), np.array([[0.0, 0.0, RIG.gripper.tip_offset - 0.02]]))[0]
    pixel = K @ tips / tips[2]
    u, v = np.clip(pixel[:2].round().astype(int), 0, [WRIST.width - 1, WRIST.height - 1])
    depth = np.full((WRIST.height, WRIST.width), 0.6)
    far = flow_of(motion, depth, K, WRIST.pose)
    depth[v, u] = tips[2]
    assert np.linalg.norm(far, axis=-1).min() > 1.0
    assert not flow_of(motion, depth, K, WRIST.pose)[v, u].any()


@settings(max_examples=15, deadline=None)
@given(right=st.floats(-40, 40), down=st.floats(-40, 40), seed=st.integers(0, 99))
def test_smearing_invents_neither_light_nor_surfaces(right: float, down: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    colour, z = rng.integers(0, 256, (24, 32, 3), dtype=np.uint8), rng.uniform(0.2, 1.0, (24, 32)).astype(np.float32)
    z[rng.random(z.shape) < 0.2] = 0.0
    path = np.broadcast_to(np.array([right, down], np.float32), (24, 32, 2))
    smeared, deep = smear_colour(colour, path), smear_depth(z, path)
    assert smeared.dtype == np.uint8 and smeared.min() >= colour.min() and smeared.max() <= colour.max()
    seen = deep[deep > 0]
    assert deep.shape == z.shape and np.all(seen >= z[z > 0].min() - 1e-5) and np.all(seen <= z.max() + 1e-5)
