"""Things in a plane, seen from above or from the side, as they are believed to be and as they are.

Rerun's 2D views count y downwards, so that it is drawn with its sign changed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import rerun as rr
from jaxtyping import Float

from resync_robot.core.episode import Episode
from resync_robot.core.solids import outline
from resync_robot.core.state import State
from resync_robot.core.symbols import ROUND, SE2, Object

FLIP = np.array([1.0, -1.0])
PALETTE = (
    (78, 121, 199), (214, 83, 82), (89, 161, 79), (176, 122, 61), (156, 117, 190), (118, 183, 178), (237, 201, 72),
    (160, 165, 172),
)  # fmt: skip
"""Of types, in the order in which the domain has them."""
BELIEF = (240, 150, 40)
BELIEF_LINE, BODY_LINE = -0.5, -2.5
"""px by Rerun's convention: half widths of lines."""
MARGIN = 0.05
"""Around everything, as a share of its size."""
POINT = -6.0
"""px likewise: what has a place and no size."""

Body = rr.Points2D | rr.LineStrips2D


def draw_scene(episode: Episode, recording: rr.RecordingStream) -> None:
    """Bodies, in the colours of their types and with their names, as they are; orange lines where they are believed to
    be. Where nobody knows the truth, the lines have the names."""
    colours = {name: PALETTE[i % len(PALETTE)] for i, name in enumerate(episode.types)}
    known = bool(next(iter(episode.truths()), None))
    draw_states(episode.truths(), recording, "plane/truth", lambda obj, x: _body(obj, x, colours[obj.type.name]))
    draw_states(episode.states(), recording, "plane/belief", lambda obj, x: _line(obj, x, named=not known))


def draw_states(
    states: Iterator[tuple[float, State]],
    recording: rr.RecordingStream,
    root: str,
    look: Callable[[Object, np.ndarray], Body],
) -> None:
    """Log what has a pose in the plane, each time that it moved."""
    drawn: dict[str, bytes] = {}
    for time, state in states:
        recording.set_time("time", duration=time)
        shown = {o.name: o for o in state if o.type.pose == SE2}
        for name in drawn.keys() - shown.keys():
            recording.log(f"{root}/{name}", rr.Clear(recursive=True))
            del drawn[name]
        for name, obj in shown.items():
            features = state[obj].tobytes()
            if drawn.get(name) != features:
                drawn[name] = features
                recording.log(f"{root}/{name}", look(obj, state[obj]))


def _body(obj: Object, features: np.ndarray, colour: tuple[int, int, int]) -> Body:
    """A disc of what is round, an outline of what is not, and a point of what has no size."""
    if obj.type.extents and obj.type.symmetry != ROUND:
        return rr.LineStrips2D([_closed(obj, features)], radii=BODY_LINE, colors=colour, labels=obj.name)
    size = float(features[obj.type.features.index(obj.type.extents[0])]) if obj.type.extents else 0.0
    radius = size / 2 if obj.type.extents else POINT
    # What is small lies on what is large.
    return rr.Points2D([features[:2] * FLIP], radii=radius, colors=colour, labels=obj.name, draw_order=-size)


def _line(obj: Object, features: np.ndarray, named: bool) -> Body:
    label = obj.name if named else None
    if not obj.type.extents:
        return rr.Points2D([features[:2] * FLIP], radii=POINT / 2, colors=BELIEF, labels=label)
    return rr.LineStrips2D([_closed(obj, features)], radii=BELIEF_LINE, colors=BELIEF, labels=label)


def _closed(obj: Object, features: np.ndarray) -> np.ndarray:
    corners = outline(obj, features) * FLIP
    return np.concatenate([corners, corners[:1]])


def bounds(episode: Episode) -> Float[np.ndarray, "2 2"] | None:
    """Least and greatest x and y, m, y downwards, between which everything is at any time; None where nothing is."""
    corners = [
        outline(obj, state[obj]) * FLIP
        for states in (episode.states(), episode.truths())
        for _, state in states
        for obj in state
        if obj.type.pose == SE2
    ]
    if not corners:
        return None
    points = np.concatenate(corners)
    low, high = points.min(0), points.max(0)
    margin = MARGIN * max(float((high - low).max()), 0.1)
    return np.stack([low - margin, high + margin])
