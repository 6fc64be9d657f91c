"""What the pads hold: told from where things are believed and from how far the pads are open, not from sight."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np
from jaxtyping import Float

from resync_robot.core import spatial
from resync_robot.core.fittings import Lid
from resync_robot.core.symbols import Object
from resync_robot.perception.known import Known, moved_to

GRIP_SLACK = 0.008
"""m by which the opening may differ from a block's width while the pads hold it."""
AT_TIP = (0.030, 0.020, 0.040)
"""How far a block's centre may lie from the tips, along x, y and z of the tool, when the pads close on it, m."""
BENEATH = 0.045
"""Horizontal distance from a block within which another one counts as under it, m."""
SEATED = 0.012
"""m by which the height of a block over another one may differ from that of one that is seated there."""


class Grasp:
    """What rides with the tips.

    A block or the knob of a lid that the pads have closed on does, and the blocks that were seated on that block; the
    jaws centre what they close on and turn it flush, so its place between them is known better than before. Every
    method changes the estimates `known` that it is given, of blocks and lids and nothing else.

    Args:
        blocks: which there are.
        lids: how each of those that there are is built.
    """

    def __init__(self, blocks: Sequence[Object], lids: Mapping[Object, Lid] | None = None) -> None:
        self._blocks, self._lids = tuple(blocks), dict(lids or {})
        self._tip_T_held = np.eye(4)
        self._tip_T_rider: dict[Object, np.ndarray] = {}
        self._tip_T_block: dict[Object, np.ndarray] = {}
        self._closed_at = np.eye(4)
        self._last_opening = np.inf
        self.held: Object | None = None

    @property
    def riders(self) -> tuple[Object, ...]:
        """The blocks that were seated on the held one, from below up."""
        return tuple(self._tip_T_rider)

    @property
    def is_certain(self) -> bool:
        """Was the held block alone between the pads? Of two stacked ones either may have come along, or both."""
        return self.held is None or self.held in self._lids or not self._stacked_with(self.held)

    def follow(self, known: dict[Object, Known], robot_features: Float[np.ndarray, "8"]) -> None:
        """Take the held block along, and notice when the pads close on one and when they let go."""
        opening = float(robot_features[7])
        world_T_tip = spatial.pose_from_features(robot_features[:7])
        if self.held is not None:
            width, _ = self._grip(self.held, known[self.held].features)
            if abs(opening - width) > GRIP_SLACK + 0.004:
                self.release()
            else:
                self._ride(known, world_T_tip)
        elif opening <= self._last_opening + 1e-4:
            found = self._between_pads(known, world_T_tip, opening)
            if found is not None:
                self.attach(known, found, robot_features)
        self._last_opening = opening

    def attach(self, known: dict[Object, Known], held: Object, robot_features: Float[np.ndarray, "8"]) -> None:
        """The pads hold `held`, which is known."""
        world_T_tip = spatial.pose_from_features(robot_features[:7])
        tip_T_world = spatial.inverse(world_T_tip)
        self._closed_at = world_T_tip
        self._tip_T_block = {
            b: tip_T_world @ spatial.pose_from_features(known[b].features[:7])
            for b in (*self._blocks, *self._lids)
            if b in known
        }
        self._hold(known, held, world_T_tip)

    def release(self) -> None:
        """The pads hold nothing any more; what they held is believed where they left it."""
        self.held = None
        self._tip_T_rider = {}

    def left_behind(self, seen: Mapping[Object, np.ndarray]) -> list[Object]:
        """What the hand was believed to carry and does not: what stands elsewhere, and what that stands on.

        Whoever lifts a block lifts what is seated on it. What stands where it stood when the pads closed has not been
        lifted, nor what is beneath it.

        Args:
            seen: features of each block and lid that was seen where it stands.
        """
        if self.held is None:
            return []
        column = [self.held, *self.riders]
        stays = [i for i, obj in enumerate(column) if obj in seen and self._stays(obj, seen[obj])]
        return [obj for i, obj in enumerate(column) if obj in seen or i <= max(stays, default=-1)]

    def correct(self, known: dict[Object, Known], left: Collection[Object], robot_features: np.ndarray) -> None:
        """The hand does not carry `left`. Where the held one is among them, it lifted the block that was stacked with
        that, or nothing.

        Args:
            robot_features: (8,).
        """
        column = [self.held, *self.riders]
        if self.held in left:
            self._lift_another(known, left, robot_features)
        else:
            self._tip_T_rider = {b: pose for b, pose in self._tip_T_rider.items() if b not in left}
        for obj in column:
            if obj in self._tip_T_block and obj not in (self.held, *self.riders):
                known[obj] = moved_to(known[obj], self._closed_at @ self._tip_T_block[obj])

    def _lift_another(self, known: dict[Object, Known], left: Collection[Object], robot_features: np.ndarray) -> None:
        dropped = self.held
        self.release()
        if dropped is None:
            return
        opening = float(robot_features[7])
        for block in self._stacked_with(dropped):
            width, _ = self._grip(block, known[block].features)
            if block not in left and abs(opening - width) < GRIP_SLACK:
                self._hold(known, block, spatial.pose_from_features(robot_features[:7]))
                return

    def _stays(self, obj: Object, features: np.ndarray) -> bool:
        """Does it stand where it stood when the pads closed?"""
        if obj not in self._tip_T_block:
            return False
        before = (self._closed_at @ self._tip_T_block[obj])[:3, 3]
        return bool(np.abs(features[:3] - before).max() < SEATED)

    def _hold(self, known: dict[Object, Known], held: Object, world_T_tip: np.ndarray) -> None:
        tip_T_block = self._tip_T_block[held].copy()
        # The jaws push the block to their middle and turn its faces flush with the pads.
        tip_T_block[1, 3] = 0.0
        yaw = float(np.arctan2(tip_T_block[1, 0], tip_T_block[0, 0]))
        askew = float(spatial.wrap(yaw, np.pi / 2))
        if abs(askew) < np.radians(20):
            tip_T_block[:3, :3] = spatial.rotation_about("z", -askew) @ tip_T_block[:3, :3]
        moved = tip_T_block @ spatial.inverse(self._tip_T_block[held])
        self.held, self._tip_T_held = held, tip_T_block
        self._tip_T_rider = {b: moved @ self._tip_T_block[b] for b in self._seated_on(known, held)}
        self._ride(known, world_T_tip)

    def _seated_on(self, known: Mapping[Object, Known], held: Object) -> list[Object]:
        """The blocks on top of a held one, from below up."""
        if held not in self._blocks:
            return []
        found = [held]
        for block in sorted(self._stacked_with(held), key=lambda b: -float(self._tip_T_block[b][2, 3])):
            # The tool points down.
            gap = self._tip_T_block[found[-1]][2, 3] - self._tip_T_block[block][2, 3]
            seated = (known[block].features[9] + known[found[-1]].features[9]) / 2
            if abs(gap - seated) < SEATED:
                found.append(block)
        return found[1:]

    def _grip(self, obj: Object, features: np.ndarray) -> tuple[float, np.ndarray]:
        """How wide it is where the pads hold it, m, and (3,) where that is, in its own frame."""
        if obj in self._lids:
            knob = self._lids[obj].knob
            return max(knob[:2]), np.array([0.0, 0.0, (features[9] + knob[2]) / 2])
        return float(features[7:9].max()), np.zeros(3)

    def _stacked_with(self, held: Object) -> list[Object]:
        """The blocks that stood on or under `held` when the pads closed, nearest to the tips first."""
        place = self._tip_T_block.get(held)
        if place is None:
            return []
        near = [
            (abs(other[2, 3]), block)
            for block, other in self._tip_T_block.items()
            if block in self._blocks and block != held and np.hypot(*(other[:2, 3] - place[:2, 3])) < BENEATH
        ]
        return [block for _, block in sorted(near)]

    def _between_pads(self, known: dict[Object, Known], world_T_tip: np.ndarray, opening: float) -> Object | None:
        """The block or lid whose grip is at the tips; of two stacked blocks the nearer."""
        tip_T_world = spatial.inverse(world_T_tip)
        found: list[tuple[float, Object]] = []
        for obj in (*self._blocks, *self._lids):
            if obj not in known:
                continue
            width, grip = self._grip(obj, known[obj].features)
            place = np.abs((tip_T_world @ spatial.pose_from_features(known[obj].features[:7]) @ [*grip, 1.0])[:3])
            if abs(opening - width) < GRIP_SLACK and np.all(place < AT_TIP):
                found.append((float(place[2]), obj))
        return min(found)[1] if found else None

    def _ride(self, known: dict[Object, Known], world_T_tip: np.ndarray) -> None:
        if self.held is None:
            return
        for obj, tip_T_obj in ((self.held, self._tip_T_held), *self._tip_T_rider.items()):
            known[obj] = moved_to(known[obj], world_T_tip @ tip_T_obj)
