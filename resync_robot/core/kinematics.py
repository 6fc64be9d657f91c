"""Closed-form kinematics of the e-Series arms, batched, for numpy arrays and torch tensors alike.

The arms differ in lengths only: one Denavit-Hartenberg table with the same angles, and so one closed form.
Frames: `base` is the Denavit-Hartenberg base of the arm, `flange` its last frame. Angles in rad.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
from jaxtyping import Float

from resync_robot.core.errors import MotionError

ALPHA = (np.pi / 2, 0.0, 0.0, np.pi / 2, -np.pi / 2, 0.0)
TWIST = tuple((float(np.cos(a)), float(np.sin(a))) for a in ALPHA)
"""Cosine and sine of each angle between neighbouring joint axes."""

BRANCHES = tuple(product((+1, -1), (+1, -1), (+1, -1)))
"""(shoulder, wrist, elbow) signs of the eight solutions."""
WORK_BRANCH = (-1, -1, 1)
"""The branch of the home configuration: elbow up, tool down in front of the arm."""
LONGEST_STEP = 0.5
"""rad between two points of a path; a longer one is another configuration, not the next one."""
TURN = 2 * np.pi
ROUNDING = 1e-9
"""How far beyond 1 a sine may be for it to count as 1."""


@dataclass(frozen=True, kw_only=True)
class Kinematics:
    """One arm's lengths, and what follows from them.

    Attributes:
        d, a: (6,) m, of the manufacturer's table; d[1], d[2], a[0] and a[3:] are 0 in every arm of the series.
        limit: (6,) rad, how far each joint turns to either side. The elbow turns further, but into the upper arm.
    """

    d: tuple[float, ...]
    a: tuple[float, ...]
    limit: tuple[float, ...] = (TURN, TURN, TURN / 2, TURN, TURN, TURN)

    @cached_property
    def joint_limit(self) -> Float[np.ndarray, "6"]:
        """`limit` as an array."""
        array = np.array(self.limit)
        array.flags.writeable = False
        return array

    def forward(self, q: Any, xp: Any = np) -> Any:
        """(..., 6) joint positions -> (..., 4, 4) base_T_flange. `xp` is numpy or torch."""
        if xp is np and np.ndim(q) == 1:
            return self._forward_one(q)
        pose = None
        for i, (a, d) in enumerate(zip(self.a, self.d, strict=True)):
            c, s = xp.cos(q[..., i]), xp.sin(q[..., i])
            ca, sa = float(np.cos(ALPHA[i])), float(np.sin(ALPHA[i]))
            zero, one = c * 0, c * 0 + 1
            link = _matrix(
                [
                    [c, -s * ca, s * sa, a * c],
                    [s, c * ca, -c * sa, a * s],
                    [zero, zero + sa, zero + ca, zero + d],
                    [zero, zero, zero, one],
                ],
                xp,
            )
            pose = link if pose is None else pose @ link
        return pose

    def _forward_one(self, q: Float[np.ndarray, "6"]) -> Float[np.ndarray, "4 4"]:
        """`forward` of one configuration in plain floats: a tenth of the time, and control loops call it always."""
        (d1, _, _, d4, d5, d6), (_, a2, a3, _, _, _) = self.d, self.a
        (c1, s1), (c5, s5), (c6, s6) = ((math.cos(a), math.sin(a)) for a in (q[0], q[4], q[5]))
        q23, q234 = q[1] + q[2], q[1] + q[2] + q[3]
        c, s = math.cos(q234), math.sin(q234)
        # Columns of Rz(q234) Ry(-q5) Rz(q6) and the position, in the frame of joint 1.
        x = (c * c5 * c6 - s * s6, s * c5 * c6 + c * s6, s5 * c6)
        y = (-c * c5 * s6 - s * c6, -s * c5 * s6 + c * c6, -s5 * s6)
        z = (-c * s5, -s * s5, c5)
        p = (
            a2 * math.cos(q[1]) + a3 * math.cos(q23) + d5 * s + d6 * z[0],
            a2 * math.sin(q[1]) + a3 * math.sin(q23) - d5 * c + d6 * z[1],
            d4 + d6 * z[2],
        )
        # The frame of joint 1 in the base: its y is the base's z, its z is (s1, -c1, 0).
        columns = [(c1 * v[0] + s1 * v[2], s1 * v[0] - c1 * v[2], v[1]) for v in (x, y, z, p)]
        (xx, xy, xz), (yx, yy, yz), (zx, zy, zz), (px, py, pz) = columns
        return np.array([[xx, yx, zx, px], [xy, yy, zy, py], [xz, yz, zz, pz + d1], [0.0, 0.0, 0.0, 1.0]])

    def link_frames(self, q: Float[np.ndarray, "6"]) -> Float[np.ndarray, "6 4 4"]:
        """Pose of each of the six DH frames in the base, for geometry checks and drawings."""
        frames, pose = np.empty((6, 4, 4)), np.eye(4)
        cos, sin = np.cos(q).tolist(), np.sin(q).tolist()
        for i, (c, s, (ca, sa), a, d) in enumerate(zip(cos, sin, TWIST, self.a, self.d, strict=True)):
            link = np.array([[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1.0]])
            pose = np.matmul(pose, link, out=frames[i])
        return frames

    def joint_axes(self, q: Float[np.ndarray, "6"]) -> tuple[Float[np.ndarray, "6 3"], Float[np.ndarray, "6 3"]]:
        """Directions of the joints' axes in the base, and a point on each; in plain floats, as `_forward_one`."""
        (d1, _, _, d4, d5, _), (_, a2, a3, _, _, _) = self.d, self.a
        c1, s1, c5, s5 = math.cos(q[0]), math.sin(q[0]), math.cos(q[4]), math.sin(q[4])
        q23, q234 = q[1] + q[2], q[1] + q[2] + q[3]
        c, s = math.cos(q234), math.sin(q234)
        flat = s1, -c1, 0.0
        fifth, sixth = (c1 * s, s1 * s, -c), (s1 * c5 - c1 * c * s5, -s1 * c * s5 - c1 * c5, -s * s5)
        out, up = a2 * math.cos(q[1]), d1 + a2 * math.sin(q[1])
        elbow = c1 * out, s1 * out, up
        out, up = out + a3 * math.cos(q23), up + a3 * math.sin(q23)
        wrist = c1 * out, s1 * out, up
        last = wrist[0] + d4 * s1, wrist[1] - d4 * c1, wrist[2]
        hand = last[0] + d5 * fifth[0], last[1] + d5 * fifth[1], last[2] + d5 * fifth[2]
        points = np.array([(0.0, 0.0, 0.0), (0.0, 0.0, d1), elbow, wrist, last, hand])
        return np.array([(0.0, 0.0, 1.0), flat, flat, flat, fifth, sixth]), points

    def inverse_branch(self, base_T_flange: Any, branch: tuple[int, int, int], xp: Any = np) -> Any:
        """One of the eight solutions, (..., 6); NaN where that branch does not reach.

        Follows from R = Rz(q2+q3+q4) Ry(-q5) Rz(q6) in the frame of joint 1, and a two-link arm for q2, q3.
        """
        if isinstance(base_T_flange, np.ndarray) and base_T_flange.ndim == 2:
            return self._inverse_one(base_T_flange, branch)
        shoulder, wrist, elbow = branch
        (d1, _, _, d4, d5, d6), (_, a2, a3, _, _, _) = self.d, self.a
        r, p = base_T_flange[..., :3, :3], base_T_flange[..., :3, 3]
        w = p - d6 * r[..., :, 2]
        lean = xp.arcsin(_domain(d4 / xp.sqrt(w[..., 0] ** 2 + w[..., 1] ** 2), xp))
        heading = xp.arctan2(w[..., 1], w[..., 0])
        q1 = heading + lean if shoulder > 0 else heading + np.pi - lean
        c1, s1 = xp.cos(q1), xp.sin(q1)

        # Rows of the rotation seen from the frame of joint 1, whose z axis is (s1, -c1, 0).
        def z_row(column: Any) -> Any:
            return s1 * column[..., 0] - c1 * column[..., 1]

        def x_row(column: Any) -> Any:
            return c1 * column[..., 0] + s1 * column[..., 1]

        cos5 = _domain(z_row(r[..., :, 2]), xp)
        q5 = wrist * xp.arccos(cos5)
        sin5 = xp.sin(q5)
        # At sin5 = 0 the axes of joints 4 and 6 align: any q6 serves, and what is left over goes to q234.
        sign5 = xp.where(sin5 < 0, -xp.ones_like(sin5), xp.ones_like(sin5))
        q6 = xp.arctan2(-z_row(r[..., :, 1]) * sign5, z_row(r[..., :, 0]) * sign5)
        # The y axis before the turn by q6 stays in the plane of joints 2 to 4, where q234 alone turns it.
        y5 = xp.sin(q6)[..., None] * r[..., :, 0] + xp.cos(q6)[..., None] * r[..., :, 1]
        q234 = xp.arctan2(-x_row(y5), y5[..., 2])
        x = x_row(w) - d5 * xp.sin(q234)
        y = w[..., 2] - d1 + d5 * xp.cos(q234)
        q3 = elbow * xp.arccos(_domain((x * x + y * y - a2 * a2 - a3 * a3) / (2 * a2 * a3), xp))
        q2 = xp.arctan2(y, x) - xp.arctan2(a3 * xp.sin(q3), a2 + a3 * xp.cos(q3))
        q = xp.stack([q1, q2, q3, q234 - q2 - q3, q5, q6], -1)
        return (q + np.pi) % (2 * np.pi) - np.pi

    def _inverse_one(
        self, base_T_flange: Float[np.ndarray, "4 4"], branch: tuple[int, int, int]
    ) -> Float[np.ndarray, "6"]:
        """`inverse_branch` of one pose in plain floats: a tenth of the time, and control loops call it always."""
        shoulder, wrist, elbow = branch
        (d1, _, _, d4, d5, d6), (_, a2, a3, _, _, _) = self.d, self.a
        (xx, yx, zx, px), (xy, yy, zy, py), (xz, yz, zz, pz) = base_T_flange[:3].tolist()
        wx, wy, wz = px - d6 * zx, py - d6 * zy, pz - d6 * zz
        away = math.hypot(wx, wy)
        lean = _asin(d4 / away) if away > 0 else math.nan
        heading = math.atan2(wy, wx)
        q1 = heading + lean if shoulder > 0 else heading + math.pi - lean
        c1, s1 = math.cos(q1), math.sin(q1)
        q5 = wrist * _acos(s1 * zx - c1 * zy)
        sign5 = -1.0 if math.sin(q5) < 0 else 1.0
        q6 = math.atan2(-(s1 * yx - c1 * yy) * sign5, (s1 * xx - c1 * xy) * sign5)
        s6, c6 = math.sin(q6), math.cos(q6)
        y5x, y5y, y5z = s6 * xx + c6 * yx, s6 * xy + c6 * yy, s6 * xz + c6 * yz
        q234 = math.atan2(-(c1 * y5x + s1 * y5y), y5z)
        x = c1 * wx + s1 * wy - d5 * math.sin(q234)
        y = wz - d1 + d5 * math.cos(q234)
        q3 = elbow * _acos((x * x + y * y - a2 * a2 - a3 * a3) / (2 * a2 * a3))
        q2 = math.atan2(y, x) - math.atan2(a3 * math.sin(q3), a2 + a3 * math.cos(q3))
        q = np.array([q1, q2, q3, q234 - q2 - q3, q5, q6])
        return (q + np.pi) % (2 * np.pi) - np.pi

    def inverse(
        self,
        base_T_flange: Float[np.ndarray, "4 4"],
        seed: Float[np.ndarray, "6"],
        limit: Float[np.ndarray, "6"] | None = None,
    ) -> Float[np.ndarray, "6"]:
        """The solution nearest to `seed` within +-`limit` (default: 2 pi, elbow pi).

        Raises:
            MotionError: no branch reaches the pose within the limits.
        """
        limit = self.joint_limit if limit is None else limit
        best, best_cost = None, np.inf
        for branch in BRANCHES:
            with np.errstate(invalid="ignore"):
                q = self.inverse_branch(base_T_flange, branch)
            if not np.all(np.isfinite(q)):
                continue
            q = q + 2 * np.pi * np.round((seed - q) / (2 * np.pi))
            q = np.where(q > limit, q - 2 * np.pi, np.where(q < -limit, q + 2 * np.pi, q))
            cost = float(np.abs(q - seed).max())
            if cost < best_cost and np.all(np.abs(q) <= limit):
                best, best_cost = q, cost
        if best is None:
            x, y, z = base_T_flange[:3, 3]
            raise MotionError(
                f"no arm configuration puts the flange at ({x:.3f}, {y:.3f}, {z:.3f}) m of the arm's base"
            )
        return best

    def branch_of(self, q: Float[np.ndarray, "6"]) -> tuple[int, int, int]:
        """The branch that a configuration is on."""

        def away(branch: tuple[int, int, int]) -> float:
            with np.errstate(invalid="ignore"):
                difference = self.inverse_branch(self.forward(q), branch) - q
            worst = float(np.abs((difference + np.pi) % (2 * np.pi) - np.pi).max())
            return worst if np.isfinite(worst) else np.inf

        return min(BRANCHES, key=away)

    def inverse_along(
        self, base_T_flange: Float[np.ndarray, "4 4"], seed: Float[np.ndarray, "6"], branch: tuple[int, int, int]
    ) -> Float[np.ndarray, "6"]:
        """The next configuration of a path that stays on one branch, `seed` being the one before.

        Raises:
            MotionError: the branch does not reach there within the limits, or only by a jump.
        """
        with np.errstate(invalid="ignore"):
            q = self.inverse_branch(base_T_flange, branch)
        q = q + 2 * np.pi * np.round((seed - q) / (2 * np.pi))
        if not np.all(np.isfinite(q)) or np.abs(q - seed).max() > LONGEST_STEP or np.any(np.abs(q) > self.joint_limit):
            x, y, z = base_T_flange[:3, 3]
            raise MotionError(f"the path leaves the arm's reach at flange ({x:.3f}, {y:.3f}, {z:.3f}) m of its base")
        return q


def _asin(value: float) -> float:
    """NaN for what is outside of the domain by more than a rounding error."""
    return math.asin(max(-1.0, min(1.0, value))) if abs(value) <= 1.0 + ROUNDING else math.nan


def _acos(value: float) -> float:
    """The same."""
    return math.acos(max(-1.0, min(1.0, value))) if abs(value) <= 1.0 + ROUNDING else math.nan


def _domain(value: Any, xp: Any) -> Any:
    """Clip rounding errors of an arccos or arcsin argument; what is truly outside becomes NaN."""
    clipped = xp.clip(value, -1.0, 1.0)
    return xp.where(abs(value) > 1.0 + ROUNDING, value * float("nan"), clipped)


def _matrix(rows: list[list[Any]], xp: Any) -> Any:
    return xp.stack([xp.stack(row, -1) for row in rows], -2)
