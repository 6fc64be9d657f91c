"""Where demonstrations begin: failures, what lies between a failure and a recovery, and recoveries already made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float

from resync_robot.core.symbols import Object
from resync_robot.core.task import Domain, Task
from resync_robot.core.vocabulary import BLOCK, BOX
from resync_robot.learning import recovery_policy as view
from resync_robot.learning.failures import PairGaussian
from resync_robot.sim_training.physics.randomise import PICTURED, Ranges, draw_physics

APART = 0.10
"""m between the centres of blocks, so that none begins inside another."""


@dataclass(frozen=True)
class Start:
    """A task, and the block in it that is to be recovered."""

    task: Task
    block: Object


def draw_start(
    domain: Domain,
    gaussians: Mapping[str, PairGaussian],
    seed: int,
    ranges: Ranges = PICTURED,
    failed_only: bool = False,
) -> Start:
    """A world of two or three blocks, any of them the one to be recovered, the others free or stuck as well.

    Args:
        failed_only: only failures, as a deployed recovery mostly meets them; otherwise three in ten lie between the
            failure and the recovery, and one in ten was recovered before.
    """
    rng = np.random.default_rng([seed, 31])
    while True:
        task = domain.dream(rng, seed, int(rng.integers(2, 4)))
        blocks = [o for o in task.objects if o.type == BLOCK]
        block = blocks[int(rng.integers(len(blocks)))]
        kind = 0.0 if failed_only else rng.random()
        box = task.initial.of_type(BOX)[0]
        task = domain.relocate(task, block, box, _relative(gaussians, kind, rng), rng)
        for other in blocks:
            if other != block and rng.random() < 0.25:
                drawn = gaussians["before" if rng.random() < 0.5 else "after"].sample(rng)
                task = domain.relocate(task, other, box, drawn, rng)
        places = [task.initial.get(b, "x", "y") for b in blocks]
        if all(np.linalg.norm(a - b) > APART for i, a in enumerate(places) for b in places[i + 1 :]):
            physics = draw_physics(rng, [b.name for b in blocks], ranges)
            return Start(replace(task, physics=physics), block)


def _relative(gaussians: Mapping[str, PairGaussian], kind: float, rng: np.random.Generator) -> Float[np.ndarray, "4"]:
    """How a block lies in the box, in the columns of the domain's corner: two gaps, then its heading."""
    before, after = gaussians["before"].sample(rng), gaussians["after"].sample(rng)
    if kind < 0.6:
        return before
    if kind > 0.9:
        return after
    share = rng.random()
    # Headings differ by any number of quarter turns; the failure's own suits a place near the walls.
    near, far = np.sort(before[:2]), np.sort(after[:2])
    return np.concatenate([near + share * (far - near), before[2:]])


def draw_still(x: torch.Tensor, random: torch.Generator) -> torch.Tensor:
    """(n, 27) the states `x` with the block anywhere from its corner to the middle, and a hand at rest over it.

    A policy's own path hardly shows these: a block that is nearly free, and nobody touches it. Yet a deployed skill
    may begin there, and its terminal function must say whether anything is left to do.
    """
    n, still = len(x), x.clone()

    def uniform(*shape: int) -> torch.Tensor:
        return torch.rand(*shape, generator=random, device=x.device)

    along_x, along_y = view.box_axes(x)
    block, centre = x[:, view.BLOCK], x[:, view.BOX][:, :2]
    off = block[:, :2] - centre
    local = torch.stack([(off * along_x).sum(-1), (off * along_y).sum(-1)], -1) * uniform(n, 2)
    place = centre + local[:, :1] * along_x + local[:, 1:] * along_y
    still[:, view.BLOCK.start : view.BLOCK.start + 2] = place
    over = block[:, 2] + block[:, 9] / 2 + view.STUD
    planar = place + 0.03 * (2 * uniform(n, 2) - 1)
    still[:, view.TIP] = still[:, view.COMMANDED] = torch.cat([planar, (over + 0.10 * uniform(n))[:, None]], -1)
    return still
