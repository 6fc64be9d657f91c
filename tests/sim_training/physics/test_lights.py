"""Shadows in rendered pictures."""

from __future__ import annotations

import numpy as np

from resync_robot.core.rig import load_rig
from resync_robot.sim_training.domains import find_domain, world_task
from resync_robot.sim_training.physics.lights import HARD, TRAINED, UNSEEN, draw_lighting
from resync_robot.sim_training.physics.world import SimWorld
from tests import scenes

RIG = load_rig()


def rendered(texels: int) -> np.ndarray:
    """(240, 424) brightness from the front, a lamp on the robot's left."""
    lamp = {"direction": (0.0, -0.8, -1.0), "colour": (1.6, 1.6, 1.6)}
    light = {"ambient": 0.1, "lamps": [lamp], "texels": texels}
    world = SimWorld(scenes.scene({"b0": (0.0, 0.0)}, light=light), RIG, rendered=True)
    return world.render("front").colour.astype(float).mean(-1)


def test_a_lamp_casts_dark_shadows_that_are_soft_where_its_map_is_coarse() -> None:
    lit, hard, soft = (rendered(texels) for texels in (0, 1024, 128))
    fell = lit - hard
    assert (fell > 40).mean() > 0.02, "the walls, and the hand over them"
    assert (fell < 4).mean() > 0.5, "what no shadow falls on is as before"
    # In between light and shade there is hardly anything where shadows are hard.
    between = [((lit - shaded > 15) & (lit - shaded < 45)).sum() for shaded in (hard, soft)]
    assert between[1] > 1.5 * between[0]


def test_no_light_burns_a_picture_out() -> None:
    for ranges in (TRAINED, UNSEEN, HARD):
        for seed in range(40):
            light = draw_lighting(np.random.default_rng(seed), ranges)["light"]
            # What falls on a white surface that faces all lamps.
            assert light["ambient"] + sum(max(lamp["colour"]) for lamp in light["lamps"]) / np.pi < 1.2


def test_hard_light_changes_nothing_but_light_and_camera() -> None:
    domain = find_domain("cornered-insertion-s")
    usual, hard = (world_task(domain, "s1", 3, 0, worlds=w) for w in ("usual", "hard"))
    assert usual.initial == hard.initial
    changed = {k for k in usual.physics if usual.physics[k] != hard.physics[k]}
    assert changed == {"light", "camera"} and hard.physics["light"]["texels"] == 1024
    assert hard == world_task(domain, "s1", 3, 0, worlds="hard")
