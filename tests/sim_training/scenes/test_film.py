"""The scene of a film shows things where they were recorded, whatever the arm."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from resync_robot.core import fittings
from resync_robot.core.episode_records import EpisodeMeta
from resync_robot.core.machines import ARMS
from resync_robot.core.recorded_rig import RecordedRig
from resync_robot.core.rig import load_rig
from resync_robot.core.vocabulary import BLOCK, BOX, DRAWER, LID
from resync_robot.sim_training.scenes.film import FilmScene, view_of
from tests import furnished_scenes as furnished

RIG = load_rig()
RECORDED = RecordedRig(
    RIG.arm.facts, RIG.arm.world_T_base, RIG.gripper.tip_offset, RIG.gripper.finger_thickness,
    RIG.gripper.finger_width, {},
)  # fmt: skip
B0, TRAY = BLOCK("b0"), BOX("box")
BLOCK_AT = np.array([0.45, -0.10, 0.03, 1, 0, 0, 0, 0.06, 0.06, 0.045])
TRAY_AT = np.array([0.45, 0.0, 0.005, 1, 0, 0, 0, 0.3, 0.3, 0.11, 0.03])
SIZE = 240, 160


def red(picture: np.ndarray) -> np.ndarray:
    """(n, 2) px of what is red."""
    colours = picture.astype(int)
    rows, columns = np.nonzero((colours[..., 0] - colours[..., 1] > 60) & (colours[..., 0] - colours[..., 2] > 60))
    return np.column_stack([columns, rows])


@pytest.fixture(scope="module")
def scene() -> FilmScene:
    return FilmScene(RECORDED, *SIZE)


def test_a_block_is_where_it_was_recorded_and_goes_when_it_is_gone(scene: FilmScene) -> None:
    for x in (0.45, 0.75):
        at = BLOCK_AT.copy()
        at[0] = x
        seen = red(scene.picture(RIG.arm.home, 0.08, {B0: at, TRAY: TRAY_AT}))
        assert len(seen) > 15
        np.testing.assert_allclose(seen.mean(0), scene.pixels(at[None, :3])[0], atol=4)
    assert not len(red(scene.picture(RIG.arm.home, 0.08, {TRAY: TRAY_AT})))


def test_the_arm_casts_a_shadow_and_follows_its_joints(scene: FilmScene) -> None:
    home = scene.picture(RIG.arm.home, 0.08, {}).astype(int)
    turned = scene.picture(RIG.arm.home + np.array([1.0, 0, 0, 0, 0, 0]), 0.08, {}).astype(int)
    table = scene.picture(RIG.arm.home + np.array([np.pi, 0, 0, 0, 0, 0]), 0.08, {}).astype(int)
    assert (np.abs(home - turned).max(-1) > 20).mean() > 0.02
    # Wood that is darker than the same wood without the arm over it, and still wood: warmer than it is blue.
    darker = (table - home).min(-1) > 12
    assert (darker & (home[..., 0] - home[..., 2] > 5)).sum() > 40


@pytest.mark.parametrize("model", ["ur3e", "ur10e"])
def test_every_arm_is_shown(model: str) -> None:
    small = FilmScene(replace(RECORDED, arm=ARMS[model]), *SIZE)
    empty = small.pixels(RIG.arm.world_T_base[None, :3, 3] + [0, 0, 0.06])[0].astype(int)
    picture = small.picture(RIG.arm.home, 0.08, {}).astype(int)
    assert np.ptp(picture[empty[1], empty[0]]) < 40, "the grey base of the arm"


def test_the_machine_is_read_from_the_recording() -> None:
    meta = EpisodeMeta.of(RIG, library_hash="", domain="", scenario="", goal="", seed=0, backend="sim")

    class Recording:
        path = "episode.mcap"

        def __init__(self, rig: Any) -> None:
            self.meta = replace(meta, rig=rig)

    read = RecordedRig.of(Recording({**meta.rig, "hues": {"b0": 0.3}}))  # type: ignore[arg-type]
    assert read.hues == {"b0": 0.3} and read.arm is RIG.arm.facts
    flange = RIG.arm.world_T_base @ RIG.arm.kinematics.forward(RIG.arm.home)
    np.testing.assert_allclose(read.frames(RIG.arm.home)[-1], flange, atol=1e-12)


def greens(picture: np.ndarray) -> np.ndarray:
    """(n, 2) px of what is green: the cabinet."""
    colours = picture.astype(int)
    rows, columns = np.nonzero((colours[..., 1] - colours[..., 2] > 25) & (colours[..., 1] - colours[..., 0] > 10))
    return np.column_stack([columns, rows])


def test_a_lid_lies_where_it_was_recorded_and_a_drawer_slides_out_of_a_cabinet_that_stays() -> None:
    scene = FilmScene(RECORDED, *SIZE, view=view_of([LID("lid")]))
    lid = np.array([0.55, -0.45, 0.01, 1, 0, 0, 0, *fittings.LID.size])
    pictures = {}
    for opening in (0.0, fittings.DRAWER.travel):
        drawer = furnished.drawer_features(opening)
        pictures[opening] = scene.picture(RIG.arm.home, 0.08, {LID("lid"): lid, DRAWER("drawer"): drawer}).astype(int)
    shut, pulled = pictures.values()
    middle = scene.pixels(lid[None, :3])[0].round().astype(int)
    assert shut[middle[1], middle[0], 2] - shut[middle[1], middle[0], 1] > 25, "purple"
    cabinets = [greens(p) for p in (shut, pulled)]
    assert len(cabinets[0]) > 200
    np.testing.assert_allclose(cabinets[0].mean(0), cabinets[1].mean(0), atol=4)
    assert (np.abs(shut - pulled).max(-1) > 30).sum() > 60, "the drawer"
    empty = scene.picture(RIG.arm.home, 0.08, {})
    assert not len(greens(empty))
