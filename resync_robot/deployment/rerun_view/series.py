"""Poses and numbers over the time of an episode, as Rerun takes them."""

from __future__ import annotations

import numpy as np
import rerun as rr

from resync_robot.core import spatial


def pose_of(pose: np.ndarray) -> rr.Transform3D:
    return rr.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3])


def send_poses(recording: rr.RecordingStream, entity: str, times: np.ndarray, poses: np.ndarray) -> None:
    xyzw = np.roll(spatial.quat_from_matrix(poses[:, :3, :3]), -1, axis=-1)
    columns = rr.Transform3D.columns(translation=poses[:, :3, 3], quaternion=xyzw)
    recording.send_columns(entity, [rr.TimeColumn("time", duration=times)], columns)


def send_curve(
    recording: rr.RecordingStream,
    entity: str,
    times: np.ndarray,
    values: np.ndarray,
    colour: tuple[int, int, int] | None = None,
) -> None:
    if colour is not None:
        recording.log(entity, rr.SeriesLines(colors=colour), static=True)
    recording.send_columns(entity, [rr.TimeColumn("time", duration=times)], rr.Scalars.columns(scalars=values))
