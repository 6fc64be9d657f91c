"""Which block the pads hold: told from where blocks are believed and from how far the pads are open, not from sight."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from resync_robot.core import spatial
from resync_robot.core.symbols import Object
from resync_robot.perception.known import Known
from resync_robot.perception.pose import upright_covariance, yaw_variance_of

GRIP_SLACK = 0.008
"""m by which the opening may differ from a block's width while the pads hold it."""
AT_TIP = (0.030, 0.020, 0.040)
"""How far a block's centre may lie from the tips, along x, y and z of the tool, when the pads close on it, m."""
BENEATH = 0.045
"""Horizontal distance from a block within which another one counts as under it, m."""


class Grasp:
    """What rides with the tips.

    A block that the pads have closed on does; the jaws centre it and turn it flush, so its place between them is known
    better than before. Every method changes the estimates `known` that it is given, of `blocks` and nothing else.
    """

    def __init__(self, blocks: Sequence[Object]) -> None:
        self._blocks = tuple(blocks)
        self._tip_T_held = np.eye(4)
        self._tip_T_block: dict[Object, np.ndarray] = {}
        self._last_opening = np.inf
        self.held: Object | None = None

    @property
    def is_certain(self) -> bool:
        """Was the held block alone between the pads? Of two stacked ones either may have come along, or both."""
        return self.held is None or not self._stacked_with(self.held)

    def follow(self, known: dict[Object, Known], robot_features: Float[np.ndarray, "8"]) -> None:
        """Take the held block along, and notice when the pads close on one and when they let go."""
        opening = float(robot_features[7])
        world_T_tip = spatial.pose_from_features(robot_features[:7])
        if self.held is not None:
            width = known[self.held].features[7:9].max()
            if abs(opening - width) > GRIP_SLACK + 0.004:
                self.release()
            else:
                self._ride(known, world_T_tip)
        elif opening <= self._last_opening + 1e-4:
            block = self._between_pads(known, world_T_tip, opening)
            if block is not None:
                self.attach(known, block, robot_features)
        self._last_opening = opening

    def attach(self, known: dict[Object, Known], block: Object, robot_features: Float[np.ndarray, "8"]) -> None:
        """The pads hold `block`, which is known."""
        world_T_tip = spatial.pose_from_features(robot_features[:7])
        tip_T_world = spatial.inverse(world_T_tip)
        self._tip_T_block = {
            b: tip_T_world @ spatial.pose_from_features(known[b].features[:7]) for b in self._blocks if b in known
        }
        self._hold(known, block, world_T_tip)

    def release(self) -> None:
        """The pads hold nothing any more; the block is believed where they left it."""
        self.held = None

    def correct(
        self, known: dict[Object, Known], seen: Collection[Object], robot_features: Float[np.ndarray, "8"]
    ) -> None:
        """What the hand was believed to hold lies on the table: it lifted the block stacked with that, or nothing.

        Args:
            seen: the blocks that are not in the hand.
        """
        dropped = self.held
        self.release()
        if dropped is None:
            return
        opening = float(robot_features[7])
        for block in self._stacked_with(dropped):
            if block not in seen and abs(opening - known[block].features[7:9].max()) < GRIP_SLACK:
                self._hold(known, block, spatial.pose_from_features(robot_features[:7]))
                return

    def _hold(self, known: dict[Object, Known], block: Object, world_T_tip: np.ndarray) -> None:
        tip_T_block = self._tip_T_block[block].copy()
        # The jaws push the block to their middle and turn its faces flush with the pads.
        tip_T_block[1, 3] = 0.0
        yaw = float(np.arctan2(tip_T_block[1, 0], tip_T_block[0, 0]))
        askew = float(spatial.wrap(yaw, np.pi / 2))
        if abs(askew) < np.radians(20):
            tip_T_block[:3, :3] = spatial.rotation_about("z", -askew) @ tip_T_block[:3, :3]
        self.held, self._tip_T_held = block, tip_T_block
        self._ride(known, world_T_tip)

    def _stacked_with(self, held: Object) -> list[Object]:
        """The blocks that stood on or under `held` when the pads closed, nearest to the tips first."""
        place = self._tip_T_block.get(held)
        if place is None:
            return []
        near = [
            (abs(other[2, 3]), block)
            for block, other in self._tip_T_block.items()
            if block != held and np.hypot(*(other[:2, 3] - place[:2, 3])) < BENEATH
        ]
        return [block for _, block in sorted(near)]

    def _between_pads(self, known: dict[Object, Known], world_T_tip: np.ndarray, opening: float) -> Object | None:
        """The block at the tips; of two stacked ones the nearer."""
        tip_T_world = spatial.inverse(world_T_tip)
        found: list[tuple[float, Object]] = []
        for block in self._blocks:
            if block not in known:
                continue
            features = known[block].features
            place = np.abs(tip_T_world[:3, :3] @ features[:3] + tip_T_world[:3, 3])
            if abs(opening - features[7:9].max()) < GRIP_SLACK and np.all(place < AT_TIP):
                found.append((float(place[2]), block))
        return min(found)[1] if found else None

    def _ride(self, known: dict[Object, Known], world_T_tip: np.ndarray) -> None:
        if self.held is None:
            return
        before = known[self.held]
        pose = spatial.features_from_pose(world_T_tip @ self._tip_T_held)
        covariance = before.covariance.copy()
        covariance[:7, :7] = upright_covariance(np.diag(covariance)[:3], yaw_variance_of(covariance), pose[3:7])
        known[self.held] = replace(before, features=np.concatenate([pose, before.features[7:]]), covariance=covariance)
