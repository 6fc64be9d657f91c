"""What the robot believes about the scene between two scans: estimates, what it holds, what it no longer sees."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from perception.known import (
    LIFTED,
    Known,
    averaged_sizes,
    measured,
    not_a_point_of,
    out_of_sight,
    put_under,
    underside,
)
from perception.naming import AmbiguousObjectsError, MissingObjectsError, UnsettledSceneError, name_blocks
from perception.objects import SceneEstimate, SceneEstimator
from perception.pose import inside_box, upright_covariance, yaw_variance_of
from resync_robot.core import spatial
from resync_robot.core.errors import PerceptionError, UnknownNameError
from resync_robot.core.rig import Rig
from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.core.vocabulary import BLOCK, DRAWER, LID
from resync_robot.core.world import CameraFrame

GRIP_SLACK = 0.008
"""m by which the opening may differ from a block's width while the pads hold it."""
AT_TIP = (0.030, 0.020, 0.040)
"""How far a block's centre may lie from the tips, along x, y and z of the tool, when the pads close on it, m."""
BENEATH = 0.045
"""Horizontal distance from a block within which another one counts as under it, m."""


@dataclass(frozen=True)
class ScanReport:
    """What the last scan said about each block, by name. `tipped` blocks were seen, but do not stand upright;
    `ambiguous` ones were seen more than once, and keep their old estimates."""

    seen: tuple[str, ...] = ()
    hidden: tuple[str, ...] = ()
    held: tuple[str, ...] = ()
    tipped: tuple[str, ...] = ()
    ambiguous: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()


class Belief:
    """Keeps an estimated state of box, blocks, lids and drawers.

    A block that the pads have closed on rides with the tips; the jaws centre it and turn it flush, so its place
    between them is known better than before. Sizes are averaged over the scans; poses are those of the last one.

    Args:
        robot_object, box_object, block_objects: whose features to estimate; blocks by the catalogue's names.
        rig: whose hand and cameras.
        estimator: SceneEstimator(rig) by default.
        fittings: lids and drawers, by the catalogue's names.

    Raises:
        UnknownNameError: a block, a lid or a drawer that the catalogue does not have, or has no colour of.
    """

    def __init__(
        self,
        robot_object: Object,
        box_object: Object,
        block_objects: Sequence[Object],
        rig: Rig,
        estimator: SceneEstimator | None = None,
        fittings: Sequence[Object] = (),
    ) -> None:
        self._estimator = estimator or SceneEstimator(rig)
        self._robot, self._box, self._blocks = robot_object, box_object, tuple(block_objects)
        self._fittings = tuple(fittings)
        catalogue = self._estimator.catalogue
        names = {BLOCK: catalogue.blocks, LID: catalogue.coloured_lids, DRAWER: catalogue.coloured_drawers}
        for obj in (*self._blocks, *self._fittings):
            if obj.name not in names[obj.type]:
                raise UnknownNameError(f"{obj.type.name} of the catalogue", obj.name, names[obj.type])
        self._known: dict[Object, Known] = {}
        self._held: Object | None = None
        self._tip_T_held = np.eye(4)
        self._at_grasp: dict[Object, np.ndarray] = {}
        self._last_opening = np.inf
        self._ambiguous: Mapping[str, np.ndarray] = {}
        self._in_part: Mapping[str, np.ndarray] = {}
        self._before_scan = self._memory()
        self.report = ScanReport()

    @property
    def held(self) -> Object | None:
        """The block between the pads, as believed."""
        return self._held

    @property
    def grasp_is_certain(self) -> bool:
        """Was the held block alone between the pads? Of two stacked ones either may have come along, or both."""
        return self._held is None or not self._stacked_at_grasp(self._held)

    def update_from_scan(
        self, frames: Sequence[CameraFrame], robot_features: Float[np.ndarray, "8"], again: bool = False
    ) -> State:
        """Take in the pictures of a scan, taken with the hand as it is now.

        Args:
            again: these are all the pictures of the last scan and more, and take that one's place.

        Raises:
            UnsettledSceneError: a block was not found and is not plausibly hidden, or was seen more than once; it keeps
                its old estimate, with a wider covariance, and the next `state` works if there is one.
            PerceptionError: pictures that cannot be used, or no box; nothing is changed.
        """
        return self.update(self._estimator.estimate(frames), robot_features, again)

    def update(self, scene: SceneEstimate, robot_features: Float[np.ndarray, "8"], again: bool = False) -> State:
        """Take in an estimate of the scene. Raises UnsettledSceneError as `update_from_scan` does."""
        if again:
            known, self._held, self._tip_T_held, self._at_grasp = self._before_scan
            self._known = dict(known)
        else:
            self._before_scan = self._memory()
        self._follow_hand(robot_features)
        places = {b.name: k.features[:2] for b, k in self._known.items() if b in self._blocks}
        held = self._held.name if self._held else None
        scene, ambiguous = name_blocks(
            scene, self._estimator.catalogue.look_alikes, [b.name for b in self._blocks], held, places
        )
        box_sizes, scans = averaged_sizes(self._known.get(self._box), scene.box.features[7:])
        self._known[self._box] = Known(np.array([*scene.box.features[:7], *box_sizes]), scene.box.covariance, scans)
        seen = [b for b in self._blocks if b.name in scene.blocks]
        if self._held is not None and self._held in seen:
            self._change_grasp(seen, robot_features)
        for block in seen:
            self._known[block] = measured(self._known.get(block), scene.blocks[block.name])
        fitted = [o for o in self._fittings if o.name in scene.fittings]
        for obj in fitted:
            self._known[obj] = Known(scene.fittings[obj.name].features, scene.fittings[obj.name].covariance)
        ambiguous |= {o.name: scene.seen_twice[o.name] for o in self._fittings if o.name in scene.seen_twice}
        unseen = [b for b in self._blocks if b not in seen and b != self._held and b.name not in ambiguous]
        # From above down, as last believed: what hides under one block may hide another in its turn.
        unseen.sort(key=lambda b: -self._known[b].features[2] if b in self._known else 0.0)
        hidden: list[Object] = []
        for block in unseen:
            if self._hide(block, [*seen, *hidden], scene):
                hidden.append(block)
        lost = [o for o in self._fittings if o not in fitted and o.name not in ambiguous]
        missing = tuple(o.name for o in (*unseen, *lost) if o not in hidden)
        self.report = ScanReport(
            seen=tuple(o.name for o in (*seen, *fitted)),
            hidden=tuple(b.name for b in hidden),
            held=(self._held.name,) if self._held else (),
            tipped=tuple(b.name for b in seen if not scene.blocks[b.name].upright),
            ambiguous=tuple(ambiguous),
            missing=missing,
        )
        self._ambiguous = ambiguous
        self._in_part = {name: places for name, places in scene.seen_in_part.items() if name in missing}
        for obj in (*self._blocks, *self._fittings):
            if obj in self._known and obj.name in (*missing, *ambiguous):
                self._known[obj] = out_of_sight(self._known[obj], moves=obj.type == DRAWER)
        unsettled: list[UnsettledSceneError] = []
        if missing:
            unsettled.append(MissingObjectsError(missing, self.report.seen, scene.without_depth, scene.seen_in_part))
        if ambiguous:
            unsettled.append(AmbiguousObjectsError(ambiguous))
        if unsettled:
            raise unsettled[0] if len(unsettled) == 1 else UnsettledSceneError.of(unsettled)
        return self.state(robot_features)

    def unclear_places(self, most_sigma: float = 0.0012) -> list[Float[np.ndarray, "2"]]:
        """Where another look may help: what the last scan saw badly, in part or more than once, or did not find.

        Args:
            most_sigma: m, of x or y, up to which a thing that was seen is known well enough.
        """
        places: list[np.ndarray] = [
            place for seen in (*self._ambiguous.values(), *self._in_part.values()) for place in seen
        ]
        for obj in (*self._blocks, *self._fittings):
            known = self._known.get(obj)
            if known is None or obj == self._held:
                continue
            badly = obj.name in self.report.seen and np.diag(known.covariance)[:2].max() > most_sigma**2
            if badly or obj.name in self.report.missing:
                places.append(known.features[:2])
        return places

    def state(self, robot_features: Float[np.ndarray, "8"]) -> State:
        """The present belief: the robot as measured, the held block at the tips, the rest as last seen.

        Called at every control step, so that it notices when the pads close on a block and when they let go.

        Raises:
            PerceptionError: nothing was scanned yet.
        """
        if self._box not in self._known:
            raise PerceptionError("no scan was made yet, so nothing is known of the scene", "scan before asking")
        self._follow_hand(robot_features)
        features = {o: k.features for o, k in self._known.items()}
        covariance = {o: k.covariance for o, k in self._known.items()}
        return State({**features, self._robot: np.asarray(robot_features)}, covariance)

    def attach(self, block: Object, robot_features: Float[np.ndarray, "8"]) -> None:
        """The pads hold `block`: from now on it rides with the tips. Raises UnknownNameError if it was never seen."""
        if block not in self._known:
            raise UnknownNameError("block seen so far", block.name, [o.name for o in self._known if o in self._blocks])
        world_T_tip = spatial.pose_from_features(np.asarray(robot_features)[:7])
        tip_T_world = spatial.inverse(world_T_tip)
        self._at_grasp = {
            b: tip_T_world @ spatial.pose_from_features(self._known[b].features[:7])
            for b in self._blocks
            if b in self._known
        }
        self._hold(block, world_T_tip)

    def _hold(self, block: Object, world_T_tip: np.ndarray) -> None:
        tip_T_block = self._at_grasp[block].copy()
        # The jaws push the block to their middle and turn its faces flush with the pads.
        tip_T_block[1, 3] = 0.0
        yaw = float(np.arctan2(tip_T_block[1, 0], tip_T_block[0, 0]))
        askew = float(spatial.wrap(yaw, np.pi / 2))
        if abs(askew) < np.radians(20):
            tip_T_block[:3, :3] = spatial.rotation_about("z", -askew) @ tip_T_block[:3, :3]
        self._held, self._tip_T_held = block, tip_T_block
        self._ride(world_T_tip)

    def release(self) -> None:
        """The pads hold nothing any more; the block is believed where they left it."""
        self._held = None

    def _change_grasp(self, seen: Sequence[Object], robot_features: np.ndarray) -> None:
        """What the hand was believed to hold lies on the table: it lifted the block stacked with that, or nothing."""
        dropped = self._held
        self.release()
        if dropped is None:
            return
        for block in self._stacked_at_grasp(dropped):
            if (
                block not in seen
                and abs(float(robot_features[7]) - self._known[block].features[7:9].max()) < GRIP_SLACK
            ):
                self._hold(block, spatial.pose_from_features(np.asarray(robot_features)[:7]))
                return

    def _stacked_at_grasp(self, held: Object) -> list[Object]:
        """The blocks that stood on or under `held` when the pads closed, nearest to the tips first."""
        place = self._at_grasp.get(held)
        if place is None:
            return []
        near = [
            (abs(other[2, 3]), block)
            for block, other in self._at_grasp.items()
            if block != held and np.hypot(*(other[:2, 3] - place[:2, 3])) < BENEATH
        ]
        return [block for _, block in sorted(near)]

    def _follow_hand(self, robot_features: Float[np.ndarray, "8"]) -> None:
        features = np.asarray(robot_features)
        opening = float(features[7])
        world_T_tip = spatial.pose_from_features(features[:7])
        if self._held is not None:
            width = self._known[self._held].features[7:9].max()
            if abs(opening - width) > GRIP_SLACK + 0.004:
                self.release()
            else:
                self._ride(world_T_tip)
        elif opening <= self._last_opening + 1e-4:
            block = self._between_pads(world_T_tip, opening)
            if block is not None:
                self.attach(block, features)
        self._last_opening = opening

    def _between_pads(self, world_T_tip: np.ndarray, opening: float) -> Object | None:
        """The block at the tips; of two stacked ones the nearer."""
        tip_T_world = spatial.inverse(world_T_tip)
        found: list[tuple[float, Object]] = []
        for block in self._blocks:
            if block not in self._known:
                continue
            features = self._known[block].features
            place = np.abs(tip_T_world[:3, :3] @ features[:3] + tip_T_world[:3, 3])
            if abs(opening - features[7:9].max()) < GRIP_SLACK and np.all(place < AT_TIP):
                found.append((float(place[2]), block))
        return min(found)[1] if found else None

    def _ride(self, world_T_tip: np.ndarray) -> None:
        if self._held is None:
            return
        known = self._known[self._held]
        pose = spatial.features_from_pose(world_T_tip @ self._tip_T_held)
        covariance = known.covariance.copy()
        covariance[:7, :7] = upright_covariance(np.diag(covariance)[:3], yaw_variance_of(covariance), pose[3:7])
        self._known[self._held] = replace(
            known, features=np.concatenate([pose, known.features[7:]]), covariance=covariance
        )

    def _memory(self) -> tuple[dict[Object, Known], Object | None, np.ndarray, dict[Object, np.ndarray]]:
        """What a scan may change and a better look at the same scene must find as it was."""
        return dict(self._known), self._held, self._tip_T_held, self._at_grasp

    def _hide(self, block: Object, covers: Sequence[Object], scene: SceneEstimate) -> bool:
        """Is a block that was not found plausibly under another one? If so, its estimate is brought up to date."""
        before, glimpse = self._known.get(block), scene.glimpses.get(block.name)
        if glimpse is not None:
            place = glimpse.centre
        elif before is not None:
            place = before.features[:2]
        else:
            return False
        over = [self._known[c] for c in covers if self._is_over(self._known[c].features, place)]
        if not over:
            return False
        cover = min(over, key=lambda k: underside(k.features))
        if glimpse is None and before is not None:
            self._known[block] = not_a_point_of(before)
        else:
            self._known[block] = put_under(before, cover, self._ground(cover.features[:2]))
        return True

    def _is_over(self, cover: np.ndarray, place: np.ndarray) -> bool:
        """Does it stand there on something?"""
        lifted = underside(cover) > self._ground(cover[:2]) + LIFTED
        return bool(lifted and np.hypot(*(cover[:2] - place)) < BENEATH)

    def _ground(self, xy: np.ndarray) -> float:
        catalogue = self._estimator.catalogue
        inside = inside_box(xy, self._known[self._box].features)
        return catalogue.table_z + (catalogue.floor_thickness if inside else 0.0)
