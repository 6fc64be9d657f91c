"""Failures as data: who caused them, and the Gaussians of relative poses that new failures are drawn from.

Relative poses are kept in the box's own symmetric terms: the gaps between the block's footprint and the two nearest
walls, the smaller first, and the block's heading modulo a quarter turn as (cos 4a, sin 4a). So one corner stands for
all four, and boxes and blocks of any size for each other.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from resync_robot.core import spatial
from resync_robot.core.errors import TrainingError
from resync_robot.core.state import State
from resync_robot.core.symbols import Object

CONTACT_THRESHOLD_N = 20.0
"""Peak force on the hand above which an object counts as having caused a failure; a touch stays far below it."""


@dataclass(frozen=True)
class Failure:
    """One failed attempt of a given skill.

    Attributes:
        state: just before the attempt (x^F).
        skill, objects: the ground skill that failed (C^F).
        contacts: peak force in N between the hand and each object during the attempt.
    """

    state: State
    skill: str
    objects: tuple[Object, ...]
    contacts: Mapping[Object, float]


@dataclass(frozen=True)
class Culprit:
    """What the failures have in common: C^F, o^F and the position of o^R among the skill's arguments."""

    skill: str
    failure_object: Object
    relevant_argument: int


def find_culprit(failures: Sequence[Failure], ignored: frozenset[Object]) -> Culprit:
    """The failed skill and the object that hindered it, by contact force.

    Args:
        ignored: objects that no one can be hindered by, such as the robot.

    Raises:
        TrainingError: nothing was touched hard enough in any failure.
    """
    blamed: Counter[tuple[str, Object]] = Counter()
    for failure in failures:
        for obj, force in failure.contacts.items():
            # A skill touches what it handles; only what it did not mean to touch can hinder it.
            if force > CONTACT_THRESHOLD_N and obj not in ignored and obj not in failure.objects:
                blamed[failure.skill, obj] += 1
    if not blamed:
        raise TrainingError(
            f"none of {len(failures)} failures has a contact above {CONTACT_THRESHOLD_N:.0f} N to explain it",
            "train on a scenario whose failure comes from a collision",
        )
    (skill, obj), _ = blamed.most_common(1)[0]
    example = next(f for f in failures if f.skill == skill and obj in f.contacts)
    distance = [
        float(np.linalg.norm(example.state[o][:2] - example.state[obj][:2])) if o not in ignored else np.inf
        for o in example.objects
    ]
    return Culprit(skill, obj, int(np.argmin(distance)))


@dataclass(frozen=True)
class PairGaussian:
    """A Gaussian over relative poses (small gap m, large gap m, cos 4a, sin 4a)."""

    mean: Float[np.ndarray, "4"]
    covariance: Float[np.ndarray, "4 4"]

    def sample(self, rng: np.random.Generator) -> tuple[float, float, float]:
        """(small gap, large gap, heading in [-pi/4, pi/4)); the pair (cos, sin) is brought back to the circle."""
        small, large, c, s = rng.multivariate_normal(self.mean, self.covariance, method="cholesky")
        return float(min(small, large)), float(max(small, large)), float(np.arctan2(s, c) / 4)

    def to_json(self) -> dict[str, Any]:
        return {"mean": self.mean.tolist(), "covariance": self.covariance.tolist()}

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> PairGaussian:
        """The inverse of `to_json`. Raises ValueError or KeyError where the data is no Gaussian of four numbers."""
        mean, covariance = (np.asarray(data[name], dtype=float) for name in ("mean", "covariance"))
        if mean.shape != (4,) or covariance.shape != (4, 4):
            raise ValueError(f"a Gaussian has 4 and 4 x 4 numbers, not {mean.shape} and {covariance.shape}")
        if not (np.isfinite(mean).all() and np.isfinite(covariance).all()):
            raise ValueError("a Gaussian has numbers that are none")
        # It raises where nothing can be drawn.
        np.linalg.cholesky(covariance)
        return PairGaussian(mean, covariance)

    @staticmethod
    def fit(relative: Sequence[np.ndarray]) -> PairGaussian:
        """From (n, 4) relative poses. Raises TrainingError for fewer than three."""
        if len(relative) < 3:
            raise TrainingError(f"a Gaussian needs three relative poses, got {len(relative)}")
        samples = np.asarray(relative)
        # The floor keeps a direction in which all samples agree (sin 4a, say) from being drawn with no spread.
        floor = np.diag([5e-4, 5e-4, 1e-2, 1e-2]) ** 2
        return PairGaussian(samples.mean(0), np.cov(samples.T) + floor)


def relative_pose(state: State, block: Object, box: Object) -> Float[np.ndarray, "4"]:
    """The block's pose relative to the box in the box's symmetric terms."""
    box_T_block = spatial.inverse(spatial.pose_from_features(state[box][:7])) @ spatial.pose_from_features(
        state[block][:7]
    )
    yaw = float(np.arctan2(box_T_block[1, 0], box_T_block[0, 0]))
    size = state.get(block, "size_x")[0]
    half = size / 2 * (abs(np.cos(yaw)) + abs(np.sin(yaw)))
    gaps = state.get(box, "inner_x", "inner_y") / 2 - np.abs(box_T_block[:2, 3]) - half
    # Mirroring into the corner (+, +) turns the heading's sense over; so does swapping the axes.
    flips = np.sign(box_T_block[0, 3]) * np.sign(box_T_block[1, 3]) * (1 if gaps[0] <= gaps[1] else -1)
    return np.array([gaps.min(), gaps.max(), np.cos(4 * yaw), np.sin(4 * yaw) * (flips or 1.0)])


def place_relative(
    box: Float[np.ndarray, "11"],
    size: Float[np.ndarray, "3"],
    relative: tuple[float, float, float],
    rng: np.random.Generator,
) -> tuple[float, float, float]:
    """(x, y, yaw) in the box's frame with those gaps and heading, in a corner and along axes drawn at random."""
    small, large, angle = relative
    swap, corner = bool(rng.integers(2)), rng.choice([-1.0, 1.0], 2)
    yaw = angle * corner[0] * corner[1] * (-1 if swap else 1) + rng.integers(4) * np.pi / 2
    half = size[0] / 2 * (abs(np.cos(yaw)) + abs(np.sin(yaw)))
    gaps = np.array([large, small] if swap else [small, large])
    x, y = corner * (box[7:9] / 2 - half - gaps)
    return float(x), float(y), float(yaw)
