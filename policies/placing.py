"""Where a block can be put down, so that it can be picked again and stands in nobody's way."""

from __future__ import annotations

from collections.abc import Callable, Collection

import numpy as np
from jaxtyping import Bool, Float

from resync_robot.core import spatial
from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.core.vocabulary import BLOCK, BOX
from resync_robot.policies.fittings import in_a_way
from resync_robot.policies.grasp import SPARE, finger_clearance

REGION = np.array([[0.34, 0.60], [-0.36, 0.36]])
"""x and y in the world, m, between which things are put down: what a round of pictures shows well."""
PITCH = 0.02
"""m between two places that are considered."""
ROOM = 0.042
"""m from the block to the nearest wall or block: an open finger, thickness and all, with 15 mm to spare a side."""
CLEAR = 2 * SPARE
"""m to the nearest wall or block of what has to be clear in any case: as much again is lost in putting it down."""
ENOUGH_ROOM = 0.060
"""m of room beyond which more of it is worth no longer way."""
ANOTHER = 0.08
"""m from one place to the next that is tried."""

Places = Float[np.ndarray, "n 3"]
"""x, y in the world, and the height of what is to be stood upon, m."""


def free_places(
    state: State,
    carried: Collection[Object],
    width: float,
    needs: Float[np.ndarray, "k 2"],
    near: np.ndarray,
    reaches: Callable[[Places], np.ndarray],
) -> list[np.ndarray]:
    """Places where a block of this width can be put down and picked again, in the way of no drawer; the best first.

    It has ROOM there on all sides, whichever way it is turned; where a full scene has no such place, what it needs as
    it is turned now. The table comes before the floor of a box: what is dragged out of a corner there needs the room.
    Then comes the place with more room, up to ENOUGH_ROOM, then the nearer one.

    Args:
        carried: what is in the hand, and so no obstacle.
        needs: from the middle of the block to what has to be clear in any case, as the hand is turned: its own corners
            and those of the open fingers, m.
        near: (2,) where the hand is, m.
        reaches: says of (n, 3) places which ones the hand reaches.

    Returns:
        (3,) each: x, y, and the height of the ground there, m. No two are nearer to each other than ANOTHER.
    """
    x, y = (np.arange(low, high + PITCH / 2, PITCH) for low, high in REGION)
    xy = np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)
    others = [b for b in state.of_type(BLOCK) if b not in carried]
    room = finger_clearance(state, xy, 0.0, others) - width / np.sqrt(2)
    ground, inside = np.zeros(len(xy)), np.zeros(len(xy), dtype=bool)
    for box in state.of_type(BOX):
        within = _inside(state, box, xy)
        ground[within], inside = state.get(box, "z")[0], inside | within
    places = np.column_stack([xy, ground])
    unused = ~in_a_way(state, xy, width / np.sqrt(2))
    free = (room >= ROOM) & unused
    free[free] = reaches(places[free])
    if not free.any():
        free = (finger_clearance(state, xy[:, None] + needs, 0.0, others).min(1) > CLEAR) & unused
        free[free] = reaches(places[free])
    order = np.lexsort((np.linalg.norm(xy - near, axis=1), -np.minimum(room, ENOUGH_ROOM), inside))
    found: list[np.ndarray] = []
    for place in places[order[free[order]]]:
        if all(np.linalg.norm(place[:2] - other[:2]) >= ANOTHER for other in found):
            found.append(place)
    return found


def _inside(state: State, box: Object, xy: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, "n"]:
    pose = spatial.pose_from_features(state[box][:7])
    local = np.abs((xy - pose[:2, 3]) @ pose[:2, :2])
    return np.asarray(np.all(local < state.get(box, "inner_x", "inner_y") / 2, axis=1))
