"""What a camera policy sees and does: windows around the hand in three views, the arm's joints, what the scan before
it has measured; and steps of the hand.

The windows are where the calibration says that the finger tips are, so that the block, which lies beneath them, always
shows near the middle, at the same scale and close to the camera's own resolution. Steps are in the hand's own axes.
The deployed skill and the rendered scenes that it learns in share every line of this file.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Bool, Float, UInt8

from resync_robot.core import spatial
from resync_robot.core.rig import CameraRig
from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.core.world import Window
from resync_robot.learning.recovery_policy import STUD

VIEWS = ("front", "side", "wrist")
"""The cameras of the rig that a policy looks through, in the order of its inputs."""
PICTURE = 64
"""Pixels of a side of what a small policy sees."""
SPAN = 0.22
"""m that a window shows at the distance of the finger tips: the block, and the walls until it is clear of them."""
RATE_HZ = 10.0
STATE_NAMES = (
    *(f"joint_{i}_rad" for i in range(6)),
    *(f"tip_{axis}_m" for axis in "xyz"),
    *(f"lead_{axis}_m" for axis in "xyz"),
    "stud_forward_m",
    "stud_left_m",
    "stud_up_m",
    "corner_forward_m",
    "corner_left_m",
    "width_m",
    "height_m",
    "carried_forward_m",
    "carried_left_m",
)
"""Joint positions; the tip in the world, from them; how far the tip has been sent ahead of where it is, hand's axes.
Then what the scan tells: from the tip to where the block's stud was, and to the corner of the box nearest to it, in the
hand's axes, and the block's size. Pictures of 64 pixels alone put the top of a block of a size that training never had
7 mm beside where it is; measured once, it is known to a millimetre until the block leans. Last, how far the hand has
gone since while it pressed on the block: where that is nothing, all of the scan still holds, whatever pictures of a new
kind may look like."""
ACTION_NAMES = ("forward_m", "left_m", "up_m")
"""The step from where the tip is being sent to where it is sent next, in the hand's own horizontal axes."""


BLOCK_NAMES = ("forward_m", "left_m", "up_m", "gap_x_m", "gap_y_m", "lean_forward", "lean_left")
GAPS, LEAN = slice(3, 5), slice(5, 7)
BLOCK_MEAN = np.array([0.0, 0.0, -0.05, 0.03, 0.03, 0.0, 0.0])
BLOCK_SPREAD = np.array([0.02, 0.02, 0.03, 0.02, 0.02, 0.3, 0.3])
"""What these are, roughly. A network learns them ten times faster in these units than in metres."""
WIDEST_GAP = 0.06
"""m; walls that are further away lie outside of the windows, so all such gaps are as one."""


@dataclass(frozen=True)
class Prediction:
    """What a policy says of n observations.

    Attributes:
        steps: (n, horizon, 3) m, the next steps of the hand, of which the first begins when the present one ends.
        done: (n,) probability that there is nothing left to do, by the pictures.
        free: (n,) the same, by where it sees the block alone.
        block: (n, 7), as far as it can be seen: in m from the tip to the middle of the block's top in the hand's axes,
            and the block's distance to the nearer wall on each axis of the box, up to WIDEST_GAP; then how far its
            upward axis, of length 1, leans forward and left.
    """

    steps: Float[np.ndarray, "n h 3"]
    done: Float[np.ndarray, " n"]
    free: Float[np.ndarray, " n"]
    block: Float[np.ndarray, "n 7"]


DONE, DONE_IN_A_ROW = 0.5, 2
"""A policy is believed to be done when it says so, above this probability, and so often in a row."""


def says_done(said: Prediction, above: float = DONE) -> Bool[np.ndarray, " n"]:
    """Does it hold its recovery for finished, and agree with itself about that? Both above this probability."""
    return (said.done > above) & (said.free > above)


LEANS, LET_GO, BESIDE = 0.25, 0.02, 0.05
"""From this sine of the block's lean on, as the policy sees it, the hand lets go, so far up in a step (m), unless its
tip is that far (m) above the block already. The block falls back on its base; pulled on, it would soon lie on its side,
where nothing can pick it."""


def leans(said: Prediction) -> Bool[np.ndarray, " n"]:
    """Does it see the block lean, with the tip near it?"""
    return (np.linalg.norm(said.block[:, LEAN], axis=-1) > LEANS) & (said.block[:, 2] > -BESIDE)


def careful_steps(said: Prediction) -> Float[np.ndarray, "n h 3"]:
    """The steps to take: the policy's own, or straight up where it sees the block lean."""
    return np.where(leans(said)[:, None, None], [0.0, 0.0, LET_GO], said.steps)


class CameraPolicy(Protocol):
    """From pictures and proprioception to steps of the hand.

    Attributes:
        picture: pixels of a side of the pictures that it wants.
    """

    @property
    def picture(self) -> int: ...

    def __call__(self, pictures: UInt8[np.ndarray, "n v p p 3"], state: Float[np.ndarray, "n s"]) -> Prediction: ...


def window_at(camera: CameraRig, world_T_cam: Float[np.ndarray, "4 4"], tip: Float[np.ndarray, "3"]) -> Window:
    """Where in the camera's picture the policy looks; always inside it.

    Args:
        world_T_cam: pose of the camera as the robot believes it.
        tip: position of the finger tips in the world, m.
    """
    if camera.mount == "flange":
        # It moves with the hand, which is always at one place of its picture, in the middle of its width.
        width = min(camera.width, 1.25 * camera.height)
        return Window((camera.width - width) / 2, 0.0, width, float(camera.height))
    x, y, z = spatial.inverse(world_T_cam)[:3] @ np.append(tip, 1.0)
    z = max(float(z), 0.05)
    side = min(camera.fx * SPAN / z, camera.width, camera.height)
    left = camera.fx * x / z + camera.cx + 0.5 - side / 2
    top = camera.fy * y / z + camera.cy + 0.5 - side / 2
    return Window(
        float(np.clip(left, 0.0, camera.width - side)), float(np.clip(top, 0.0, camera.height - side)), side, side
    )


@dataclass(frozen=True)
class Scanned:
    """What a scan has measured of a block and its box before the recovery began. World frame, m.

    Attributes:
        stud: (3,) the middle of the stud's top.
        corner: (2,) the box's inner corner that is nearest to the block.
        size: (2,) width and height of the block.
    """

    stud: Float[np.ndarray, "3"]
    corner: Float[np.ndarray, "2"]
    size: Float[np.ndarray, "2"]

    @staticmethod
    def of(state: State, block: Object, box: Object) -> Scanned:
        """From a state that holds both."""
        x, y, z, width, height = state.get(block, "x", "y", "z", "size_x", "size_z")
        yaw = float(spatial.yaw_of(state.get(box, "qw", "qx", "qy", "qz")))
        middle, half = np.array(state.get(box, "x", "y", "z")), np.array(state.get(box, "inner_x", "inner_y")) / 2
        side = np.where(to_hand(np.array([x, y, z]) - middle, yaw)[:2] < 0, -1.0, 1.0)
        corner = middle + from_hand(np.array([*(side * half), 0.0]), yaw)
        return Scanned(np.array([x, y, z + height / 2 + STUD]), corner[:2], np.array([width, height]))


def state_seen(
    q: Float[np.ndarray, "6"],
    tip: Float[np.ndarray, "3"],
    sent: Float[np.ndarray, "3"],
    yaw: float,
    scanned: Scanned,
    carried: Float[np.ndarray, "2"],
) -> Float[np.ndarray, "21"]:
    """The state that a policy sees, as in STATE_NAMES.

    Args:
        q: measured joints, rad.
        tip: where they put the tip, world, m.
        sent: where the tip is being sent in the control step that begins now, world, m.
        yaw: heading of the hand's x axis in the world, rad.
        scanned: what was measured before the recovery began.
        carried: how far the hand has gone since while it pressed on the block, world, m; as `Carried.away`.
    """
    stud = to_hand(scanned.stud - tip, yaw)
    corner = to_hand(np.append(scanned.corner - tip[:2], 0.0), yaw)[:2]
    along = to_hand(np.append(carried, 0.0), yaw)[:2]
    return np.concatenate([q, tip, to_hand(sent - tip, yaw), stud, corner, scanned.size, along]).astype(np.float32)


def to_hand(vectors: Float[np.ndarray, "*n 3"], yaw: float) -> Float[np.ndarray, "*n 3"]:
    """World vectors in the axes of a hand that points down: forward (its own x), left of that, up."""
    c, s = np.cos(yaw), np.sin(yaw)
    x, y, z = np.moveaxis(np.asarray(vectors, dtype=np.float64), -1, 0)
    return np.stack([c * x + s * y, c * y - s * x, z], -1)


def from_hand(vectors: Float[np.ndarray, "*n 3"], yaw: float) -> Float[np.ndarray, "*n 3"]:
    """The inverse of `to_hand`."""
    return to_hand(vectors, -yaw)


EXECUTE = 2
"""Steps of a chunk that are carried out before the next chunk takes over."""
BLEND = 0.3
"""Share that the older of two overlapping chunks keeps: no jump at the seam."""


class Chunks:
    """Chunks of steps as they come in, one after the other, and the next step to take.

    Each chunk is asked for while a step is under way and begins with the one after it, so the policy has one control
    step of time to think. A chunk that is late is bridged by what is left of the one before.
    """

    def __init__(self) -> None:
        self._steps = np.zeros((0, 3))
        self._used = 0

    @property
    def wanting(self) -> bool:
        """Is it time to ask for the next chunk?"""
        return self._used >= EXECUTE or not len(self._steps)

    @property
    def left(self) -> int:
        """Steps that could still be taken without a new chunk."""
        return len(self._steps) - self._used

    def push(self, steps: Float[np.ndarray, "h 3"], late: int = 0) -> None:
        """Take in a chunk that is `late` steps too late."""
        old, new = self._steps[self._used :], np.array(steps, dtype=np.float64)[late:]
        shared = min(len(old), len(new))
        new[:shared] += BLEND * (old[:shared] - new[:shared])
        self._steps, self._used = new, 0

    def next(self) -> Float[np.ndarray, "3"]:
        """The next step, m, hand's axes; at rest where there is none left."""
        if not self.left:
            return np.zeros(3)
        self._used += 1
        return self._steps[self._used - 1]
