from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from resync_robot.core import spatial
from resync_robot.core.errors import MotionError, PerceptionError
from resync_robot.core.rig import Rig
from resync_robot.perception.scan import BOX_AND_SIDES, LEAST_TIP_HEIGHT, Scan, Viewpoint


def test_configurations_put_the_camera_where_the_viewpoints_say(rig: Rig) -> None:
    camera = rig.camera("wrist")
    for view, q in zip(BOX_AND_SIDES, Scan(rig).configurations, strict=True):
        flange = rig.arm.world_T_base @ rig.arm.kinematics.forward(q)
        assert np.allclose((flange @ camera.pose)[:2, 3], view.camera_xy, atol=1e-6)
        tip = flange @ rig.gripper.flange_T_tip
        assert tip[2, 3] == pytest.approx(view.tip_height, abs=1e-6)
        assert np.allclose(tip[:3, 2], [0, 0, -1], atol=1e-6)


def test_the_arm_stays_above_the_walls_and_moves_little(rig: Rig) -> None:
    scan = Scan(rig)
    for q in scan.configurations:
        assert np.all(np.abs(q) <= rig.arm.kinematics.joint_limit)
        heights = (rig.arm.world_T_base @ rig.arm.kinematics.link_frames(q))[:, 2, 3]
        assert heights.min() > LEAST_TIP_HEIGHT / 2
    last = rig.arm.home
    for q in scan.configurations:
        # Between two views the straight way in joint space keeps the tips above the walls.
        for s in np.linspace(0, 1, 9):
            tip = rig.arm.world_T_base @ rig.arm.kinematics.forward(last + s * (q - last)) @ rig.gripper.flange_T_tip
            assert tip[2, 3] > 0.2
        assert np.abs(q - last).max() < 2.3
        last = q


def test_every_place_of_a_block_is_in_three_pictures(rig: Rig) -> None:
    camera = rig.camera("wrist")
    x, y = np.meshgrid(np.linspace(0.30, 0.66, 19), np.linspace(-0.36, 0.36, 37))
    inside = np.abs(y) < 0.18
    beside = (np.abs(y) > 0.22) & (x > 0.34) & (x < 0.58)
    keep = inside | beside
    points = np.column_stack([x[keep], y[keep], np.full(keep.sum(), 0.05)])
    seen = np.zeros(len(points), dtype=int)
    for q in Scan(rig).configurations:
        pose = rig.arm.world_T_base @ rig.arm.kinematics.forward(q) @ camera.pose
        local = spatial.apply(spatial.inverse(pose), points)
        u = camera.fx * local[:, 0] / local[:, 2] + camera.cx
        v = camera.fy * local[:, 1] / local[:, 2] + camera.cy
        seen += (u > 30) & (u < camera.width - 2) & (v > 2) & (v < camera.height - 2)
    assert seen[inside[keep]].min() >= 3
    assert seen[beside[keep]].min() >= 1
    assert np.mean(seen[beside[keep]] >= 2) > 0.5


def test_pictures_are_taken_at_rest_in_order(rig: Rig) -> None:
    log: list[object] = []
    scan = Scan(rig)
    frames = scan(lambda q: log.append(q), lambda: log.append("picture"))  # type: ignore[func-returns-value, arg-type]
    assert len(frames) == len(scan.configurations)
    assert [i for i, entry in enumerate(log) if isinstance(entry, str)] == list(range(1, 2 * len(frames), 2))


def test_bad_viewpoints_are_refused(rig: Rig) -> None:
    with pytest.raises(PerceptionError, match=r"0\.200 m above"):
        Scan(rig, [replace(BOX_AND_SIDES[0], tip_height=0.2)])
    with pytest.raises(MotionError, match="cannot hold"):
        Scan(rig, [Viewpoint((1.4, 0.0), 0.3, 0.0)])
    with pytest.raises(PerceptionError, match="mounted on the world"):
        Scan(rig, camera="front")


@pytest.mark.parametrize("place", [(0.34, 0.14), (0.60, -0.13), (0.48, 0.0), (0.45, 0.27), (0.45, -0.27)])
def test_a_second_look_has_the_place_in_the_middle_of_the_picture(rig: Rig, place: tuple[float, float]) -> None:
    camera = rig.camera("wrist")
    configurations = Scan(rig).towards(np.array(place))
    assert len(configurations) == 2
    directions = []
    for q in configurations:
        flange = rig.arm.world_T_base @ rig.arm.kinematics.forward(q)
        assert (flange @ rig.gripper.flange_T_tip)[2, 3] >= LEAST_TIP_HEIGHT
        pose = flange @ camera.pose
        local = spatial.apply(spatial.inverse(pose), np.array([[*place, 0.0]]))[0]
        u, v = camera.fx * local[0] / local[2] + camera.cx, camera.fy * local[1] / local[2] + camera.cy
        assert abs(u - camera.cx) < 5 and abs(v - camera.cy) < 5
        directions.append(pose[:2, 3] - place)
    # From two sides, or a common error of the views would stay.
    a, b = (d / np.linalg.norm(d) for d in directions)
    assert a @ b < 0.8


def test_a_place_out_of_reach_is_not_looked_at(rig: Rig) -> None:
    assert Scan(rig).towards(np.array([1.6, 0.0])) == []
