"""Relations: how one object lies beside another with their symmetries folded away (`see`), and the way back (`place`).

One implementation serves classifiers, the Gaussians of failures, policies and layouts. The default knows no domain: it
sees the pose of one object in the frame of the other, from the pose, extents and symmetry that their types declare. A
domain overrides it for pairs of types that have more in common, such as a mirror image. Rows are feature vectors as
states store them: world frame, SI units, one row an object.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float

from resync_robot.core import spatial
from resync_robot.core.errors import PlanningError
from resync_robot.core.state import State
from resync_robot.core.symbols import ROUND, SE3, Object, Type

Row = Float[np.ndarray, " f"]
Rows = Float[np.ndarray, "n f"]

LENGTH, DIRECTION = 5e-4, 1e-2
"""The resolution of a length, m, and of a sine or cosine."""


@dataclass(frozen=True, kw_only=True)
class Relation:
    """How an object a lies beside an object b.

    Attributes:
        names: of the columns that `see` gives.
        resolution: of each of these columns, a difference too small to mean anything.
        see: (rows of a, rows of b) -> (n, k) columns, equal where the two lie in the same way.
        place: (row of a, row of b, (k,) columns, random numbers) -> the row of a, moved so that it is seen like that.
            Where symmetry leaves a choice it is drawn. Of numbers that nothing is seen as, the nearest that is counts:
            a sine and a cosine need not lie on the circle.
        features: (rows of a, rows of b) -> (n, d) what classifiers and policies are given. Where a domain does not say:
            what is seen and, of both, the features that are no pose.
    """

    names: tuple[str, ...]
    resolution: tuple[float, ...]
    see: Callable[[Rows, Rows], Rows]
    place: Callable[[Row, Row, Row, np.random.Generator], Row]
    features: Callable[[Rows, Rows], Rows] | None = None


Relations = Mapping[tuple[Type, Type], Relation]
"""The relations that a domain declares. One for (a, b) also tells how b lies beside a."""
DEFAULTS: Relations = {}
"""Nothing is declared."""


def between(a: Type, b: Type, declared: Relations = DEFAULTS) -> Relation:
    """The relation of objects of type a to objects of type b.

    By default (x, y, z) is the position of a in the frame of b, its bearing times the symmetry of b; (up_x, up_y, up_z)
    the z axis of a; (cos, sin) are of the heading of a times its own symmetry.

    Raises:
        PlanningError: one type has its pose in the plane, the other in space.
    """
    if (a, b) in declared:
        return declared[a, b]
    if (b, a) in declared:
        return _turned_round(a, b, declared[b, a])
    if a.pose is None or b.pose is None:
        return Relation(names=(), resolution=(), see=lambda x, _: np.zeros((len(x), 0)), place=partial(_nowhere, a, b))
    if a.pose != b.pose:
        raise PlanningError(
            f"a {a.name} has its pose in {a.dimensions} dimensions and a {b.name} in {b.dimensions}",
            "declare the same pose, SE2 or SE3, for all types of a domain that have one",
        )
    axes, up = ("x", "y", "z")[: a.dimensions], ("up_x", "up_y", "up_z") if a.dimensions == 3 else ()
    return Relation(
        names=(*axes, *up, "cos", "sin"),
        resolution=(*(LENGTH for _ in axes), *(DIRECTION for _ in up), DIRECTION, DIRECTION),
        see=partial(_see, a, b),
        place=partial(_place, a, b),
        features=partial(_features, a, b),
    )


def features(a: Type, a_rows: Rows, b: Type, b_rows: Rows, declared: Relations = DEFAULTS) -> Rows:
    """(n, d) all that classifiers and policies are given of pairs of objects; d depends on the types alone."""
    relation = between(a, b, declared)
    if relation.features is not None:
        return relation.features(a_rows, b_rows)
    if not relation.names:
        return np.concatenate([alone(a, a_rows), alone(b, b_rows)], -1)
    return np.concatenate([relation.see(a_rows, b_rows), _rest(a, a_rows), _rest(b, b_rows)], -1)


def alone(kind: Type, rows: Rows) -> Rows:
    """(n, d) what is seen of single objects: their place in the world, their heading, and what else they have."""
    if kind.pose is None:
        return rows
    if kind.pose == SE3:
        heading, upright = spatial.yaw_of(rows[:, 3:7]), spatial.matrix_from_quat(rows[:, 3:7])[:, 2, 2:]
    else:
        heading, upright = rows[:, 2], np.zeros((len(rows), 0))
    turned = _on_circle(kind.symmetry * heading)
    return np.concatenate([rows[:, : kind.dimensions], turned, upright, _rest(kind, rows)], -1)


def seen(state: State, a: Object, b: Object, declared: Relations = DEFAULTS) -> Float[np.ndarray, " k"]:
    """How a lies beside b in a state."""
    return between(a.type, b.type, declared).see(state[a][None], state[b][None])[0]


def moved(
    state: State, a: Object, b: Object, relative: Row, rng: np.random.Generator, declared: Relations = DEFAULTS
) -> State:
    """The state with a beside b as `relative` says, and all else as it was. The inverse of `seen`."""
    row = between(a.type, b.type, declared).place(state[a], state[b], relative, rng)
    return state.with_features(a, **dict(zip(a.type.features, row.tolist(), strict=True)))


def blank(kind: Type) -> Rows:
    """One row that every function here accepts: zeros, and no turn."""
    row = np.zeros((1, len(kind.features)))
    if kind.pose == SE3:
        row[0, 3] = 1.0
    return row


# -- the default ------------------------------------------------------------------------------------------------------


def _see(a: Type, b: Type, a_rows: Rows, b_rows: Rows) -> Rows:
    position, rotation = _beside(a, b, a_rows, b_rows)
    bearing, heading = np.arctan2(position[:, 1], position[:, 0]), _heading(a, rotation)
    # An angle times the order of its symmetry: those that look the same meet, and nothing jumps where they do.
    planar = np.hypot(position[:, 0], position[:, 1])[:, None] * _on_circle(b.symmetry * bearing)
    up = rotation[:, :, 2] if a.pose == SE3 else np.zeros((len(a_rows), 0))
    if a.pose == SE3 and b.symmetry != 1:
        up = np.einsum("nij,nj->ni", _turn(-bearing, 3), up)
    if not _shared(a, b):
        heading = heading - bearing
    return np.concatenate([planar, position[:, 2:], up, _on_circle(a.symmetry * heading)], -1)


def _features(a: Type, b: Type, a_rows: Rows, b_rows: Rows) -> Rows:
    more = _common_heading(a, b, a_rows, b_rows), _gaps(a, b, a_rows, b_rows)
    return np.concatenate([_see(a, b, a_rows, b_rows), *more, _rest(a, a_rows), _rest(b, b_rows)], -1)


def _rest(kind: Type, rows: Rows) -> Rows:
    """(n, r) the features that are no pose."""
    return rows[:, len(kind.pose or ()) :]


def _place(a: Type, b: Type, row: Row, other: Row, relative: Row, rng: np.random.Generator) -> Row:
    d = a.dimensions
    bearing = 0.0 if b.symmetry == ROUND else float(np.arctan2(relative[1], relative[0])) / b.symmetry
    planar = np.hypot(relative[0], relative[1]) * np.array([np.cos(bearing), np.sin(bearing)])
    position = np.concatenate([planar, relative[2:d]])
    heading = _one_of(float(np.arctan2(relative[-1], relative[-2])), a.symmetry, rng)
    rotation = _turn(heading if _shared(a, b) else heading + bearing, d)
    if d == 3:
        up = relative[3:6] / np.linalg.norm(relative[3:6])
        up = up if b.symmetry == 1 else _turn(bearing, d) @ up
        rotation = _tilt(up[None])[0] @ rotation * ([1, -1, -1] if up[2] < 0 else 1)
    origin, axes = (one[0] for one in _frame(b, other[None]))
    axes = axes @ _turn(_one_of(0.0, b.symmetry, rng), d)
    return _posed(a, row, origin + axes @ position, axes @ rotation)


def _shared(a: Type, b: Type) -> bool:
    """Does every turn that b allows look the same on a? Then the heading of a is told in b's frame, else from the
    direction in which a lies."""
    return b.symmetry != ROUND and a.symmetry % b.symmetry == 0


def _common_heading(a: Type, b: Type, a_rows: Rows, b_rows: Rows) -> Rows:
    """(n, 2) heading of a against b as far as the turns of both leave it, where it is not shared; else (n, 0).

    It is part of what is seen, but that part is blurred where a lies over the middle of b, as a hand does that grasps.
    """
    if _shared(a, b) or ROUND in (a.symmetry, b.symmetry):
        return np.zeros((len(a_rows), 0))
    _, rotation = _beside(a, b, a_rows, b_rows)
    return _on_circle(math.lcm(a.symmetry, b.symmetry) * _heading(a, rotation))


def _heading(a: Type, rotation: np.ndarray) -> np.ndarray:
    """(n,) where the x axis points once the tilt is undone."""
    level = np.swapaxes(_tilt(rotation[:, :, 2]), -1, -2) @ rotation if a.pose == SE3 else rotation
    return np.arctan2(level[:, 1, 0], level[:, 0, 0])


def _beside(a: Type, b: Type, a_rows: Rows, b_rows: Rows) -> tuple[np.ndarray, np.ndarray]:
    """Position (n, d) and rotation (n, d, d) of a in the frame of b."""
    (at, turned), (origin, axes) = _frame(a, a_rows), _frame(b, b_rows)
    world_to_b = np.swapaxes(axes, -1, -2)
    return np.einsum("nij,nj->ni", world_to_b, at - origin), world_to_b @ turned


def _gaps(a: Type, b: Type, a_rows: Rows, b_rows: Rows) -> Rows:
    """(n, d) free distance in m between the bodies along each axis of b, negative where they overlap along it; of a
    square the larger one first, of what is round the one towards a. (n, 0) where one of them has no body."""
    if not (a.extents and b.extents):
        return np.zeros((len(a_rows), 0))
    position, rotation = _beside(a, b, a_rows, b_rows)
    if b.symmetry == ROUND:
        towards_a = _turn(-np.arctan2(position[:, 1], position[:, 0]), a.dimensions)
        position, rotation = np.einsum("nij,nj->ni", towards_a, position), towards_a @ rotation
    half, other = _half_extents(a, a_rows)[:, None], _half_extents(b, b_rows)
    if a.symmetry == ROUND:
        across = np.hypot(rotation[..., 0], rotation[..., 1]) * half[..., 0]
    else:
        across = (np.abs(rotation[..., :2]) * half[..., :2]).sum(-1)
    gaps = np.abs(position) - other - across - (np.abs(rotation[..., 2:]) * half[..., 2:]).sum(-1)
    if b.symmetry == 4:
        gaps[:, :2] = -np.sort(-gaps[:, :2], axis=1)
    return gaps


def _half_extents(kind: Type, rows: Rows) -> Rows:
    return rows[:, [kind.features.index(name) for name in kind.extents]] / 2


def _frame(kind: Type, rows: Rows) -> tuple[np.ndarray, np.ndarray]:
    """Position (n, d) and rotation (n, d, d) in the world."""
    if kind.pose == SE3:
        return rows[:, :3], spatial.matrix_from_quat(rows[:, 3:7])
    return rows[:, :2], _turn(rows[:, 2], 2)


def _posed(kind: Type, row: Row, position: np.ndarray, rotation: np.ndarray) -> Row:
    """The row with another pose."""
    if kind.pose == SE3:
        return np.concatenate([position, spatial.quat_from_matrix(rotation), row[7:]])
    return np.concatenate([position, [np.arctan2(rotation[1, 0], rotation[0, 0])], row[3:]])


def _on_circle(angle: np.ndarray) -> np.ndarray:
    """(n, 2) cosine and sine."""
    return np.stack([np.cos(angle), np.sin(angle)], -1)


def _turn(angle: float | np.ndarray, dimensions: int) -> np.ndarray:
    """(..., d, d) rotation by `angle` in the plane, or about z."""
    return spatial.rotation_about("z", angle)[..., :dimensions, :dimensions]


def _one_of(multiple: float, symmetry: int, rng: np.random.Generator) -> float:
    """One of the headings that look the same, of which `multiple` is the angle times the symmetry."""
    if symmetry == ROUND:
        return float(rng.uniform(-np.pi, np.pi))
    return (multiple + 2 * np.pi * int(rng.integers(symmetry))) / symmetry


def _tilt(up: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 3"]:
    """The least rotation that brings the vertical to that z axis, pointing up or, where the axis does, down."""
    sign = np.where(up[:, 2] < 0, -1.0, 1.0)
    x, y, z = (sign[:, None] * up).T
    share = 1 / (1 + z)
    rows = [[1 - share * x * x, -share * x * y, x], [-share * x * y, 1 - share * y * y, y], [-x, -y, z]]
    return np.moveaxis(np.array(rows), -1, 0)


def _nowhere(a: Type, b: Type, row: Row, other: Row, relative: Row, rng: np.random.Generator) -> Row:
    without = a if a.pose is None else b
    raise PlanningError(
        f"a {a.name} cannot be placed beside a {b.name}: a {without.name} has no place",
        f"declare the pose of the type '{without.name}', SE2 or SE3",
    )


def _turned_round(a: Type, b: Type, declared: Relation) -> Relation:
    """How a lies beside b, from the relation of b to a."""

    def place(row: Row, other: Row, relative: Row, rng: np.random.Generator) -> Row:
        wanted = declared.place(other, row, relative, rng)
        # b is where it belongs beside a; then both are moved, so that b is where it was.
        (there, turned), (here, axes), (at, rotation) = (
            (p[0], r[0]) for p, r in (_frame(b, wanted[None]), _frame(b, other[None]), _frame(a, row[None]))
        )
        back = axes @ turned.T
        return _posed(a, row, here + back @ (at - there), back @ rotation)

    given = declared.features
    return Relation(
        names=declared.names,
        resolution=declared.resolution,
        see=lambda x, y: declared.see(y, x),
        place=place,
        features=None if given is None else lambda x, y: given(y, x),
    )
