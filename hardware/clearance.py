"""How much room the arm has: from itself, from the table, from what stands on it. Capsules around links and hand.

A capsule is all that lies within its radius of a segment. The segments follow the manufacturer's drawings: the upper
arm runs beside the plane of the shoulder, not in it. Radii are a little larger than the real parts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from resync_robot.core.kinematics import TWIST
from resync_robot.core.machines import ArmModel
from resync_robot.core.rig import Rig

BASE, SHOULDER, UPPER_ARM, ELBOW, FOREARM, WRIST_1, WRIST_2, WRIST_3, HAND, CAMERA = range(10)
NAMES = (
    "base", "shoulder", "upper arm", "elbow", "forearm", "wrist 1", "wrist 2", "wrist 3", "hand",
    "camera on the flange",
)  # fmt: skip
HAND_RADIUS = 0.075
"""m; the 2F-140 with its fingers closed, and nearly as wide where they are open; the 2F-85 is no wider."""

_CA, _SA = np.array(TWIST).T
# Neighbours touch by construction, and so do parts that one joint alone keeps apart.
PAIRS = (
    *((BASE, part) for part in (FOREARM, WRIST_1, WRIST_2, WRIST_3, HAND, CAMERA)),
    *((SHOULDER, part) for part in (FOREARM, WRIST_1, WRIST_2, WRIST_3, HAND, CAMERA)),
    *((UPPER_ARM, part) for part in (WRIST_1, WRIST_2, WRIST_3, HAND, CAMERA)),
    *((ELBOW, part) for part in (WRIST_2, WRIST_3, HAND, CAMERA)),
    *((FOREARM, part) for part in (WRIST_3, HAND, CAMERA)),
    (WRIST_1, HAND),
)
ABOVE_TABLE = (UPPER_ARM, ELBOW, FOREARM, WRIST_1, WRIST_2, WRIST_3, CAMERA)
"""What must not touch the table; the tip may, a little, and has a limit of its own."""


@dataclass(frozen=True)
class Obstacle:
    """A box-shaped thing that only the hand may reach into.

    Attributes:
        world_T_middle: (4, 4) pose of its middle; half: (3,) m, half its size along its own axes.
    """

    name: str
    world_T_middle: Float[np.ndarray, "4 4"]
    half: Float[np.ndarray, "3"]


@dataclass(frozen=True)
class Gap:
    """Attributes: `distance` in m between two parts, negative where they overlap, and their names."""

    distance: float
    one: str
    other: str


class Clearance:
    """Distances between the parts of one rig's arm, and from them to the table and to obstacles.

    Args:
        rig: mounting of the arm, hand and camera on the flange.
        table_z: height of the table in the world, m.
    """

    def __init__(self, rig: Rig, table_z: float = 0.0) -> None:
        self._world_T_base, self._table_z = rig.arm.world_T_base, table_z
        self._a, self._link = np.array(rig.arm.kinematics.a), np.zeros((6, 4, 4))
        # What of a link's transform does not depend on its joint.
        self._link[:, 2, 1], self._link[:, 2, 2], self._link[:, 3, 3] = _SA, _CA, 1.0
        self._link[:, 2, 3] = rig.arm.kinematics.d
        reach = rig.gripper.tip_offset - HAND_RADIUS
        mounted = [c.pose[:3, 3] for c in rig.cameras if c.mount == "flange"]
        camera = mounted[0] if mounted else np.zeros(3)
        links = link_segments(rig.arm.facts) | {
            HAND: (6, (0, 0, min(0.03, reach)), (0, 0, reach), HAND_RADIUS),
            CAMERA: (6, (0, 0, float(camera[2])), tuple(camera), 0.03),
        }
        self._frame = np.array([links[i][0] for i in range(len(NAMES))])
        ends = np.array([[(*links[i][1], 1.0), (*links[i][2], 1.0)] for i in range(len(NAMES))])
        self._ends = ends.swapaxes(1, 2)
        self._radius = np.array([links[i][3] for i in range(len(NAMES))])
        self._obstacles: tuple[Obstacle, ...] = ()
        self._pairs = np.array(PAIRS)
        self._above, self._still = np.array(ABOVE_TABLE), len(NAMES)
        self._reference: tuple[np.ndarray, np.ndarray] | None = None
        self._movers = self._find_movers()

    @property
    def obstacles(self) -> tuple[Obstacle, ...]:
        return self._obstacles

    @obstacles.setter
    def obstacles(self, obstacles: tuple[Obstacle, ...]) -> None:
        self._obstacles, self._reference = obstacles, None
        self._movers = self._find_movers()

    def frames(self, q: Float[np.ndarray, "n 6"]) -> Float[np.ndarray, "n 7 4 4"]:
        """Poses in the world of the base and of the six DH frames, the last of which is the flange's."""
        cos, sin = np.cos(q), np.sin(q)
        links = np.empty((len(q), 6, 4, 4))
        links[:], a = self._link, self._a
        links[..., 0, 0], links[..., 0, 1], links[..., 0, 2], links[..., 0, 3] = cos, sin * -_CA, sin * _SA, a * cos
        links[..., 1, 0], links[..., 1, 1], links[..., 1, 2], links[..., 1, 3] = sin, cos * _CA, cos * -_SA, a * sin
        frames = np.empty((len(q), 7, 4, 4))
        frames[:, 0] = self._world_T_base
        for i in range(6):
            np.matmul(frames[:, i], links[:, i], out=frames[:, i + 1])
        return frames

    def smallest(self, frames: Float[np.ndarray, "n 7 4 4"]) -> Gap:
        """The narrowest gap over all configurations, given by their `frames`."""
        gaps = self._gaps(self._segments(frames))
        row, column = np.unravel_index(int(gaps.argmin()), gaps.shape)
        return self._named(float(gaps[row, column]), int(column))

    def below(self, frames: Float[np.ndarray, "n 7 4 4"], margin: float) -> Gap | None:
        """The narrowest gap, where it is below `margin` m; None where all are wider.

        No point of a segment moves further than one of its ends, so as long as two parts have moved less than what
        they had to spare when their gap was last measured, it need not be measured again. Of an arm that is watched
        target by target, that is mostly so.
        """
        ends = self._segments(frames)
        if self._reference is not None:
            before, spare = self._reference
            moved = np.append(np.linalg.norm(ends - before, axis=-1).max(axis=(0, 2)), 0.0)
            if (moved[self._movers].sum(axis=1) <= spare - margin).all():
                return None
        gaps = self._gaps(ends)
        self._reference = ends[-1], gaps[-1]
        row, column = np.unravel_index(int(gaps.argmin()), gaps.shape)
        return self._named(float(gaps[row, column]), int(column)) if gaps[row, column] < margin else None

    def _segments(self, frames: np.ndarray) -> Float[np.ndarray, "n p 2 3"]:
        return (frames[:, self._frame, :3] @ self._ends).swapaxes(2, 3)

    def _find_movers(self) -> np.ndarray:
        """(m, 2) the parts that each gap lies between; beyond their number for what stands still."""
        standing = np.stack([self._above, np.full(len(self._above), self._still)], axis=1)
        return np.concatenate([self._pairs, *[standing] * (1 + len(self._obstacles))])

    def _named(self, distance: float, column: int) -> Gap:
        if column < len(self._pairs):
            one, other = self._pairs[column]
            return Gap(distance, NAMES[one], NAMES[other])
        standing, part = divmod(column - len(self._pairs), len(self._above))
        return Gap(distance, NAMES[self._above[part]], ["table", *(o.name for o in self._obstacles)][standing])

    def _gaps(self, ends: Float[np.ndarray, "n p 2 3"]) -> Float[np.ndarray, "n m"]:
        """Between the pairs, then above the table, then to one obstacle after the other."""
        one, other = self._pairs[:, 0], self._pairs[:, 1]
        between = _distance(ends[:, one], ends[:, other]) - (self._radius[one] + self._radius[other])
        ends, radius = ends[:, self._above], self._radius[self._above]
        height = ends[..., 2].min(axis=2) - radius - self._table_z
        return np.concatenate([between, height, *(_outside(ends, o) - radius for o in self._obstacles)], axis=1)


def link_segments(arm: ArmModel) -> dict[int, tuple[int, tuple[float, ...], tuple[float, ...], float]]:
    """Of each part of the arm: frame (0 the base, i the DH frame of joint i), both ends in it (m), radius (m)."""
    (d1, _, _, d4, d5, d6), (_, a2, a3, _, _, _) = arm.kinematics.d, arm.kinematics.a
    shoulder, elbow = arm.shape.shoulder, arm.shape.elbow
    ends = {
        BASE: (0, (0, 0, 0), (0, 0, d1)),
        SHOULDER: (1, (0, 0, 0), (0, 0, shoulder)),
        UPPER_ARM: (2, (-a2, 0, shoulder), (0, 0, shoulder)),
        ELBOW: (2, (0, 0, shoulder), (0, 0, elbow)),
        FOREARM: (3, (-a3, 0, elbow), (0, 0, elbow)),
        WRIST_1: (3, (0, 0, elbow), (0, 0, d4)),
        WRIST_2: (4, (0, 0, 0), (0, 0, d5)),
        WRIST_3: (5, (0, 0, 0), (0, 0, d6)),
    }
    return {part: (*end, radius) for (part, end), radius in zip(ends.items(), arm.shape.radii, strict=True)}


def _outside(ends: Float[np.ndarray, "n p 2 3"], obstacle: Obstacle) -> Float[np.ndarray, "n p"]:
    """How far segments lie outside a box-shaped thing, by nine of their points."""
    share = np.linspace(0.0, 1.0, 9)[:, None]
    points = ends[:, :, :1] * (1 - share) + ends[:, :, 1:] * share
    pose = obstacle.world_T_middle
    local = (points - pose[:3, 3]) @ pose[:3, :3]
    return np.linalg.norm(np.maximum(np.abs(local) - obstacle.half, 0.0), axis=-1).min(axis=2)


def _distance(one: Float[np.ndarray, "*b 2 3"], other: Float[np.ndarray, "*b 2 3"]) -> Float[np.ndarray, "*b"]:
    """Between pairs of segments of any length.

    The nearest points lie inside both segments, where the lines' own do, or else at an end of one of them.
    """
    u, v = one[..., 1, :] - one[..., 0, :], other[..., 1, :] - other[..., 0, :]
    w = one[..., 0, :] - other[..., 0, :]
    a, b, c = (u * u).sum(-1), (u * v).sum(-1), (v * v).sum(-1)
    d, e = (u * w).sum(-1), (v * w).sum(-1)
    crossing = a * c - b * b
    with np.errstate(divide="ignore", invalid="ignore"):
        s, t = (b * e - c * d) / crossing, (a * e - b * d) / crossing
    inside = (crossing > 1e-12) & (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)
    s, t = np.where(inside, s, 0.0)[..., None], np.where(inside, t, 0.0)[..., None]
    lines = np.where(inside, np.linalg.norm(w + s * u - t * v, axis=-1), np.inf)
    to_ends = [_to_segment(one[..., i, :], other) for i in (0, 1)] + [
        _to_segment(other[..., i, :], one) for i in (0, 1)
    ]
    return np.minimum.reduce([lines, *to_ends])


def _to_segment(point: Float[np.ndarray, "*b 3"], segment: Float[np.ndarray, "*b 2 3"]) -> Float[np.ndarray, "*b"]:
    along, to = segment[..., 1, :] - segment[..., 0, :], point - segment[..., 0, :]
    length = np.maximum((along * along).sum(-1), 1e-18)
    share = np.clip((to * along).sum(-1) / length, 0.0, 1.0)
    return np.linalg.norm(to - share[..., None] * along, axis=-1)
