"""What a classifier sees of one, two or more objects: features without the frame the scene happens to lie in.

How two objects lie beside each other is the business of `core.relations` and of the relations that a domain declares.
All functions take feature arrays as states store them (world frame, SI units, one row a sample) and are vectorised over
the samples.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from resync_robot.core.relations import DEFAULTS, Relations, Rows, alone, features
from resync_robot.core.state import State
from resync_robot.core.symbols import SE3, Object, Type

PERCEPTION_POSITION_M = 0.002
PERCEPTION_ANGLE = float(np.deg2rad(0.5))
"""Standard deviations of an estimated pose; training adds noise of this size."""


def gather(states: Sequence[State], groundings: Sequence[tuple[Object, ...]]) -> tuple[Rows, ...]:
    """Features of each argument: entry i holds, for each sample, those of the i-th object in its state."""
    arity = len(groundings[0]) if groundings else 0
    return tuple(np.stack([s[g[i]] for s, g in zip(states, groundings, strict=True)]) for i in range(arity))


def relative_features(types: Sequence[Type], rows: Sequence[Rows], relations: Relations = DEFAULTS) -> Rows:
    """(n, d) features of objects of these types; d depends on the types and relations alone.

    One object is seen as it stands in the world, two in relation to each other, more as their pairs.

    Args:
        relations: those that the domain declares.
    """
    types = tuple(types)
    if not types:
        return np.zeros((len(rows[0]) if rows else 0, 0))
    if len(types) == 1:
        return alone(types[0], rows[0])
    pairs = [(i, j) for i in range(len(types)) for j in range(i + 1, len(types))]
    return np.concatenate([features(types[i], rows[i], types[j], rows[j], relations) for i, j in pairs], -1)


def perturb(
    kind: Type,
    rows: Rows,
    rng: np.random.Generator,
    position_m: float = PERCEPTION_POSITION_M,
    angle: float = PERCEPTION_ANGLE,
) -> Rows:
    """The rows with the error of perception in their pose: `position_m` on each axis, `angle` (rad) of heading.

    A type without a pose has none to disturb, and one that is exact is not perceived: both stay.
    """
    if kind.exact or kind.pose is None:
        return rows
    noisy = rows.copy()
    noisy[:, : kind.dimensions] += rng.normal(0.0, position_m, (len(rows), kind.dimensions))
    turn = rng.normal(0.0, angle, len(rows))
    if kind.pose == SE3:
        # Left factor of the quaternion product: a turn about the world's z axis.
        c, s = np.cos(turn / 2), np.sin(turn / 2)
        w, x, y, z = rows[:, 3:7].T
        noisy[:, 3:7] = np.stack([c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w], -1)
    else:
        noisy[:, 2] += turn
    return noisy
