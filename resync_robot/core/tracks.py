"""Where things were between the moments at which they were recorded: what moved, moved with the hand."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from resync_robot.core import spatial
from resync_robot.core.state import State
from resync_robot.core.symbols import SE3, Object

SAME, SAME_TURN = 1e-3, 0.01
"""m and rad within which a thing did not move."""
REACH = 0.15
"""m from a thing within which the tip of the hand is that carries or pushes it."""
SAMPLES = 80
"""Of the hand between two moments, among which it is tried when it took the thing and let it go."""
RELUCTANCE = 0.02
"""m of error that is as bad as 1 m of way in the hand: a thing rests where nothing is won by moving it."""


@dataclass(frozen=True)
class _Ride:
    """From `begin` to `end` the thing moves with the hand; what that misses is made up for on the way."""

    begin: float
    end: float
    hand_T_thing: np.ndarray
    shift: np.ndarray
    turn: np.ndarray


class Tracks:
    """
    Args:
        states: what was recorded, by time in s.
        times: (n,) s, rising; `tips` (n, 4, 4) world_T_tip then.
    """

    def __init__(
        self, states: Sequence[tuple[float, State]], times: Float[np.ndarray, "n"], tips: Float[np.ndarray, "n 4 4"]
    ) -> None:
        self._states, self._times, self._tips = list(states), times, tips
        self._at = [time for time, _ in self._states]
        self._rides: dict[tuple[int, Object], _Ride | None] = {}

    def at(self, time: float) -> dict[Object, np.ndarray]:
        """Features of everything that was known by then; nothing before the first recorded moment."""
        i = bisect_right(self._at, time) - 1
        if i < 0:
            return {}
        state = self._states[i][1]
        return {o: self._features(i, o, time) for o in state if len(state[o]) >= 7}

    @cached_property
    def _path(self) -> Float[np.ndarray, "n"]:
        """m that the tip has gone by then."""
        steps = np.linalg.norm(np.diff(self._tips[:, :3, 3], axis=0), axis=1)
        return np.concatenate([[0.0], np.cumsum(steps)])

    def _features(self, i: int, obj: Object, time: float) -> np.ndarray:
        features = self._states[i][1][obj]
        if i + 1 == len(self._states) or obj not in self._states[i + 1][1]:
            return features
        if (i, obj) not in self._rides:
            self._rides[i, obj] = self._ride(i, obj)
        ride = self._rides[i, obj]
        if ride is None or time <= ride.begin:
            return features
        after = self._states[i + 1][1][obj]
        if time >= ride.end:
            return np.concatenate([after[:7], features[7:]])
        share = (time - ride.begin) / (ride.end - ride.begin)
        pose = self._tip(time) @ ride.hand_T_thing
        turned = spatial.rotation_from_vector(share * ride.turn) @ pose[:3, :3]
        moved = spatial.transform(turned, pose[:3, 3] + share * ride.shift)
        return np.concatenate([spatial.features_from_pose(moved), features[7:]])

    def _ride(self, i: int, obj: Object) -> _Ride | None:
        """How the thing came from one recorded pose to the next; None where it stayed, or nobody saw how it went."""
        if obj.type.pose != SE3:
            return None
        (t0, before), (t1, after) = self._states[i], self._states[i + 1]
        first, last = (spatial.pose_from_features(state[obj][:7]) for state in (before, after))
        turn = spatial.rotation_vector(last[:3, :3] @ first[:3, :3].T)
        if np.linalg.norm(last[:3, 3] - first[:3, 3]) < SAME and np.linalg.norm(turn) < SAME_TURN:
            return None
        inside = np.flatnonzero((self._times >= t0) & (self._times <= t1))
        if len(inside) < 2:
            return None
        some = inside[np.linspace(0, len(inside) - 1, min(SAMPLES, len(inside))).astype(int)]
        tips, path = self._tips[some], self._path[some]
        # Where the thing would be at the end, had the hand held it from the a-th moment to the b-th.
        held = np.linalg.inv(tips) @ np.append(first[:3, 3], 1.0)
        ends = np.einsum("bij,aj->abi", tips[:, :3], held)
        cost = np.linalg.norm(ends - last[:3, 3], axis=-1) + RELUCTANCE * (path[None] - path[:, None])
        cost[np.tril_indices(len(some))] = np.inf
        cost[np.linalg.norm(tips[:, :3, 3] - first[:3, 3], axis=-1) > REACH] = np.inf
        a, b = np.unravel_index(int(cost.argmin()), cost.shape)
        if not np.isfinite(cost[a, b]):
            return None
        hand_T_thing = spatial.inverse(tips[a]) @ first
        carried = tips[b] @ hand_T_thing
        turn = spatial.rotation_vector(last[:3, :3] @ carried[:3, :3].T)
        return _Ride(self._times[some[a]], self._times[some[b]], hand_T_thing, last[:3, 3] - carried[:3, 3], turn)

    def _tip(self, time: float) -> np.ndarray:
        """Between two recorded moments the tip goes straight; it hardly turns there."""
        i = int(np.clip(np.searchsorted(self._times, time), 1, len(self._times) - 1))
        t0, t1 = self._times[i - 1], self._times[i]
        share = np.clip((time - t0) / max(t1 - t0, 1e-9), 0.0, 1.0)
        pose = self._tips[i if share > 0.5 else i - 1].copy()
        pose[:3, 3] = self._tips[i - 1][:3, 3] * (1 - share) + self._tips[i][:3, 3] * share
        return pose
