"""Which of the blocks that were seen is which, and the errors for what stays open."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.optimize import linear_sum_assignment

from resync_robot.core.errors import PerceptionError
from resync_robot.perception.blocks import BlockEstimate
from resync_robot.perception.objects import SceneEstimate

SAME_PLACE = 0.020
"""m within which a block that is seen is the one that was believed there."""


class UnsettledSceneError(PerceptionError):
    """A scan that does not say of every object where it is; another look may.

    Attributes:
        names: of those objects.
    """

    names: tuple[str, ...] = ()

    @staticmethod
    def of(errors: Sequence[UnsettledSceneError]) -> UnsettledSceneError:
        """Several at once."""
        both = UnsettledSceneError("; ".join(e.what for e in errors), "; ".join(e.fix for e in errors))
        both.names = tuple(n for e in errors for n in e.names)
        return both


class MissingObjectsError(UnsettledSceneError):
    """A scan did not find everything.

    Attributes:
        names: of the things that were neither seen nor plausibly hidden.
        seen: names of those that were.
        without_depth: names of those missing that show in the pictures, where these hold no depth.
        in_part: name of each one missing that may be what the pictures show only a part of -> (n, 2) where, m.
    """

    def __init__(
        self,
        missing: tuple[str, ...],
        seen: tuple[str, ...],
        without_depth: tuple[str, ...] = (),
        in_part: Mapping[str, Float[np.ndarray, "n 2"]] | None = None,
    ) -> None:
        blind = tuple(n for n in missing if n in without_depth)
        self.in_part = {n: places for n, places in (in_part or {}).items() if n in missing}
        reasons = [f"{', '.join(blind)} shows in the pictures, but without depth"] if blind else []
        reasons += [f"{n} shows only in part, at {_at(places)} m" for n, places in self.in_part.items()]
        why = f" ({'; '.join(reasons)})" if reasons else ""
        super().__init__(
            f"the scan did not find {', '.join(missing)}{why}; it found {', '.join(seen) or 'nothing'}",
            "shade it from glare, and keep it 0.2 m from the lens"
            if blind
            else "put it where the wrist camera looks: into the box, or on the table left or right of it",
        )
        self.without_depth = blind
        self.names, self.seen = missing, seen


class AmbiguousObjectsError(UnsettledSceneError):
    """More things of a kind were seen than there are, and nothing says which of them is meant.

    Attributes:
        seen: name of each thing in question -> (n, 2) where such ones were seen, m.
    """

    def __init__(self, seen: Mapping[str, Float[np.ndarray, "n 2"]]) -> None:
        words = []
        for name, places in seen.items():
            words.append(f"{len(places)} things that may be {name}, at {_at(places)} m")
        super().__init__(
            f"the scan saw {'; '.join(words)}", "take away what is not part of the task, and all else of that colour"
        )
        self.names, self.seen = tuple(seen), seen


def _at(places: Float[np.ndarray, "n 2"]) -> str:
    return ", ".join(f"({x:.3f}, {y:.3f})" for x, y in places)


def name_blocks(
    scene: SceneEstimate,
    look_alikes: Sequence[Sequence[str]],
    names: Sequence[str],
    in_hand: Collection[str],
    places: Mapping[str, Float[np.ndarray, "2"]],
) -> tuple[SceneEstimate, dict[str, Float[np.ndarray, "n 2"]]]:
    """Give blocks that look alike the names of those that stood nearest.

    Args:
        look_alikes: the catalogue's names, those of one colour together.
        names: of the blocks that there are.
        in_hand: those between the pads or on top of what is, as believed.
        places: (x, y) where each was believed before, m.

    Returns:
        The scene with the names put right, and what stays open: blocks seen more often than they exist, each with the
        places where. They are not in the scene.
    """
    blocks, glimpses = dict(scene.blocks), dict(scene.glimpses)
    ambiguous: dict[str, np.ndarray] = {}
    for group in look_alikes:
        mine = [n for n in group if n in names]
        seen = [scene.blocks[n] for n in group if n in blocks]
        seen += [s for s in scene.surplus if s.name in group]
        if len(group) == 1 and len(seen) < 2:
            continue
        for name in group:
            blocks.pop(name, None)
        for name in in_hand:
            if name in mine and len(seen) < len(mine):
                mine.remove(name)
        too_many = len(seen) > len(mine)
        chosen = _nearest(mine, seen, places, SAME_PLACE if too_many else np.inf)
        open_names = [n for n in mine if n not in chosen]
        if too_many:
            ambiguous |= {n: np.array([e.features[:2] for e in seen]) for n in open_names}
        else:
            left = [e for e in seen if not any(e is c for c in chosen.values())]
            chosen |= dict(zip(open_names, left, strict=False))
        blocks |= {name: replace(estimate, name=name) for name, estimate in chosen.items()}
        # What is only glimpsed is one of those that were not seen.
        glimpsed = [glimpses.pop(name) for name in group if name in glimpses]
        unseen = [n for n in mine if n not in chosen]
        glimpses |= {name: replace(g, name=name) for name, g in zip(unseen, glimpsed, strict=False)}
    return replace(scene, blocks=blocks, glimpses=glimpses), ambiguous


def _nearest(
    names: Sequence[str], seen: Sequence[BlockEstimate], places: Mapping[str, np.ndarray], most: float
) -> dict[str, BlockEstimate]:
    """Name -> the estimate nearest to where that block was believed, all together, none further than `most` m."""
    known = [n for n in names if n in places]
    if not known or not seen:
        return {}
    away = np.array([[np.hypot(*(e.features[:2] - places[n])) for e in seen] for n in known])
    pairs = zip(*linear_sum_assignment(away), strict=True)
    return {known[r]: seen[c] for r, c in pairs if away[r, c] < most}
