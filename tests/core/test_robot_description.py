"""The description is one tree, says what the rig's own kinematics say, and as URDF says the same once more."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from resync_robot.core import spatial
from resync_robot.core.episode_records import EpisodeMeta
from resync_robot.core.joints import ARM_JOINTS
from resync_robot.core.machines import ARMS, GRIPPERS
from resync_robot.core.rig import Rig, load_rig
from resync_robot.core.robot_description import JOINTS, RobotDescription, camera_frame

UR_LINKS = {
    "base_link", "base_link_inertia", "base", "shoulder_link", "upper_arm_link", "forearm_link", "wrist_1_link",
    "wrist_2_link", "wrist_3_link", "flange", "tool0",
}  # fmt: skip
Q = np.array([0.3, -1.2, 1.1, -0.7, -1.4, 2.0])
OPENING = 0.06


def rig_of(arm: str, gripper: str) -> Rig:
    rig = load_rig()
    turned = spatial.transform(spatial.rotation_from_vector(np.array([0.1, -0.2, 0.7])), np.array([0.3, -0.1, 0.05]))
    cameras = [replace(rig.cameras[0], name='a "b" & c'), *rig.cameras]
    return replace(
        rig, arm=replace(rig.arm, model=arm, world_T_base=turned), gripper=replace(rig.gripper, model=gripper),
        cameras=tuple(cameras),
    )  # fmt: skip


def described(rig: Rig) -> RobotDescription:
    """As a recording has it."""
    about = {"library_hash": "", "domain": "", "scenario": "", "goal": "", "seed": 0, "backend": "sim"}
    return RobotDescription(json.loads(json.dumps(EpisodeMeta.of(rig, **about).rig)))


def placed(poses: Iterable[tuple[str, str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Pose of every frame in the world; fails where they are no tree with that root."""
    parents = {child: (parent, pose) for parent, child, pose in poses}

    def pose_of(frame: str) -> np.ndarray:
        if frame == "world":
            return np.eye(4)
        parent, pose = parents[frame]
        return pose_of(parent) @ pose

    return {frame: pose_of(frame) for frame in parents}


@pytest.mark.parametrize("gripper", GRIPPERS)
@pytest.mark.parametrize("arm", ARMS)
def test_frames_are_where_the_rig_has_them(arm: str, gripper: str) -> None:
    rig = rig_of(arm, gripper)
    robot = described(rig)
    poses = [*robot.fixed, *robot.moving(np.array([*Q, OPENING / 2, OPENING / 2]))]
    assert len({child for _, child, _ in poses}) == len(poses), "every frame hangs on one other"
    frames = placed(poses)
    assert frames.keys() >= UR_LINKS
    links = rig.arm.world_T_base @ rig.arm.kinematics.link_frames(Q)
    wanted = {
        "base": rig.arm.world_T_base, "tool0": links[-1], "tip": rig.tip_pose(Q),
        **{camera_frame(c.name): rig.camera_pose(c, Q) for c in rig.cameras},
    }  # fmt: skip
    for frame, pose in wanted.items():
        np.testing.assert_allclose(frames[frame], pose, atol=1e-9, err_msg=frame)
    across = frames["left_finger"][:3, 3] - frames["right_finger"][:3, 3]
    np.testing.assert_allclose(across, OPENING * links[-1][:3, 1], atol=1e-9)
    # UR's link frames turn about the same axes as its Denavit-Hartenberg frames.
    for i, link in enumerate(("shoulder_link", "upper_arm_link", "forearm_link", "wrist_1_link", "wrist_2_link")):
        axis = rig.arm.world_T_base[:3, 2] if i == 0 else links[i - 1][:3, 2]
        np.testing.assert_allclose(frames[link][:3, 2], axis, atol=1e-9, err_msg=link)


@pytest.mark.parametrize("arm", ARMS)
def test_the_urdf_says_the_same(arm: str) -> None:
    rig = rig_of(arm, "2f-140")
    robot = described(rig)
    root = ElementTree.fromstring(robot.urdf)
    links = [link.get("name") for link in root.iter("link")]
    poses = []
    positions = dict(zip(JOINTS, [*Q, OPENING / 2, OPENING / 2], strict=True))
    for joint in root.iter("joint"):
        parent, child, place = (joint.find(name) for name in ("parent", "child", "origin"))
        roll, pitch, yaw = map(float, place.get("rpy").split())
        turn = spatial.rotation_about("z", yaw) @ spatial.rotation_about("y", pitch) @ spatial.rotation_about("x", roll)
        pose = spatial.transform(turn, np.array(place.get("xyz").split(), dtype=float))
        if joint.get("type") != "fixed":
            axis = np.array(joint.find("axis").get("xyz").split(), dtype=float) * positions.pop(joint.get("name"))
            slides = joint.get("type") == "prismatic"
            move = spatial.transform(None if slides else spatial.rotation_from_vector(axis), axis * slides)
            pose = pose @ move
            limit = {name: float(value) for name, value in joint.find("limit").items()}
            assert limit["lower"] < limit["upper"] and limit["effort"] > 0 and limit["velocity"] > 0
        poses.append((parent.get("link"), child.get("link"), pose))
    assert not positions, "every joint of a recording has that name"
    frames, meant = placed(poses), placed([*robot.fixed, *robot.moving(np.array([*Q, OPENING / 2, OPENING / 2]))])
    assert sorted(links) == sorted({"world", *frames}) and frames.keys() == meant.keys()
    for frame, pose in frames.items():
        np.testing.assert_allclose(pose, meant[frame], atol=1e-9, err_msg=frame)
    drawn = {link.get("name") for link in root.iter("link") if link.find("visual") is not None}
    assert drawn >= {"base_link_inertia", *UR_LINKS & {n for n in UR_LINKS if n.endswith("_link")}} - {"base_link"}


def test_what_nobody_knows_is_left_out() -> None:
    q = np.array([*Q, np.nan, np.nan])
    assert [child for _, child, _ in described(load_rig()).moving(q)][-1] == "wrist_3_link"
    assert JOINTS[:6] == ARM_JOINTS
    with pytest.raises((KeyError, TypeError, ValueError)):
        RobotDescription({})
