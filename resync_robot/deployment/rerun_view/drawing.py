"""An episode drawn for Rerun: robot, cameras, points, objects believed and true, atoms, plan, joints, events.

Everything is on one timeline, `time`, in seconds of the episode.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from resync_robot.core.episode import Episode
from resync_robot.core.episode_records import EventKind
from resync_robot.core.errors import EpisodeError
from resync_robot.core.files import unwritable, write_bytes
from resync_robot.core.plan_progress import PlanProgress, Standing, plan_progress
from resync_robot.deployment.rerun_view import plane, space
from resync_robot.deployment.rerun_view.arm import draw_cameras, draw_forces, draw_robot
from resync_robot.deployment.rerun_view.layout import blueprint
from resync_robot.deployment.rerun_view.model import draw_model

_LEVELS = {
    EventKind.GIVE_UP: "ERROR", EventKind.STOP: "ERROR", EventKind.MAY_MOVE: "ERROR", EventKind.REPLAN: "WARN"
}  # fmt: skip


def save_drawing(episode: Episode, path: Path) -> None:
    """Write the drawing as an .rrd file, whole or not at all.

    Raises:
        EpisodeError: the file cannot be written, or a message of the episode makes no sense.
        DiskError: there is no room for it.
    """
    try:
        _save("resync-robot", blueprint(episode), lambda recording: draw(episode, recording), path)
    except OSError as error:
        raise unwritable(path, error, "give another file with --save", EpisodeError) from None


def _save(name: str, layout: rrb.Blueprint, draw: Callable[[rr.RecordingStream], None], path: Path) -> None:
    """Rerun draws into memory, for its own writer keeps quiet about a full disk, and takes a name for UTF-8 where the
    system has another encoding. Raises OSError."""
    recording = rr.RecordingStream(name)
    stream = recording.binary_stream()
    recording.send_blueprint(layout, make_active=False, make_default=True)
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
    draw_model(episode, recording)
    if episode.meta.rig:
        draw_robot(episode, recording)
    draw_cameras(episode, recording)
    for cloud in episode.points():
        recording.set_time("time", duration=cloud.time)
        recording.log("world/points", rr.Points3D(cloud.xyz, colors=cloud.rgb, radii=0.0015))
    space.draw_states(episode.states(), recording, "world/belief", space.BELIEF)
    space.draw_states(episode.truths(), recording, "world/truth", space.TRUTH)
    plane.draw_scene(episode, recording)
    _draw_atoms(episode, recording)
    for moment in plan_progress(episode):
        recording.set_time("time", duration=moment.time)
        recording.log("plan", rr.TextDocument(_plan_text(moment), media_type=rr.MediaType.MARKDOWN))
    for event in episode.events():
        recording.set_time("time", duration=event.time)
        text = ": ".join(part for part in dict.fromkeys((event.kind.value, event.text)) if part)
        recording.log("events", rr.TextLog(text, level=_LEVELS.get(event.kind, "INFO")))
    draw_forces(episode, recording)


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
        "backend": meta.backend, "rig": meta.rig_hash or "none: the robot is the domain's own",
        "library": meta.library_hash,
        "began": meta.began, "length": f"{episode.duration:.1f} s", "damage": episode.loss or "none",
        **meta.versions,
    }  # fmt: skip
    text = "\n".join(["| | |", "|---|---|", *(f"| {name} | {value} |" for name, value in rows.items())])
    recording.log("about", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)


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
