"""What the robot believes about the scene between two scans: estimates, what it holds, what it no longer sees."""

from __future__ import annotations

import copy
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from resync_robot.core import spatial
from resync_robot.core.errors import PerceptionError, UnknownNameError
from resync_robot.core.rig import Rig
from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.core.vocabulary import BLOCK, DRAWER, LID
from resync_robot.core.world import CameraFrame
from resync_robot.perception.grasp import BENEATH, Grasp
from resync_robot.perception.ground import Ground
from resync_robot.perception.known import (
    LIFTED,
    Known,
    averaged_sizes,
    measured,
    moved_to,
    not_a_point_of,
    out_of_sight,
    put_under,
    somewhere_in,
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
from resync_robot.perception.pose import BoxEstimate, covers, inside_box

CLEAR = {BLOCK: 0.0012, LID: 0.004, DRAWER: 0.004}
"""m, of x or y: up to which the place of a thing that was seen is known well enough for the skills."""
LET_GO = 0.05
"""m from where a lid is believed in the hand, from which on one that is seen is not in the hand."""


@dataclass(frozen=True)
class ScanReport:
    """What the last scan said about each block, lid and drawer, by name. `hidden` ones are under another block, or in a
    drawer under its cabinet; `covered` ones have never been seen, and are under a lid; `tipped` blocks were seen, but
    do not stand upright; `ambiguous` things were seen more than once, and keep their old estimates."""

    seen: tuple[str, ...] = ()
    hidden: tuple[str, ...] = ()
    covered: tuple[str, ...] = ()
    held: tuple[str, ...] = ()
    tipped: tuple[str, ...] = ()
    ambiguous: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()


class Belief:
    """Keeps an estimated state of box, blocks, lids and drawers.

    What the pads have closed on, a block or a lid's knob, rides with the tips, and so do the blocks that were seated on
    it. What stands in a drawer moves with it. Sizes are averaged over the scans; poses are those of the last one. A
    block that nobody has seen, and that a lid may cover, is somewhere in the box: its covariance says how little that
    is.

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
        self._grasp = Grasp(self._blocks, {o: catalogue.lids[o.name] for o in self._fittings if o.type == LID})
        self._ambiguous: Mapping[str, np.ndarray] = {}
        self._in_part: Mapping[str, np.ndarray] = {}
        self._glimpsed: Mapping[str, np.ndarray] = {}
        self._before_scan = self._memory()
        self.report = ScanReport()

    @property
    def held(self) -> Object | None:
        """The block or lid between the pads, as believed."""
        return self._grasp.held

    @property
    def in_hand(self) -> tuple[Object, ...]:
        """That, and what rides on it."""
        return (*((self.held,) if self.held else ()), *self._grasp.riders)

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
        if changed is not None and self._box not in changed:
            known = self._known[self._box]
            box = BoxEstimate(known.features, known.covariance, seen=not known.is_guess)
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
        places = {b.name: k.features[:2] for b, k in self._known.items() if b in self._blocks and not k.is_guess}
        in_hand = [o.name for o in self.in_hand]
        scene, ambiguous = name_blocks(
            scene, self._estimator.catalogue.look_alikes, [b.name for b in self._blocks], in_hand, places
        )
        if changed is None or self._box in changed:
            self._take_box(scene.box)
        unchanged = self._as_before(scene, changed)
        seen = [b for b in self._blocks if b.name in scene.blocks and b not in unchanged]
        fitted = [
            o for o in self._fittings if o.name in scene.fittings and o not in unchanged and not self._is_held(o, scene)
        ]
        where = {b: scene.blocks[b.name].features for b in seen} | {o: scene.fittings[o.name].features for o in fitted}
        self._grasp.correct(self._known, self._grasp.left_behind(where), robot_features)
        for block in seen:
            self._known[block] = measured(self._known.get(block), scene.blocks[block.name])
        for obj in fitted:
            before, after = self._known.get(obj), scene.fittings[obj.name]
            self._known[obj] = Known(after.features, after.covariance)
            if obj.type == DRAWER and before is not None:
                self._carry_in(obj, before.features, seen)
        ambiguous |= {o.name: scene.seen_twice[o.name] for o in self._fittings if o.name in scene.seen_twice}
        settled = {*seen, *unchanged, *self.in_hand}
        unseen = [b for b in self._blocks if b not in settled and b.name not in ambiguous]
        hidden, covered = self._out_of_view(unseen, [*seen, *(o for o in unchanged if o in self._blocks)], scene)
        lost = [o for o in self._fittings if o not in (*fitted, *settled) and o.name not in ambiguous]
        missing = tuple(o.name for o in (*unseen, *lost) if o not in (*hidden, *covered))
        self.report = ScanReport(
            seen=tuple(o.name for o in (*seen, *fitted)),
            hidden=tuple(b.name for b in hidden),
            covered=tuple(b.name for b in covered),
            held=tuple(o.name for o in self.in_hand),
            tipped=tuple(b.name for b in seen if not scene.blocks[b.name].upright),
            ambiguous=tuple(ambiguous),
            missing=missing,
        )
        self._ambiguous = ambiguous
        self._in_part = {name: places for name, places in scene.seen_in_part.items() if name in missing}
        self._glimpsed = {name: g.centre for name, g in scene.glimpses.items() if name in missing}
        self._lose(missing, ambiguous)
        self._complain(scene, missing, ambiguous)
        return self.state(robot_features)

    def _take_box(self, box: BoxEstimate) -> None:
        before = self._known.get(self._box)
        if box.seen:
            sizes, scans = averaged_sizes(before, box.features[7:])
            self._known[self._box] = Known(np.array([*box.features[:7], *sizes]), box.covariance, scans)
        elif before is None or before.is_guess:
            # Under a lid; what was measured before is better.
            self._known[self._box] = Known(box.features, box.covariance, scans=0)

    def _is_held(self, obj: Object, scene: SceneEstimate) -> bool:
        """Is what was seen of a lid what hangs from the hand?"""
        if obj != self.held:
            return False
        return bool(np.linalg.norm(scene.fittings[obj.name].features[:2] - self._known[obj].features[:2]) < LET_GO)

    def _carry_in(self, drawer: Object, before: Float[np.ndarray, "11"], seen: Sequence[Object]) -> None:
        """Take what stood in a drawer with these features along to where the drawer is now."""
        after = self._known[drawer].features
        moved = spatial.pose_from_features(after[:7]) @ spatial.inverse(spatial.pose_from_features(before[:7]))
        where = Ground(self._estimator.catalogue, None, {drawer.name: before})
        for block in self._blocks:
            known = self._known.get(block)
            if known is None or block in (*seen, *self.in_hand) or where.tray_at(known.features[:2]) is None:
                continue
            self._known[block] = moved_to(known, moved @ spatial.pose_from_features(known.features[:7]))

    def _out_of_view(
        self, unseen: Sequence[Object], seen: Sequence[Object], scene: SceneEstimate
    ) -> tuple[list[Object], list[Object]]:
        """Of the blocks that were not found, those that something known hides, and those never seen that a lid covers;
        their estimates are brought up to date."""
        hidden: list[Object] = []
        covered: list[Object] = []
        # From above down, as last believed: what hides under one block may hide another in its turn.
        for block in sorted(unseen, key=lambda b: -self._known[b].features[2] if b in self._known else 0.0):
            known = self._known.get(block)
            # Nobody's hand is at work in there, so nothing becomes less sure from scan to scan.
            shut_in = known is not None and block.name not in scene.glimpses and self._in_closed_drawer(known)
            if shut_in or self._hide(block, [*seen, *hidden], scene):
                hidden.append(block)
            elif self._lid_is_on():
                if known is None or known.is_guess:
                    self._known[block] = somewhere_in(self._known[self._box].features, self._estimator.catalogue)
                    covered.append(block)
                elif inside_box(known.features[:2], self._known[self._box].features):
                    self._known[block] = not_a_point_of(known)
                    hidden.append(block)
        return hidden, covered

    def _in_closed_drawer(self, known: Known) -> bool:
        """Does a block stand where a cabinet hides it?"""
        return self._ground.is_under_cabinet(known.features[:2], float(known.features[7:9].max()))

    def _lid_is_on(self) -> bool:
        """Does a lid lie on the box?"""
        box, catalogue = self._known[self._box].features, self._estimator.catalogue
        lids = [self._known[o].features for o in self._fittings if o.type == LID and o in self._known]
        return any(covers(lid, box, catalogue) for lid in lids)

    def _lose(self, missing: Sequence[str], ambiguous: Mapping[str, np.ndarray]) -> None:
        """What should have been seen keeps its old place, roughly; what only had to be somewhere has none."""
        for obj in (*self._blocks, *self._fittings):
            if obj not in self._known or obj.name not in (*missing, *ambiguous):
                continue
            if self._known[obj].is_guess:
                del self._known[obj]
            else:
                self._known[obj] = out_of_sight(self._known[obj], moves=obj.type == DRAWER)

    def _complain(self, scene: SceneEstimate, missing: tuple[str, ...], ambiguous: Mapping[str, np.ndarray]) -> None:
        """Raises UnsettledSceneError where something is missing or ambiguous."""
        unsettled: list[UnsettledSceneError] = []
        if missing:
            unsettled.append(MissingObjectsError(missing, self.report.seen, scene.without_depth, scene.seen_in_part))
        if ambiguous:
            unsettled.append(AmbiguousObjectsError(ambiguous))
        if unsettled:
            raise unsettled[0] if len(unsettled) == 1 else UnsettledSceneError.of(unsettled)

    def _as_before(self, scene: SceneEstimate, changed: Collection[Object] | None) -> list[Object]:
        """What was seen before and has not changed, as far as the pictures tell: what they show elsewhere has."""
        if changed is None:
            return []
        seen = {name: estimate.features[:2] for name, estimate in scene.blocks.items()}
        seen |= {name: estimate.features[:2] for name, estimate in scene.fittings.items()}
        before = [o for o in (*self._blocks, *self._fittings) if o in self._known and not self._known[o].is_guess]
        unchanged = [o for o in before if o not in changed]
        return [
            o
            for o in unchanged
            if o not in self.in_hand
            and (o.name not in seen or np.hypot(*(seen[o.name] - self._known[o].features[:2])) < SAME_PLACE)
        ]

    def unclear_places(self) -> list[Float[np.ndarray, "2"]]:
        """Where another look may help: what the last scan saw badly, in part or more than once, or did not find."""
        places: list[np.ndarray] = [
            place for seen in (*self._ambiguous.values(), *self._in_part.values()) for place in seen
        ]
        places += self._glimpsed.values()
        for obj in (*self._blocks, *self._fittings):
            known = self._known.get(obj)
            if known is None or obj in self.in_hand:
                continue
            badly = obj.name in self.report.seen and np.diag(known.covariance)[:2].max() > CLEAR[obj.type] ** 2
            if badly or (obj.name in self.report.missing and obj.name not in self._glimpsed):
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

    def attach(self, held: Object, robot_features: Float[np.ndarray, "8"]) -> None:
        """The pads hold a block or a lid: from now on it rides with the tips. Raises UnknownNameError if it was never
        seen."""
        if held not in self._known:
            raise UnknownNameError("thing seen so far", held.name, [o.name for o in self._known if o != self._box])
        self._grasp.attach(self._known, held, robot_features)

    def release(self) -> None:
        """The pads hold nothing any more; what they held is believed where they left it."""
        self._grasp.release()

    def _memory(self) -> tuple[dict[Object, Known], Grasp]:
        """What a scan may change and a better look at the same scene must find as it was."""
        return dict(self._known), copy.copy(self._grasp)

    def _hide(self, block: Object, covers: Sequence[Object], scene: SceneEstimate) -> bool:
        """Is a block that was not found plausibly under another one? If so, its estimate is brought up to date."""
        before, glimpse = self._known.get(block), scene.glimpses.get(block.name)
        if before is not None and before.is_guess:
            before = None
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
            self._known[block] = put_under(before, cover, self._ground.height(cover.features[:2]))
        return True

    def _is_over(self, cover: np.ndarray, place: np.ndarray) -> bool:
        """Does it stand there on something?"""
        lifted = underside(cover) > self._ground.height(cover[:2]) + LIFTED
        return bool(lifted and np.hypot(*(cover[:2] - place)) < BENEATH)

    @property
    def _ground(self) -> Ground:
        drawers = {d.name: self._known[d].features for d in self._fittings if d.type == DRAWER and d in self._known}
        return Ground(self._estimator.catalogue, self._known[self._box].features, drawers)
