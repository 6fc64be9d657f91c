"""Which patches of a colour are one block: touching, stacked, too many, seen twice."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from resync_robot.core import spatial
from resync_robot.core.rig import Rig
from resync_robot.core.vocabulary import BLOCK, BOX, ROBOT
from resync_robot.perception.belief import Belief
from resync_robot.perception.blocks import CORNER_GAP, in_corner
from resync_robot.perception.catalogue import Catalogue
from resync_robot.perception.naming import AmbiguousObjectsError, MissingObjectsError
from resync_robot.perception.objects import SceneEstimate, SceneEstimator
from resync_robot.perception.segment import ColourSegmenter
from tests.perception.raycast import FLOOR, Table

TWINS = Catalogue(hues={**Catalogue().hues, "b4": Catalogue().hues["b0"]})
WIDTH, HEIGHT = 0.060, 0.045


def look(rig: Rig, catalogue: Catalogue, *blocks: tuple[str, float, float, float, float]) -> SceneEstimate:
    """What a scan says about upright blocks at (name, x, y, bottom, yaw)."""
    table = Table(rig, catalogue)
    for name, x, y, bottom, yaw in blocks:
        table.block(name, x, y, bottom, yaw, WIDTH, HEIGHT)
    return SceneEstimator(rig, catalogue).estimate(table.scan())


def places(scene: SceneEstimate, *names: str) -> list[tuple[float, float]]:
    return sorted((float(scene.blocks[n].features[0]), float(scene.blocks[n].features[1])) for n in names)


def test_two_of_one_colour_are_two(rig: Rig) -> None:
    scene = look(rig, TWINS, ("b0", 0.40, 0.06, FLOOR, 0.3), ("b4", 0.53, -0.05, FLOOR, -0.2))
    assert set(scene.blocks) == {"b0", "b4"} and not scene.surplus
    np.testing.assert_allclose(places(scene, "b0", "b4"), [(0.40, 0.06), (0.53, -0.05)], atol=0.001)


@pytest.mark.parametrize("along", [0.0, 0.02])
def test_two_of_one_colour_that_touch_are_still_two(rig: Rig, along: float) -> None:
    yaw = 0.25
    c, s = np.cos(yaw), np.sin(yaw)
    x, y = 0.45 + (WIDTH + 0.0005) * c - along * s, -0.02 + (WIDTH + 0.0005) * s + along * c
    scene = look(rig, TWINS, ("b0", 0.45, -0.02, FLOOR, yaw), ("b4", x, y, FLOOR, yaw))
    assert set(scene.blocks) == {"b0", "b4"} and not scene.surplus
    np.testing.assert_allclose(places(scene, "b0", "b4"), [(0.45, -0.02), (x, y)], atol=0.002)
    for name in ("b0", "b4"):
        assert spatial.yaw_of(scene.blocks[name].features[3:7]) == pytest.approx(yaw, abs=0.02)
        assert scene.blocks[name].features[7] == pytest.approx(WIDTH, abs=0.0015)
    # The edge between them is not seen, and the estimate says so.
    alone = look(rig, TWINS, ("b0", 0.45, -0.02, FLOOR, yaw)).blocks["b0"].covariance
    assert scene.blocks["b0"].covariance[0, 0] > 1.5 * alone[0, 0]


@given(
    x=st.floats(0.4, 0.6), y=st.floats(-0.1, 0.1), yaw=st.floats(-3.1, 3.1), corner=st.sampled_from([-1.0, 1.0]),
    gaps=st.tuples(st.floats(-0.003, 0.05), st.floats(-0.003, 0.05)),
)  # fmt: skip
def test_a_corner_is_where_two_walls_are_close(
    x: float, y: float, yaw: float, corner: float, gaps: tuple[float, float]
) -> None:
    assume(all(abs(gap - CORNER_GAP) > 1e-6 for gap in gaps))
    box = np.array([x, y, FLOOR, *spatial.quat_from_yaw(yaw), 0.30, 0.28, 0.11, 0.03])
    local = np.array([0.15 - WIDTH / 2 - gaps[0], corner * (0.14 - WIDTH / 2 - gaps[1]), 0.0, 1.0])
    place = (spatial.pose_from_features(box[:7]) @ local)[:2]
    assert in_corner(place, WIDTH, box) == (max(gaps) < CORNER_GAP)


def test_the_lower_of_a_tower_of_one_colour_is_glimpsed(rig: Rig) -> None:
    scene = look(rig, TWINS, ("b0", 0.47, 0.03, FLOOR, 0.2), ("b4", 0.47, 0.03, FLOOR + HEIGHT, 0.2))
    (name,) = scene.blocks
    assert scene.blocks[name].stacked
    other = ({"b0", "b4"} - {name}).pop()
    assert scene.glimpses[other].centre == pytest.approx([0.47, 0.03], abs=0.02)


def test_one_block_too_many_is_reported_and_never_chosen(rig: Rig) -> None:
    scene = look(rig, Catalogue(), ("b0", 0.40, 0.06, FLOOR, 0.3), ("b0", 0.53, -0.05, FLOOR, -0.2))
    assert len(scene.surplus) == 1
    b0 = BLOCK("b0")
    robot = np.array([0.45, 0.0, 0.30, 0.0, 1.0, 0.0, 0.0, 0.14])
    belief = Belief(ROBOT("r"), BOX("box"), (b0,), rig)
    with pytest.raises(AmbiguousObjectsError, match="2 things that may be b0") as caught:
        belief.update(scene, robot)
    assert caught.value.names == ("b0",)
    assert belief.report.ambiguous == ("b0",)
    assert b0 not in belief.state(robot)
    # Once it is known where it stood, the other one is somebody else's.
    belief.update(replace(scene, blocks={"b0": scene.blocks["b0"]}, surplus=()), robot)
    before = belief.state(robot)[b0]
    swapped = replace(scene.surplus[0], name="b0")
    again = belief.update(replace(scene, blocks={"b0": swapped}, surplus=(scene.blocks["b0"],)), robot)
    assert again[b0][:2] == pytest.approx(before[:2], abs=1e-6)


def test_a_mask_without_depth_says_so(rig: Rig) -> None:
    table = Table(rig, Catalogue())
    table.block("b0", 0.45, 0.05, FLOOR, 0.2, WIDTH, HEIGHT)
    frames = []
    for frame in table.scan():
        depth = frame.depth.copy()
        for segment in ColourSegmenter(Catalogue()).segment(frame):
            depth[cv2.dilate(segment.mask.astype(np.uint8), np.ones((5, 5), np.uint8)).astype(bool)] = 0
        frames.append(replace(frame, depth=depth))
    scene = SceneEstimator(rig).estimate(frames)
    assert scene.without_depth == ("b0",) and not scene.blocks
    belief = Belief(ROBOT("r"), BOX("box"), (BLOCK("b0"),), rig)
    with pytest.raises(MissingObjectsError, match=r"b0 shows in the pictures, but without depth(.|\n)*glare"):
        belief.update(scene, np.array([0.45, 0.0, 0.30, 0.0, 1.0, 0.0, 0.0, 0.14]))
