"""What the robot believes about the scene between two scans: estimates, what it holds, what it no longer sees."""

from __future__ import annotations

import copy
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from resync_robot.core.errors import PerceptionError, UnknownNameError
from resync_robot.core.rig import Rig
from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.core.vocabulary import BLOCK, DRAWER, LID
from resync_robot.core.world import CameraFrame
from resync_robot.perception.grasp import BENEATH, Grasp
from resync_robot.perception.known import (
    LIFTED,
    Known,
    averaged_sizes,
    measured,
    not_a_point_of,
    out_of_sight,
    put_under,
    underside,
)
from resync_robot.perception.naming import (
    SAME_PLACE,
    AmbiguousObjectsError,
    MissingObjectsError,
    UnsettledSceneError,
    name_blocks,
)
from resync_robot.perception.objects import SceneEstimate, SceneEstimator, hues_of
from resync_robot.perception.pose import BoxEstimate, inside_box


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

    A block that the pads have closed on rides with the tips. Sizes are averaged over the scans; poses are those of the
    last one.

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
                raise UnknownNameError(f"{obj.type.name} of the catalogue", obj.name, names[obj.type], hues_of(rig))
        self._known: dict[Object, Known] = {}
        self._grasp = Grasp(self._blocks)
        self._ambiguous: Mapping[str, np.ndarray] = {}
        self._in_part: Mapping[str, np.ndarray] = {}
        self._before_scan = self._memory()
        self.report = ScanReport()

    @property
    def held(self) -> Object | None:
        """The block between the pads, as believed."""
        return self._grasp.held

    @property
    def grasp_is_certain(self) -> bool:
        """Was the held block alone between the pads? Of two stacked ones either may have come along, or both."""
        return self._grasp.is_certain

    def update_from_scan(
        self,
        frames: Sequence[CameraFrame],
        robot_features: Float[np.ndarray, "8"],
        again: bool = False,
        changed: Collection[Object] | None = None,
    ) -> State:
        """Take in the pictures of a scan, taken with the hand as it is now.

        Args:
            again: these are all the pictures of the last scan and more, and take that one's place.
            changed: of all objects that are known, those that may stand elsewhere than they did; the pictures show
                where these are, and need not show the others. By default any may.

        Raises:
            UnsettledSceneError: a block was not found and is not plausibly hidden, or was seen more than once; it keeps
                its old estimate, with a wider covariance, and the next `state` works if there is one.
            PerceptionError: pictures that cannot be used, or no box; nothing is changed.
        """
        box = None
        if changed is not None:
            known = self._known[self._box]
            box = BoxEstimate(known.features, known.covariance)
        return self.update(self._estimator.estimate(frames, box), robot_features, again, changed)

    def update(
        self,
        scene: SceneEstimate,
        robot_features: Float[np.ndarray, "8"],
        again: bool = False,
        changed: Collection[Object] | None = None,
    ) -> State:
        """Take in an estimate of the scene. Raises UnsettledSceneError as `update_from_scan` does."""
        if again:
            known, grasp = self._before_scan
            self._known, self._grasp = dict(known), copy.copy(grasp)
        else:
            self._before_scan = self._memory()
        self._grasp.follow(self._known, robot_features)
        places = {b.name: k.features[:2] for b, k in self._known.items() if b in self._blocks}
        held = self.held.name if self.held else None
        scene, ambiguous = name_blocks(
            scene, self._estimator.catalogue.look_alikes, [b.name for b in self._blocks], held, places
        )
        if changed is None:
            box_sizes, scans = averaged_sizes(self._known.get(self._box), scene.box.features[7:])
            self._known[self._box] = Known(np.array([*scene.box.features[:7], *box_sizes]), scene.box.covariance, scans)
        unchanged = self._as_before(scene, changed)
        seen = [b for b in self._blocks if b.name in scene.blocks and b not in unchanged]
        if self.held in seen:
            self._grasp.correct(self._known, seen, robot_features)
        for block in seen:
            self._known[block] = measured(self._known.get(block), scene.blocks[block.name])
        fitted = [o for o in self._fittings if o.name in scene.fittings]
        for obj in fitted:
            self._known[obj] = Known(scene.fittings[obj.name].features, scene.fittings[obj.name].covariance)
        ambiguous |= {o.name: scene.seen_twice[o.name] for o in self._fittings if o.name in scene.seen_twice}
        settled = {*seen, *unchanged, *([self.held] if self.held else [])}
        unseen = [b for b in self._blocks if b not in settled and b.name not in ambiguous]
        # From above down, as last believed: what hides under one block may hide another in its turn.
        unseen.sort(key=lambda b: -self._known[b].features[2] if b in self._known else 0.0)
        hidden: list[Object] = []
        for block in unseen:
            if self._hide(block, [*seen, *unchanged, *hidden], scene):
                hidden.append(block)
        lost = [o for o in self._fittings if o not in (*fitted, *unchanged) and o.name not in ambiguous]
        missing = tuple(o.name for o in (*unseen, *lost) if o not in hidden)
        self.report = ScanReport(
            seen=tuple(o.name for o in (*seen, *fitted)),
            hidden=tuple(b.name for b in hidden),
            held=(self.held.name,) if self.held else (),
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

    def _as_before(self, scene: SceneEstimate, changed: Collection[Object] | None) -> list[Object]:
        """What is known and has not changed, as far as the pictures tell: what they show elsewhere has."""
        if changed is None:
            return []
        seen = {name: estimate.features[:2] for name, estimate in scene.blocks.items()}
        seen |= {name: estimate.features[:2] for name, estimate in scene.fittings.items()}
        unchanged = [o for o in (*self._blocks, *self._fittings) if o in self._known and o not in changed]
        return [
            o
            for o in unchanged
            if o != self.held
            and (o.name not in seen or np.hypot(*(seen[o.name] - self._known[o].features[:2])) < SAME_PLACE)
        ]

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
            if known is None or obj == self.held:
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
        self._grasp.follow(self._known, robot_features)
        features = {o: k.features for o, k in self._known.items()}
        covariance = {o: k.covariance for o, k in self._known.items()}
        return State({**features, self._robot: np.asarray(robot_features)}, covariance)

    def attach(self, block: Object, robot_features: Float[np.ndarray, "8"]) -> None:
        """The pads hold `block`: from now on it rides with the tips. Raises UnknownNameError if it was never seen."""
        if block not in self._known:
            raise UnknownNameError("block seen so far", block.name, [o.name for o in self._known if o in self._blocks])
        self._grasp.attach(self._known, block, robot_features)

    def release(self) -> None:
        """The pads hold nothing any more; the block is believed where they left it."""
        self._grasp.release()

    def _memory(self) -> tuple[dict[Object, Known], Grasp]:
        """What a scan may change and a better look at the same scene must find as it was."""
        return dict(self._known), copy.copy(self._grasp)

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
