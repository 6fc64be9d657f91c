"""Scenes for judging perception: blocks free, in corners, at walls, touching and stacked, some of one colour."""

from __future__ import annotations

import colorsys
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from resync_robot.core import spatial
from resync_robot.core.rig import load_rig
from resync_robot.core.state import State
from resync_robot.core.task import Task
from resync_robot.core.vocabulary import BLOCK
from resync_robot.sim_training.domains.cornered_insertion_s.corner import block_features
from resync_robot.sim_training.domains.cornered_insertion_s.layouts import (
    THE_BOX,
    R,
    corner_pose,
    free_in_box,
    free_on_table,
    sample_block_sizes,
    sample_box,
    wall_pose,
)
from resync_robot.sim_training.physics.parts import CLEARANCE
from resync_robot.sim_training.physics.randomise import BLOCK_HUES, PICTURED, Ranges, draw_physics

TWIN = "b4"
"""A block of the same colour as another one."""
BETWEEN = 0.012
"""Least gap between blocks that do not touch, m."""
FREE, TABLE, CORNER, WALL, TOUCHING, UPPER, LOWER = (
    "free in the box",
    "on the table",
    "in a corner",
    "at a wall",
    "touching",
    "stacked, upper",
    "stacked, lower",
)
SINGLES, PAIRS = (FREE, TABLE, CORNER, WALL), (TOUCHING, UPPER)


@dataclass(frozen=True)
class PerceptionScene:
    """Attributes: `conditions`, how each block begins, by name; `hues`, the colour that each is known by."""

    task: Task
    conditions: Mapping[str, str]
    hues: Mapping[str, float]


def draw_scene(seed: int, index: int, ranges: Ranges = PICTURED) -> PerceptionScene:
    """The scene of that number: two to five blocks, box, light and surfaces, a pure function of its arguments."""
    rng = np.random.default_rng([seed, index, 40])
    names, twin_of = _draw_names(rng)
    units = _draw_units(rng, names)
    rig = load_rig()
    while True:
        box = sample_box(rng)
        sizes = sample_block_sizes(rng, names)
        placed = _place(rng, box, sizes, units)
        if placed is not None:
            break
    features = {BLOCK(name): placed[name] for name in sorted(placed)}
    features |= {THE_BOX: box, R: np.array([0.45, 0.0, 0.30, 0.0, 1.0, 0.0, 0.0, rig.gripper.max_opening])}
    state = State(features)
    physics = draw_physics(rng, names, ranges)
    hues = {name: BLOCK_HUES[twin_of if name == TWIN else name] for name in names}
    if TWIN in names:
        hue = (hues[TWIN] + rng.uniform(-0.02, 0.02)) % 1.0
        colours = {**physics["colours"], TWIN: colorsys.hsv_to_rgb(hue, rng.uniform(0.8, 0.95), rng.uniform(0.65, 0.9))}
        physics = {**physics, "colours": colours}
    conditions = {n: c for unit, condition in units for n, c in zip(unit, _each(condition), strict=False)}
    return PerceptionScene(
        Task(state.objects, state, frozenset(), physics, int(rng.integers(2**31))), conditions, {**BLOCK_HUES, **hues}
    )


def _each(condition: str) -> tuple[str, str]:
    return (UPPER, LOWER) if condition == UPPER else (condition, condition)


def _draw_names(rng: np.random.Generator) -> tuple[list[str], str]:
    count = int(rng.integers(2, 6))
    twin = count == 5 or rng.random() < 0.4
    names = sorted(rng.choice(list(BLOCK_HUES), count - twin, replace=False).tolist())
    return [*names, TWIN] if twin else names, str(rng.choice(names))


def _draw_units(rng: np.random.Generator, names: list[str]) -> list[tuple[tuple[str, ...], str]]:
    """Blocks alone or in pairs, each with its condition."""
    left = [str(n) for n in rng.permutation(names)]
    units: list[tuple[tuple[str, ...], str]] = []
    while left:
        if len(left) > 1 and rng.random() < 0.4:
            units.append(((left.pop(), left.pop()), str(rng.choice(PAIRS))))
        else:
            units.append(((left.pop(),), str(rng.choice(SINGLES))))
    return units


def _place(
    rng: np.random.Generator,
    box: np.ndarray,
    sizes: Mapping[str, np.ndarray],
    units: list[tuple[tuple[str, ...], str]],
) -> dict[str, np.ndarray] | None:
    """Features of every block, or None where they got too near to each other."""
    corners = iter(rng.permutation(4))
    placed: dict[str, np.ndarray] = {}
    taken: list[tuple[np.ndarray, float]] = []
    for unit, condition in units:
        first = unit[0]
        width = float(sizes[first][0])
        outside = condition == TABLE or (condition in PAIRS and rng.random() < 0.4)
        if condition == CORNER:
            x, y, yaw = corner_pose(rng, box, width, int(next(corners)))
        elif condition == WALL:
            x, y, yaw = wall_pose(rng, box, width, int(rng.integers(4)))
        elif outside:
            x, y, yaw = free_on_table(rng, box)
        else:
            x, y, yaw = free_in_box(rng, box, width)
        members = [((x, y, yaw), first)]
        if condition == TOUCHING:
            c, s = np.cos(yaw), np.sin(yaw)
            along, across = width + rng.uniform(0.0002, 0.001), rng.uniform(-0.4, 0.4) * width
            beside = (x + c * along - s * across, y + s * along + c * across, yaw)
            if not outside and np.any(np.abs(beside[:2]) > box[7:9] / 2 - 0.75 * width):
                return None
            members.append((beside, unit[1]))
        for (px, py, pyaw), name in members:
            here, radius = np.array([px, py]), 0.71 * width
            if any(np.linalg.norm(here - other) < radius + r + BETWEEN for other, r in taken):
                return None
            placed[name] = block_features(box, (px, py, pyaw), sizes[name], outside)
        taken += [(np.array(place[:2]), 0.71 * width) for place, _ in members]
        if condition == UPPER:
            placed[first], placed[unit[1]] = _stack(rng, placed[first], sizes[first], sizes[unit[1]])
    return placed


def _stack(
    rng: np.random.Generator, features: np.ndarray, upper: np.ndarray, lower: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Features of a block seated on another one that stands where the first was put, as a hand leaves it."""
    below = np.concatenate([features[:7], lower])
    below[2] += (lower[2] - upper[2]) / 2
    # Turned by 0.04 rad the stud takes up a third of its play.
    slack = 0.6 * CLEARANCE
    offset = np.array([*rng.uniform(-slack, slack, 2), (lower[2] + upper[2]) / 2 + 0.0003])
    turn = spatial.rotation_about("z", rng.integers(4) * np.pi / 2 + rng.uniform(-0.04, 0.04))
    above = spatial.pose_from_features(below[:7]) @ spatial.transform(turn, offset)
    return np.concatenate([spatial.features_from_pose(above), upper]), below
