"""Estimates from ray-cast pictures: exact depth and colour, so the errors are those of the method."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from resync_robot.core import spatial
from resync_robot.core.errors import PerceptionError
from resync_robot.core.rig import Rig
from resync_robot.core.world import CameraFrame
from resync_robot.perception.catalogue import Catalogue
from resync_robot.perception.objects import SceneEstimate, SceneEstimator, catalogue_of
from resync_robot.perception.scan import Scan
from tests.perception.raycast import CENTRE, FLOOR, INNER, RIM, Table

BLOCKS = {
    "b0": (CENTRE[0] + 0.118, CENTRE[1] - 0.118, FLOOR, 0.01, 0.060, 0.045),
    "b1": (CENTRE[0] - 0.03, CENTRE[1] + 0.02, FLOOR, 0.6, 0.054, 0.041),
    "b2": (0.44, 0.30, 0.0, -0.4, 0.065, 0.049),
}


@pytest.fixture(scope="module")
def frames(rig: Rig, catalogue: Catalogue) -> list[CameraFrame]:
    table = Table(rig, catalogue)
    for name, place in BLOCKS.items():
        table.block(name, *place)
    return table.scan()


@pytest.fixture(scope="module")
def scene(rig: Rig, frames: list[CameraFrame]) -> SceneEstimate:
    return SceneEstimator(rig).estimate(frames)


def test_the_box_is_measured(scene: SceneEstimate) -> None:
    box = scene.box.features
    assert box[:3] == pytest.approx([*CENTRE, FLOOR], abs=0.0007)
    assert abs(float(spatial.yaw_of(box[3:7]))) < np.radians(0.2)
    assert box[7:9] == pytest.approx([INNER, INNER], abs=0.002)
    assert box[9] == pytest.approx(RIM - FLOOR, abs=0.0005)


@pytest.mark.parametrize("name", sorted(BLOCKS))
def test_blocks_are_measured_and_nothing_else_is_seen(scene: SceneEstimate, name: str) -> None:
    x, y, bottom, yaw, width, height = BLOCKS[name]
    block = scene.blocks[name]
    assert set(scene.blocks) == set(BLOCKS)
    assert block.features[:3] == pytest.approx([x, y, bottom + height / 2], abs=0.001)
    assert abs(spatial.wrap(float(spatial.yaw_of(block.features[3:7])) - yaw, np.pi / 2)) < np.radians(0.6)
    assert block.features[7:] == pytest.approx([width, width, height], abs=0.0012)
    assert block.upright
    assert not block.stacked


def test_covariances_are_covariances(scene: SceneEstimate) -> None:
    for matrix in (scene.box.covariance, *(b.covariance for b in scene.blocks.values())):
        assert np.allclose(matrix, matrix.T)
        assert np.linalg.eigvalsh(matrix).min() > -1e-12
        assert 2e-4 < np.sqrt(matrix[0, 0]) < 3e-3


def test_tilt_and_height_of_a_wrong_camera_pose_are_corrected(rig: Rig, frames: list[CameraFrame]) -> None:
    tilted = []
    for i, frame in enumerate(frames):
        error = spatial.transform(spatial.rotation_about("xy"[i % 2], 0.01 * (-1) ** (i // 2)), np.array([0, 0, 0.004]))
        tilted.append(replace(frame, world_T_cam=frame.world_T_cam @ error))
    found = SceneEstimator(rig).estimate(tilted)
    for name, (x, y, bottom, _, _, height) in BLOCKS.items():
        assert found.blocks[name].features[2] == pytest.approx(bottom + height / 2, abs=0.0015)
        assert found.blocks[name].features[:2] == pytest.approx([x, y], abs=0.003)


def test_a_tower_hides_its_lower_block(rig: Rig, catalogue: Catalogue) -> None:
    table = Table(rig, catalogue)
    table.block("b0", 0.47, 0.03, FLOOR, 0.2, 0.060, 0.045)
    table.block("b1", 0.47, 0.03, FLOOR + 0.045, 0.2, 0.056, 0.043)
    found = SceneEstimator(rig).estimate(table.scan())
    assert set(found.blocks) == {"b1"}
    assert found.blocks["b1"].stacked
    assert found.blocks["b1"].features[2] == pytest.approx(FLOOR + 0.045 + 0.0215, abs=0.002)
    assert found.glimpses["b0"].centre == pytest.approx([0.47, 0.03], abs=0.04)


def test_a_block_that_lies_on_its_side_is_not_upright(rig: Rig, catalogue: Catalogue) -> None:
    table = Table(rig, catalogue)
    table.block("b1", 0.47, 0.03, FLOOR, 0.2, 0.056, 0.043)
    table.coloured("b0", (0.46, -0.30, 0.030), (0.024, 0.030, 0.030), 0.3)
    table.coloured("b0", (0.46 + 0.030 * np.cos(0.3), -0.30 + 0.030 * np.sin(0.3), 0.030), (0.006, 0.012, 0.012), 0.3)
    found = SceneEstimator(rig).estimate(table.scan())
    assert found.blocks["b1"].upright
    assert not found.blocks["b0"].upright
    assert found.blocks["b0"].features[:2] == pytest.approx([0.46, -0.30], abs=0.004)


def test_a_block_in_the_hand_is_not_taken_for_one_on_the_table(rig: Rig, catalogue: Catalogue) -> None:
    scan, frames = Scan(rig), []
    for q in scan.configurations:
        tip = rig.arm.world_T_base @ rig.arm.kinematics.forward(q) @ rig.gripper.flange_T_tip
        table = Table(rig, catalogue)
        table.block("b1", 0.47, 0.03, FLOOR, 0.2, 0.056, 0.043)
        table.block("b0", tip[0, 3], tip[1, 3], tip[2, 3] - 0.02, 0.0, 0.060, 0.045)
        frames.append(table.picture(q))
    found = SceneEstimator(rig).estimate(frames)
    assert set(found.blocks) == {"b1"}
    assert found.blocks["b1"].features[:2] == pytest.approx([0.47, 0.03], abs=0.001)


def spoil(frame: CameraFrame, **changes: np.ndarray) -> CameraFrame:
    return replace(frame, **changes)


BAD: dict[str, tuple[Callable[[CameraFrame], CameraFrame], str]] = {
    "all depth invalid": (lambda f: spoil(f, depth=np.zeros_like(f.depth)), "check the depth stream"),
    "empty depth": (lambda f: spoil(f, depth=np.zeros((0, 0), np.uint16)), "alignment"),
    "depth not aligned": (lambda f: spoil(f, depth=f.depth[::2, ::2]), "alignment"),
    "depth in mm": (lambda f: spoil(f, depth=(f.depth // 10).astype(np.uint16)), r"\* 10"),
    "depth in m": (lambda f: spoil(f, depth=(f.depth * 1e-4).astype(np.float32)), r"\* 10000"),
    "depth all saturated": (lambda f: spoil(f, depth=np.full_like(f.depth, 65535)), "1e-4 m"),
    "black picture": (lambda f: spoil(f, colour=np.zeros_like(f.colour)), "lens"),
    "camera pose wrong": (lambda f: spoil(f, world_T_cam=spatial.transform(None, np.array([0, 0, 5.0]))), "rig.toml"),
}


@pytest.mark.parametrize("what", sorted(BAD))
def test_a_picture_that_cannot_be_used_is_refused_with_what_to_do(
    rig: Rig, frames: list[CameraFrame], what: str
) -> None:
    spoiler, advice = BAD[what]
    with pytest.raises(PerceptionError, match=advice):
        SceneEstimator(rig).estimate([spoiler(frames[0]), *frames[1:]])


def test_no_box_and_no_pictures(rig: Rig, catalogue: Catalogue) -> None:
    with pytest.raises(PerceptionError, match="no box is seen"):
        SceneEstimator(rig).estimate(Table(rig, catalogue, box=False).scan())
    with pytest.raises(PerceptionError, match="without pictures"):
        SceneEstimator(rig).estimate([])


def test_noise_instead_of_pictures_crashes_nothing(rig: Rig, frames: list[CameraFrame]) -> None:
    rng = np.random.default_rng(0)
    noise = [
        spoil(
            f,
            colour=rng.integers(0, 256, f.colour.shape, dtype=np.uint8),
            depth=rng.integers(0, 65536, f.depth.shape, dtype=np.uint16),
        )
        for f in frames
    ]
    with pytest.raises(PerceptionError):
        SceneEstimator(rig).estimate(noise)


def test_a_lab_with_blocks_of_its_own_colours(rig: Rig) -> None:
    own = replace(rig, hues={"b0": 0.80, "b1": 0.45})
    table = Table(own, catalogue_of(own))
    table.block("b0", 0.45, 0.05, FLOOR, 0.2, 0.060, 0.045)
    frames = table.scan()
    assert set(SceneEstimator(own).estimate(frames).blocks) == {"b0"}
    assert not SceneEstimator(rig).estimate(frames).blocks


@settings(max_examples=40, deadline=None)
@given(
    colour=st.sampled_from([(60, 106, 3), (60, 106), (60, 106, 4), (0, 0, 3), (106, 60, 3), (3,)]),
    depth=st.sampled_from([(60, 106), (60, 106, 1), (0, 0), (106, 60), (6360,)]),
    kinds=st.tuples(*[st.sampled_from([np.uint8, np.uint16, np.int32, np.float32])] * 2),
    level=st.sampled_from([0, 5, 200]),
    lost=st.sampled_from([0.0, np.nan, np.inf, -1.0]),
    which=st.sampled_from(["intrinsics", "world_T_cam", ""]),
)
def test_malformed_frames_are_refused(
    rig: Rig,
    colour: tuple[int, ...],
    depth: tuple[int, ...],
    kinds: tuple[type, type],
    level: int,
    lost: float,
    which: str,
) -> None:
    """Wrong shapes, kinds of number and matrices; a flat grey picture has no box, so none of them is an estimate."""
    frame = CameraFrame(
        "wrist",
        np.full(colour, level, kinds[0]),
        np.full(depth, 5000, kinds[1]) if kinds[1] is not np.uint8 else np.full(depth, level, np.uint8),
        np.eye(3) * 77.0,
        np.eye(4),
        0.0,
    )
    if which:
        frame = replace(frame, **{which: np.full((3, 3) if which == "intrinsics" else (4, 4), lost)})
    with pytest.raises(PerceptionError), np.errstate(all="ignore"):
        SceneEstimator(rig).estimate([frame])


@pytest.mark.parametrize("pictures", [100, pytest.param(10_000, marks=pytest.mark.slow)])
def test_spoilt_pictures_crash_nothing(rig: Rig, catalogue: Catalogue, pictures: int) -> None:
    """Small pictures, parts of which were lost, doubled, shifted or overwritten: an estimate or an error of our own."""
    small = replace(
        rig,
        cameras=tuple(
            replace(c, width=106, height=60, fx=c.fx / 4, fy=c.fy / 4, cx=c.cx / 4, cy=c.cy / 4) for c in rig.cameras
        ),
    )
    table = Table(small, catalogue)
    table.block("b0", 0.45, 0.05, FLOOR, 0.3, 0.060, 0.045)
    table.block("b1", 0.55, -0.08, FLOOR, 0.1, 0.060, 0.045)
    good, estimator, rng, refused = table.scan(), SceneEstimator(small), np.random.default_rng(0), 0
    for _ in range(pictures):
        frame = good[int(rng.integers(len(good)))]
        colour, depth, pose = frame.colour.copy(), frame.depth.copy(), frame.world_T_cam.copy()
        for _ in range(int(rng.integers(1, 4))):
            a, b = sorted(rng.integers(0, 61, 2))
            c, d = sorted(rng.integers(0, 107, 2))
            kind = rng.integers(6)
            if kind == 0:
                depth[a:b, c:d] = rng.choice([0, 1, 500, 65535])
            elif kind == 1:
                depth[a:b, c:d] = rng.integers(0, 65536, (b - a, d - c))
            elif kind == 2:
                colour[a:b, c:d] = rng.integers(0, 256, 3)
            elif kind == 3:
                depth = np.roll(depth, int(rng.integers(-30, 30)), axis=int(rng.integers(2)))
            elif kind == 4:
                pose[:3, 3] += rng.normal(0, 0.05, 3)
            else:
                depth = (depth * rng.uniform(0.1, 3.0)).clip(0, 65535).astype(np.uint16)
        try:
            found = estimator.estimate([replace(frame, colour=colour, depth=depth, world_T_cam=pose)])
            assert all(np.isfinite(e.features).all() for e in found.blocks.values())
        except PerceptionError:
            refused += 1
    assert 0 < refused < pictures


def test_two_pictures_of_one_place_do_where_the_box_is_known(
    rig: Rig, scene: SceneEstimate, frames: list[CameraFrame], catalogue: Catalogue
) -> None:
    table = Table(rig, catalogue)
    for name, place in BLOCKS.items():
        table.block(name, *place)
    x, y, bottom, *_, height = BLOCKS["b1"]
    views = Scan(rig).towards(np.array([x, y]))
    seen = SceneEstimator(rig).estimate(table.scan(views), scene.box)
    assert seen.box is scene.box
    assert seen.blocks["b1"].features[:3] == pytest.approx([x, y, bottom + height / 2], abs=0.0012)
    # As long as it stands where it did.
    beside = replace(scene.box, features=scene.box.features + np.array([0.012, *[0.0] * 10]))
    with pytest.raises(PerceptionError, match=r"the box is \d+ mm from where it was"):
        SceneEstimator(rig).estimate(table.scan(views), beside)
    # What is only reckoned from a lid says nothing of where it stood.
    reckoned = SceneEstimator(rig).estimate(table.scan(views), replace(beside, seen=False))
    assert reckoned.blocks["b1"].features[:2] == pytest.approx([x, y], abs=0.0012)
