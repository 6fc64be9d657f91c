"""From where to look next: at what the hand may have changed since the last scan, or at what is in doubt."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from resync_robot.core.rig import Rig
from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.core.vocabulary import BLOCK, BOX, DRAWER, LID
from resync_robot.deployment.hand_trace import HandTrace, takes_up
from resync_robot.perception import sights
from resync_robot.perception.catalogue import Catalogue
from resync_robot.perception.ground import Ground
from resync_robot.perception.next_views import next_views
from resync_robot.perception.pose import covers, inside_box
from resync_robot.perception.scan import Scan

SAME_SIGHT = 0.05
"""m within which a look at one place shows the other."""


@dataclass(frozen=True)
class Look:
    """Some pictures of a part of the scene.

    Attributes:
        changed: what may be elsewhere than at the last scan; the pictures show where it is now.
        views: (6,) configurations to take them from, rad.
    """

    changed: tuple[Object, ...]
    views: list[Float[np.ndarray, "6"]]


@dataclass(frozen=True)
class Chooser:
    """Chooses few pictures of what the hand may have changed.

    Whatever is near where the hand was low may have moved, and what stands in a drawer with the drawer. What a lid has
    left uncovered may be anything. Each thing is shown as an estimate of its type needs it.

    Args:
        scan, rig: of the camera that takes the pictures, and of the hand that is in them.
        catalogue: how drawers are built.
    """

    scan: Scan
    rig: Rig
    catalogue: Catalogue

    def __call__(
        self,
        trace: HandTrace,
        before: State,
        state: State,
        unseen: Collection[Object],
        in_hand: Collection[Object],
        begin: Float[np.ndarray, "6"],
    ) -> Look | None:
        """None where everything is to be looked at.

        Args:
            before: as believed after the last scan.
            state: as believed now.
            unseen: of its objects, those that were never seen: only what covers them is known.
            in_hand: what the hand holds, and what rides on that.
            begin: where the arm is, rad.
        """
        if trace.last is None or any(o.type == LID for o in in_hand):
            return None
        state = state.project(o for o in state if o not in unseen)
        touched = trace.touched(state)
        if any(o not in (*touched, *in_hand) for o in trace.carried):
            # It fell out of the hand on the way, and lies nobody knows where.
            return None
        uncovered = [b for b in state.of_type(BOX) if self._covered(before, b) and not self._covered(state, b)]
        revealed = [b for b in state.of_type(BLOCK) if any(inside_box(state[b][:2], state[box]) for box in uncovered)]
        in_drawers = self._in_drawers(state, touched)
        own_place = [
            b
            for b in touched
            if b.type == BLOCK and b not in (*in_hand, *revealed) and (b not in in_drawers or b in trace.carried)
        ]
        fitted = [o for o in touched if o.type in (LID, DRAWER)]
        places = [state.get(b, "x", "y") for b in own_place]
        if not any(f.away(trace.last) < 0 for o in fitted for f in takes_up(state, o)):
            places.insert(0, trace.last)
        views = next_views(
            self.scan,
            self.rig,
            apart(places),
            state[state.of_type(BOX)[0]],
            begin,
            holding=bool(in_hand),
            sights=[*(sights.of_box(state[b]) for b in uncovered), *(self._sight(state, o) for o in fitted)],
            solids=[
                solid
                for d in state.of_type(DRAWER)
                for solid in sights.cabinet_and_front(state[d], self.catalogue.drawers[d.name])
            ],
        )
        changed = tuple(dict.fromkeys((*touched, *uncovered, *revealed, *in_drawers)))
        return Look(changed, views) if 0 < len(views) < len(self.scan.configurations) else None

    def _covered(self, state: State, box: Object) -> bool:
        return any(covers(state[lid], state[box], self.catalogue) for lid in state.of_type(LID))

    def _in_drawers(self, state: State, touched: Collection[Object]) -> list[Object]:
        """The blocks that go where a touched drawer goes."""
        drawers = {d.name: state[d] for d in state.of_type(DRAWER) if d in touched}
        ground = Ground(self.catalogue, None, drawers)
        return [b for b in state.of_type(BLOCK) if ground.tray_at(state[b][:2]) is not None]

    def _sight(self, state: State, fitting: Object) -> sights.Sight:
        if fitting.type == LID:
            return sights.of_lid(state[fitting])
        return sights.of_drawer(state[fitting], self.catalogue.drawers[fitting.name])


def apart(places: Iterable[Float[np.ndarray, "2"]]) -> list[Float[np.ndarray, "2"]]:
    """Those of some places, in m, that a look at one before them does not show."""
    places = list(places)
    return [p for i, p in enumerate(places) if all(np.linalg.norm(p - q) > SAME_SIGHT for q in places[:i])]
