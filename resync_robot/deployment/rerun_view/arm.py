"""The arm, its cameras and the force on its hand, from what was measured."""

from __future__ import annotations

import cv2
import numpy as np
import rerun as rr

from resync_robot.core import spatial
from resync_robot.core.episode import Episode
from resync_robot.core.joints import ARM_JOINTS
from resync_robot.core.kinematics import ALPHA
from resync_robot.core.recorded_rig import RecordedRig
from resync_robot.core.robot_description import PALM
from resync_robot.core.world import CameraFrame
from resync_robot.deployment.rerun_view.series import pose_of, send_curve, send_poses

POSE_HZ = 25.0
"""How often the robot is drawn; more makes the file larger, not the picture better."""
LINK_RADII = (0.06, 0.055, 0.05, 0.045, 0.045, 0.04)
STEEL, DARK = (150, 165, 180), (60, 65, 70)
CURVES = {"requested": (120, 120, 120), "sent": (240, 150, 40), "measured": (80, 170, 240)}


def draw_robot(episode: Episode, recording: rr.RecordingStream) -> None:
    """Links as capsules, hand and fingers as boxes, joints as curves."""
    geometry = RecordedRig.of(episode)
    kinematics = geometry.arm.kinematics
    joints = list(episode.joints())
    for i, (joint, radius) in enumerate(zip(ARM_JOINTS, LINK_RADII, strict=True)):
        # The previous joint seen from this link's frame does not depend on the joint's angle.
        back = -np.array([kinematics.a[i], *(kinematics.d[i] * f(ALPHA[i]) for f in (np.sin, np.cos))])
        recording.log(f"world/robot/{joint}", _capsule(back, radius), static=True)
    palm = rr.Boxes3D(half_sizes=[np.array(PALM) / 2], centers=[[0, 0, PALM[2] / 2]], colors=DARK, fill_mode="solid")
    recording.log("world/robot/hand", palm, static=True)
    length = max(geometry.tip_offset - PALM[2], 0.01)
    finger_size = np.array([geometry.finger_width, geometry.finger_thickness, length]) / 2
    for side in ("left", "right"):
        finger = rr.Boxes3D(half_sizes=[finger_size], colors=STEEL, fill_mode="solid")
        recording.log(f"world/robot/hand/{side}_finger", finger, static=True)
    if not joints:
        return

    shown, last = [], -np.inf
    for moment in joints:
        if moment.time >= last + 0.99 / POSE_HZ and np.isfinite(moment.measured).all():
            shown.append(moment)
            last = moment.time
    if shown:
        frames = np.stack([geometry.world_T_base @ kinematics.link_frames(m.measured) for m in shown])
        times = np.array([m.time for m in shown])
        for i, joint in enumerate(ARM_JOINTS):
            send_poses(recording, f"world/robot/{joint}", times, frames[:, i])
        send_poses(recording, "world/robot/hand", times, frames[:, -1])
        gap = np.nan_to_num(np.array([m.opening for m in shown]))
        for side, sign in (("left", 1.0), ("right", -1.0)):
            offset = np.zeros((len(shown), 3))
            offset[:, 1] = sign * (gap + geometry.finger_thickness) / 2
            offset[:, 2] = PALM[2] + length / 2
            send_poses(recording, f"world/robot/hand/{side}_finger", times, spatial.transform(None, offset))

    times = np.array([m.time for m in joints])
    for kind, colour in CURVES.items():
        arm = np.stack([m.measured if kind == "measured" else getattr(m, kind).arm for m in joints])
        for i, joint in enumerate(ARM_JOINTS):
            send_curve(recording, f"joints/{joint}/{kind}", times, arm[:, i], colour)
        opening = [m.opening if kind == "measured" else getattr(m, kind).opening for m in joints]
        send_curve(recording, f"gripper/{kind}", times, np.array(opening), colour)


def _capsule(end: np.ndarray, radius: float) -> rr.Capsules3D:
    """From the origin to `end`. Rerun's capsule lies along +z from its origin."""
    length = float(np.linalg.norm(end))
    axis = np.cross([0, 0, 1.0], end / length)
    turn = float(np.arccos(np.clip(end[2] / length, -1, 1)))
    axis = axis / np.linalg.norm(axis) if np.linalg.norm(axis) > 1e-9 else np.array([1.0, 0, 0])
    return rr.Capsules3D(
        lengths=[length], radii=[radius], colors=STEEL, fill_mode="solid",
        rotation_axis_angles=rr.RotationAxisAngle(axis=axis, radians=turn),
    )  # fmt: skip


def draw_cameras(episode: Episode, recording: rr.RecordingStream) -> None:
    _draw_standing_cameras(episode, recording)
    for name in episode.cameras:
        entity = f"world/cameras/{name}"
        for time, jpeg in episode.film(name):
            recording.set_time("time", duration=time)
            recording.log(f"{entity}/colour", _encoded(jpeg))
        for picture in episode.pictures(name):
            recording.set_time("time", duration=picture.time)
            recording.log(entity, pose_of(picture.world_T_cam))
            pinhole = rr.Pinhole(
                image_from_camera=picture.intrinsics, resolution=[picture.width, picture.height],
                camera_xyz=rr.ViewCoordinates.RDF, image_plane_distance=0.1,
            )  # fmt: skip
            recording.log(entity, pinhole)
            if picture.colour:
                recording.log(f"{entity}/colour", _encoded(picture.colour))
            depth = _decode(picture.depth)
            if depth is not None:
                meter = round(1.0 / CameraFrame.DEPTH_UNIT_M)
                recording.log(f"{entity}/depth", rr.DepthImage(depth, meter=meter))


def _draw_standing_cameras(episode: Episode, recording: rr.RecordingStream) -> None:
    """Those in the world, where the rig has them: of what is only filmed no picture says it."""
    recording.set_time("time", duration=0.0)
    for camera in episode.meta.rig.get("cameras", ()):
        if camera["mount"] != "world" or camera["name"] not in episode.cameras:
            continue
        entity = f"world/cameras/{camera['name']}"
        recording.log(entity, pose_of(np.array(camera["pose"])))
        pinhole = rr.Pinhole(
            focal_length=[camera["fx"], camera["fy"]], principal_point=[camera["cx"], camera["cy"]],
            resolution=[camera["width"], camera["height"]], camera_xyz=rr.ViewCoordinates.RDF, image_plane_distance=0.1,
        )  # fmt: skip
        recording.log(entity, pinhole)


def _encoded(picture: bytes) -> rr.EncodedImage:
    return rr.EncodedImage(contents=picture, media_type="image/png" if picture.startswith(b"\x89PNG") else "image/jpeg")


def _decode(png: bytes | None) -> np.ndarray | None:
    """(h, w) uint16, or None for what is no such picture."""
    if not png:
        return None
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED)
    return image if image is not None and image.dtype == np.uint16 and image.ndim == 2 else None


def draw_forces(episode: Episode, recording: rr.RecordingStream) -> None:
    forces = list(episode.tip_force())
    if not forces:
        return
    times, vectors = np.array([t for t, _ in forces]), np.stack([f for _, f in forces])
    for i, axis in enumerate("xyz"):
        send_curve(recording, f"tip_force/{axis}", times, vectors[:, i])
    send_curve(recording, "tip_force/size", times, np.linalg.norm(vectors, axis=1))
