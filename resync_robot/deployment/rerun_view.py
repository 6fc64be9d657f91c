"""An episode drawn for Rerun: robot, cameras, points, objects believed and true, atoms, plan, joints, events.

The only file that knows Rerun. Everything is on one timeline, `time`, in seconds of the episode.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from resync_robot.core import spatial
from resync_robot.core.episode import Episode, EventKind
from resync_robot.core.errors import EpisodeError
from resync_robot.core.files import unwritable, write_bytes
from resync_robot.core.joints import ARM_JOINTS
from resync_robot.core.kinematics import ALPHA
from resync_robot.core.plan_progress import PlanProgress, Standing, plan_progress
from resync_robot.core.recorded_rig import RecordedRig
from resync_robot.core.robot_description import PALM
from resync_robot.core.solids import boxes
from resync_robot.core.state import State
from resync_robot.core.vocabulary import BLOCK, BOX
from resync_robot.core.world import CameraFrame

POSE_HZ = 25.0
"""How often the robot is drawn; more makes the file larger, not the picture better."""
SIGMAS = 2.0
"""Half axes of the uncertainty ellipsoids, in standard deviations."""
LINK_RADII = (0.06, 0.055, 0.05, 0.045, 0.045, 0.04)

STEEL, DARK, DOUBT, BACKGROUND = (150, 165, 180), (60, 65, 70), (220, 60, 160, 90), (24, 27, 32)
CURVES = {"requested": (120, 120, 120), "sent": (240, 150, 40), "measured": (80, 170, 240)}
_LEVELS = {
    EventKind.GIVE_UP: "ERROR", EventKind.STOP: "ERROR", EventKind.MAY_MOVE: "ERROR", EventKind.REPLAN: "WARN"
}  # fmt: skip


@dataclass(frozen=True)
class _Look:
    """Of the edges of an object: colour, half width in m, and whether its name stands beside it."""

    colour: tuple[int, int, int]
    line: float
    labelled: bool


BELIEF, TRUTH = _Look((240, 150, 40), 0.0012, True), _Look((60, 180, 90), 0.0006, False)


def save_drawing(episode: Episode, path: Path) -> None:
    """Write the drawing as an .rrd file, whole or not at all.

    Raises:
        EpisodeError: the file cannot be written, or a message of the episode makes no sense.
        DiskError: there is no room for it.
    """
    try:
        _save("resync-robot", _blueprint(episode), lambda recording: draw(episode, recording), path)
    except OSError as error:
        raise unwritable(path, error, "give another file with --save", EpisodeError) from None


def _save(name: str, blueprint: rrb.Blueprint, draw: Callable[[rr.RecordingStream], None], path: Path) -> None:
    """Rerun draws into memory, for its own writer keeps quiet about a full disk, and takes a name for UTF-8 where the
    system has another encoding. Raises OSError."""
    recording = rr.RecordingStream(name)
    stream = recording.binary_stream()
    recording.send_blueprint(blueprint, make_active=False, make_default=True)
    try:
        draw(recording)
    finally:
        # What is left in there, Rerun complains about.
        data = stream.read()
        recording.disconnect()
    write_bytes(path, data or b"")


def draw(episode: Episode, recording: rr.RecordingStream) -> None:
    """Log the whole episode."""
    recording.send_recording_name(f"{episode.meta.domain} {episode.meta.scenario}: {episode.meta.goal}")
    recording.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    _draw_about(episode, recording)
    _draw_robot(episode, recording)
    _draw_cameras(episode, recording)
    for cloud in episode.points():
        recording.set_time("time", duration=cloud.time)
        recording.log("world/points", rr.Points3D(cloud.xyz, colors=cloud.rgb, radii=0.0015))
    _draw_states(episode.states(), recording, "world/belief", BELIEF)
    _draw_states(episode.truths(), recording, "world/truth", TRUTH)
    _draw_atoms(episode, recording)
    for moment in plan_progress(episode):
        recording.set_time("time", duration=moment.time)
        recording.log("plan", rr.TextDocument(_plan_text(moment), media_type=rr.MediaType.MARKDOWN))
    for event in episode.events():
        recording.set_time("time", duration=event.time)
        text = ": ".join(part for part in dict.fromkeys((event.kind.value, event.text)) if part)
        recording.log("events", rr.TextLog(text, level=_LEVELS.get(event.kind, "INFO")))
    _draw_forces(episode, recording)


def save_pictures(pictures: Mapping[str, np.ndarray], path: Path) -> None:
    """Write (h, w, 3) RGB pictures by name as an .rrd file, side by side. Raises ConfigError or DiskError."""
    views = [rrb.Spatial2DView(origin=name, name=name) for name in pictures]

    def draw(recording: rr.RecordingStream) -> None:
        for name, picture in pictures.items():
            recording.log(name, rr.Image(picture).compress(jpeg_quality=95), static=True)

    try:
        _save("resync-robot-calibration", rrb.Blueprint(rrb.Vertical(*views), auto_views=False), draw, path)
    except OSError as error:
        raise unwritable(path, error, "give another folder with --out") from None


def _draw_about(episode: Episode, recording: rr.RecordingStream) -> None:
    meta = episode.meta
    rows = {
        "domain": meta.domain, "scenario": meta.scenario, "goal": meta.goal, "seed": meta.seed,
        "backend": meta.backend, "rig": meta.rig_hash, "library": meta.library_hash,
        "began": meta.began, "length": f"{episode.duration:.1f} s", "damage": episode.loss or "none",
        **meta.versions,
    }  # fmt: skip
    text = "\n".join(["| | |", "|---|---|", *(f"| {name} | {value} |" for name, value in rows.items())])
    recording.log("about", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)


def _draw_robot(episode: Episode, recording: rr.RecordingStream) -> None:
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
            _send_poses(recording, f"world/robot/{joint}", times, frames[:, i])
        _send_poses(recording, "world/robot/hand", times, frames[:, -1])
        gap = np.nan_to_num(np.array([m.opening for m in shown]))
        for side, sign in (("left", 1.0), ("right", -1.0)):
            offset = np.zeros((len(shown), 3))
            offset[:, 1] = sign * (gap + geometry.finger_thickness) / 2
            offset[:, 2] = PALM[2] + length / 2
            _send_poses(recording, f"world/robot/hand/{side}_finger", times, spatial.transform(None, offset))

    times = np.array([m.time for m in joints])
    for kind, colour in CURVES.items():
        arm = np.stack([m.measured if kind == "measured" else getattr(m, kind).arm for m in joints])
        for i, joint in enumerate(ARM_JOINTS):
            _send_curve(recording, f"joints/{joint}/{kind}", times, arm[:, i], colour)
        opening = [m.opening if kind == "measured" else getattr(m, kind).opening for m in joints]
        _send_curve(recording, f"gripper/{kind}", times, np.array(opening), colour)


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


def _draw_cameras(episode: Episode, recording: rr.RecordingStream) -> None:
    _draw_standing_cameras(episode, recording)
    for name in episode.cameras:
        entity = f"world/cameras/{name}"
        for time, jpeg in episode.film(name):
            recording.set_time("time", duration=time)
            recording.log(f"{entity}/colour", _encoded(jpeg))
        for picture in episode.pictures(name):
            recording.set_time("time", duration=picture.time)
            recording.log(entity, _pose(picture.world_T_cam))
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
        recording.log(entity, _pose(np.array(camera["pose"])))
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


def _draw_states(states: Iterator[tuple[float, State]], recording: rr.RecordingStream, root: str, look: _Look) -> None:
    before: set[str] = set()
    for time, state in states:
        recording.set_time("time", duration=time)
        now = {o.name for o in state if o.type in (BLOCK, BOX)}
        for name in before - now:
            recording.log(f"{root}/{name}", rr.Clear(recursive=True))
            recording.log(f"{root}_uncertainty/{name}", rr.Clear(recursive=True))
        before = now
        for obj in state:
            if obj.name not in now:
                continue
            entity = f"{root}/{obj.name}"
            features = state[obj]
            recording.log(entity, _pose(spatial.pose_from_features(features[:7])))
            centers, half_sizes = boxes(obj, features)
            body = rr.Boxes3D(
                centers=centers, half_sizes=half_sizes, colors=look.colour, radii=look.line,
                labels=[obj.name], show_labels=look.labelled and obj.type == BLOCK,
            )  # fmt: skip
            recording.log(f"{entity}/body", body)
            covariance = state.covariance(obj)
            if covariance is not None:
                recording.log(f"{root}_uncertainty/{obj.name}", _ellipsoid(features[:3], covariance[:3, :3]))


def _ellipsoid(center: np.ndarray, covariance: np.ndarray) -> rr.Ellipsoids3D:
    variances, axes = np.linalg.eigh((covariance + covariance.T) / 2)
    axes = axes * np.sign(np.linalg.det(axes))
    half = SIGMAS * np.sqrt(np.clip(variances, 1e-10, None))
    quaternion = rr.Quaternion(xyzw=np.roll(spatial.quat_from_matrix(axes), -1))
    return rr.Ellipsoids3D(centers=[center], half_sizes=[half], quaternions=[quaternion], colors=DOUBT)


def _draw_atoms(episode: Episode, recording: rr.RecordingStream) -> None:
    for time, atoms in episode.atoms():
        recording.set_time("time", duration=time)
        for atom, probability in atoms.items():
            recording.log(["atoms", atom], rr.Scalars(probability))
        rows = sorted(atoms.items(), key=lambda item: (item[1] < 0.5, item[0]))
        lines = [f"| {'**' + a + '**' if p >= 0.5 else a} | {p:.3f} |" for a, p in rows]
        text = "\n".join(["| atom | probability |", "|---|---|", *lines])
        recording.log("atoms_now", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))


_STANDINGS = {
    Standing.DONE: "~~{}~~ done",
    Standing.FAILED: "~~{}~~ **failed**",
    Standing.UNDER_WAY: "**{}** ◀ under way",
    Standing.NEXT: "{} ◁ next",
    Standing.LATER: "{}",
}


def _plan_text(moment: PlanProgress) -> str:
    steps = [f"{i}. {_STANDINGS[standing].format(step)}" for i, (step, standing) in enumerate(moment.steps, 1)]
    reason = [f"*plan: {moment.reason}*", ""] if moment.reason else []
    return "\n".join([f"**{moment.doing}**", "", *reason, *steps])


def _draw_forces(episode: Episode, recording: rr.RecordingStream) -> None:
    forces = list(episode.tip_force())
    if not forces:
        return
    times, vectors = np.array([t for t, _ in forces]), np.stack([f for _, f in forces])
    for i, axis in enumerate("xyz"):
        _send_curve(recording, f"tip_force/{axis}", times, vectors[:, i])
    _send_curve(recording, "tip_force/size", times, np.linalg.norm(vectors, axis=1))


def _pose(pose: np.ndarray) -> rr.Transform3D:
    return rr.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3])


def _send_poses(recording: rr.RecordingStream, entity: str, times: np.ndarray, poses: np.ndarray) -> None:
    xyzw = np.roll(spatial.quat_from_matrix(poses[:, :3, :3]), -1, axis=-1)
    columns = rr.Transform3D.columns(translation=poses[:, :3, 3], quaternion=xyzw)
    recording.send_columns(entity, [rr.TimeColumn("time", duration=times)], columns)


def _send_curve(
    recording: rr.RecordingStream,
    entity: str,
    times: np.ndarray,
    values: np.ndarray,
    colour: tuple[int, int, int] | None = None,
) -> None:
    if colour is not None:
        recording.log(entity, rr.SeriesLines(colors=colour), static=True)
    recording.send_columns(entity, [rr.TimeColumn("time", duration=times)], rr.Scalars.columns(scalars=values))


def _blueprint(episode: Episode) -> rrb.Blueprint:
    """3D left; cameras above and the tabs below on the right."""
    cameras = [
        rrb.Spatial2DView(origin=f"world/cameras/{name}", contents="$origin/colour", name=name)
        for name in episode.cameras
    ]
    joints = [rrb.TimeSeriesView(origin=f"joints/{j}", name=j.removesuffix("_joint")) for j in ARM_JOINTS]
    tabs = rrb.Tabs(
        rrb.Vertical(
            rrb.TextDocumentView(origin="plan", name="Plan"), rrb.TextLogView(origin="events", name="Events"),
            name="Plan and events",
        ),
        rrb.Horizontal(
            rrb.TextDocumentView(origin="atoms_now", name="Atoms now"),
            rrb.TimeSeriesView(origin="atoms", name="Atoms over time", axis_y=rrb.ScalarAxis(range=(-0.05, 1.05))),
            name="Atoms",
        ),
        rrb.Grid(*joints, name="Joints"),
        rrb.Vertical(
            rrb.TimeSeriesView(origin="gripper", name="Opening, m"),
            rrb.TimeSeriesView(origin="tip_force", name="Force on the hand, N"),
            name="Hand",
        ),
        rrb.TextDocumentView(origin="about", name="About"),
        active_tab=0,
    )  # fmt: skip
    # Depth pictures would be drawn as points a second time.
    hidden = [f"- /world/cameras/{name}/depth/**" for name in episode.cameras]
    scene = rrb.Spatial3DView(origin="world", contents=["$origin/**", *hidden], name="Scene", background=BACKGROUND)
    right: Iterable[rrb.Container | rrb.View] = [rrb.Horizontal(*cameras), tabs] if cameras else [tabs]
    return rrb.Blueprint(
        rrb.Horizontal(scene, rrb.Vertical(*right, row_shares=[2, 3] if cameras else [1]), column_shares=[3, 2]),
        rrb.TimePanel(timeline="time", state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
    )
