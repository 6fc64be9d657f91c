"""Demonstrations: rendered recoveries, and segments that hold what was executed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from resync_robot.core import spatial
from resync_robot.core.rig import load_rig
from resync_robot.learning.camera_view import (
    BLOCK_NAMES,
    EXECUTE,
    GAPS,
    PICTURE,
    VIEWS,
    Prediction,
    to_hand,
    window_at,
)
from resync_robot.learning.failures import PairGaussian
from resync_robot.learning.recovery_policy import BLOCK, STUD, TIP, wall_gaps
from resync_robot.perception.crop import cut_out
from resync_robot.sim_training.demonstrations.recoveries import RenderedRecovery, tilted
from resync_robot.sim_training.demonstrations.rollouts import (
    RolloutSettings,
    Teacher,
    demonstrate,
    look_around,
    try_student,
)
from resync_robot.sim_training.demonstrations.starts import Start, draw_start
from resync_robot.sim_training.domains import find_domain
from resync_robot.sim_training.domains.cornered_insertion_s.corner import CORNER
from resync_robot.sim_training.physics.world import SimWorld
from tests import scenes

RIG = load_rig()
DOMAIN = find_domain("cornered-insertion-s")
CORNERED = Start(scenes.scene({"b0": (scenes.CORNER, scenes.CORNER)}), scenes.B0)
FREE = Start(scenes.scene({"b0": (0.0, 0.0)}), scenes.B0)


def gaussians() -> dict[str, PairGaussian]:
    rng = np.random.default_rng(0)
    deep = [np.array([0.001, 0.002, 0.0, 1.0]) + rng.normal(0, 0.0003, 4) for _ in range(20)]
    clear = [np.array([0.05, 0.06, 0.0, 1.0]) + rng.normal(0, 0.003, 4) for _ in range(20)]
    return {"before": PairGaussian.fit(deep, CORNER.resolution), "after": PairGaussian.fit(clear, CORNER.resolution)}


NEEDED = 0.040


def freed(seen: torch.Tensor) -> torch.Tensor:
    """Room to both walls, upright, and the hand out of the way."""
    return (seen[:, :2].min(1).values > 10 * NEEDED) & (seen[:, 4] > 0.5) & (seen[:, 14] > 0.98)


STILL = Teacher(lambda seen: torch.zeros(len(seen), 3), freed)
UPWARDS = Teacher(lambda seen: torch.tensor([[0.0, 0.0, 1.0]]).expand(len(seen), 3), freed)


@pytest.fixture(scope="module")
def recovery() -> RenderedRecovery:
    return RenderedRecovery(CORNERED, RIG, 0.9, seed=0, still=True)


def test_starts_are_failures_middles_and_ends_and_the_same_for_the_same_seed() -> None:
    starts = [draw_start(DOMAIN, gaussians(), seed) for seed in range(60)]
    gaps = []
    for start in starts:
        block, box = start.task.initial[start.block], start.task.initial[scenes.THE_BOX]
        row = torch.as_tensor(np.concatenate([np.zeros(6), block, box]), dtype=torch.float32)[None]
        gaps.append(float(wall_gaps(row).min()))
    assert sum(g < 0.004 for g in gaps) > 25 and sum(0.004 < g < 0.04 for g in gaps) > 5
    assert sum(g > 0.04 for g in gaps) >= 2
    assert {s.block.name for s in starts} >= {"b0", "b1", "b2"}
    again = draw_start(DOMAIN, gaussians(), 7)
    assert again.task.initial == starts[7].task.initial and again.block == starts[7].block
    assert all(
        float(wall_gaps(_row(s)).min()) < 0.01
        for s in (draw_start(DOMAIN, gaussians(), n, failed_only=True) for n in range(10))
    )


def _row(start: Start) -> torch.Tensor:
    values = np.concatenate([np.zeros(6), start.task.initial[start.block], start.task.initial[scenes.THE_BOX]])
    return torch.as_tensor(values, dtype=torch.float32)[None]


def test_a_window_shows_what_the_whole_picture_shows_there() -> None:
    world = SimWorld(CORNERED.task, RIG, rendered=True)
    tip = RIG.tip_pose(RIG.arm.home)[:3, 3]
    for view in VIEWS:
        camera = RIG.camera(view)
        window = window_at(camera, RIG.camera_pose(camera, RIG.arm.home), tip)
        whole = cut_out(world.render(view), camera, window, PICTURE).colour.astype(float)
        part = world.render_window(view, window, PICTURE, np.eye(4)).colour.astype(float)
        # Scaling softens edges; elsewhere they agree.
        assert np.median(np.abs(whole - part)) <= 2.0 and np.abs(whole - part).mean() < 8.0, view


def test_the_scene_knows_where_the_block_is(recovery: RenderedRecovery) -> None:
    assert recovery.stands
    block = recovery.block()
    np.testing.assert_allclose(block[:2], 0, atol=0.007)
    assert -0.10 < block[2] < -0.05
    np.testing.assert_allclose(block[GAPS], 0.001, atol=2e-4)
    np.testing.assert_allclose(block[5:], 0, atol=1e-3)
    assert recovery.see().pictures.shape == (len(VIEWS), PICTURE, PICTURE, 3)


def test_an_arm_without_lag_goes_where_it_is_sent_and_a_late_one_stays_behind() -> None:
    behind = []
    for lag in (0.0, 0.9):
        scene = RenderedRecovery(FREE, RIG, 0.0, seed=1, still=True)
        scene.lag = torch.tensor([lag])
        goal = scene.sent + [0.0, 0.0, 0.02]
        scene.step(goal)
        behind.append(float(goal[2] - scene.see().tip[2]))
    assert behind[0] < 0.010 < behind[1]


def test_the_scan_knows_the_block_to_a_millimetre_or_two() -> None:
    exact = RenderedRecovery(FREE, RIG, 0.0, seed=0, still=True).scanned
    x, y, z, height = FREE.task.initial.get(FREE.block, "x", "y", "z", "size_z")
    np.testing.assert_allclose(exact.stud, [x, y, z + height / 2 + STUD])
    away = [RenderedRecovery(FREE, RIG, 0.0, seed=seed).scanned.stud - exact.stud for seed in range(12)]
    assert 0.0005 < np.std(away) < 0.003


def test_a_scan_tells_where_the_block_was_or_where_it_is() -> None:
    scene, random = RenderedRecovery(CORNERED, RIG, 0.0, seed=1), torch.Generator().manual_seed(3)
    moved = []
    for _ in range(30):
        scene.freeze(random)
        moved.append(np.linalg.norm(scene.scanned.stud[:2] - scene.x[0, BLOCK][:2].numpy()) > 0.012)
    assert 5 < sum(moved) < 25


def test_how_far_the_hand_carried_a_block_tells_a_fresh_scan_from_an_old_one() -> None:
    scene, random = RenderedRecovery(CORNERED, RIG, 0.0, seed=1), torch.Generator().manual_seed(3)
    assert not scene.see().carried.any()
    errors = {False: list[float](), True: list[float]()}
    for _ in range(40):
        scene.freeze(random)
        carried = scene.see().carried
        there = scene.scanned.stud[:2] + carried
        errors[bool(carried.any())].append(float(np.linalg.norm(there - scene.x[0, BLOCK][:2].numpy())))
    assert min(map(len, errors.values())) > 10
    assert max(errors[False]) < 0.008 and np.median(errors[True]) < 0.008 < max(errors[True])


def test_a_block_goes_along_with_the_hand_that_presses_on_it() -> None:
    scene = RenderedRecovery(CORNERED, RIG, 0.0, seed=1)
    begun = scene.x[0, BLOCK][:2].numpy()
    for lead in ((0.0, 0.0, -0.03), (0.0, 0.0, -0.03), (0.0, 0.0, -0.02), *((-0.01, -0.01, -0.005),) * 4):
        scene.step(scene.reach(scene.see().tip + lead))
    moved, carried = scene.x[0, BLOCK][:2].numpy() - begun, scene.see().carried
    assert np.linalg.norm(carried) > 0.01
    assert np.linalg.norm(moved - carried) < 0.5 * np.linalg.norm(carried)


def test_pictures_of_half_of_all_scenes_are_one_step_old() -> None:
    delayed = 0
    for seed in range(12):
        scene = RenderedRecovery(FREE, RIG, 0.0, seed=seed)
        first = scene.see().pictures
        scene.step(scene.sent + [0.0, 0.0, 0.02])
        delayed += bool((scene.see().pictures == first).all())
    assert 2 <= delayed <= 10


def test_a_segment_s_actions_are_the_steps_that_were_carried_out() -> None:
    settings = RolloutSettings(burst_probability=0.3, hold=3)
    found = demonstrate([FREE, FREE], RIG, UPWARDS, seed=3, settings=settings)
    segments = [s for of in found for s in of if s.acts.all()]
    assert segments
    for segment in segments:
        tips, leads = segment.state[:, 6:9].astype(float), segment.state[:, 9:12].astype(float)
        # The box stands square in this scene, so the hand's axes are the world's.
        sent = tips + leads
        np.testing.assert_allclose(np.diff(sent, axis=0), segment.action[:-1], atol=1e-6)
    last = [of[-1] for of in found if of]
    assert all(s.ends and s.recovered[-1] and not s.action[-1].any() for s in last)


def test_a_demonstration_begins_like_a_deployment_with_a_hand_at_rest() -> None:
    calm = RolloutSettings(burst_probability=0.0)
    found = demonstrate([FREE] * 8, RIG, UPWARDS, seed=3, settings=calm)
    low = [s for (s,) in found if not s.recovered[0]]
    assert low and all(np.abs(s.state[0, 9:12]).max() < 1e-3 and s.action[0, 2] > 0.01 for s in low)


def test_a_burst_is_not_recorded_and_splits_the_episode() -> None:
    calm = demonstrate([FREE], RIG, STILL, 5, settings=RolloutSettings(burst_probability=0.0))
    assert [s.ends for s in calm[0]] == [True]


def test_a_failed_episode_leaves_nothing() -> None:
    settings = RolloutSettings(horizon=5, burst_probability=0.0)
    assert demonstrate([CORNERED], RIG, STILL, 5, settings=settings) == [[]]


def test_moments_without_motion_show_blocks_anywhere_and_say_whether_they_are_free() -> None:
    found = look_around([CORNERED] * 6, RIG, STILL, 0, each=4)
    assert found is not None and len(found.state) == 24
    assert not found.acts.any() and not found.ends
    gaps = found.block[:, GAPS].min(1)
    assert gaps.min() < 0.015 and gaps.max() > 0.05
    needed = NEEDED + RolloutSettings().margin
    assert not found.recovered[gaps < needed - 1e-3].any() and found.recovered.any()
    assert not found.free[gaps < NEEDED - 1e-3].any() and (found.free >= found.recovered).all()
    assert look_around([], RIG, STILL, 0) is None


@given(st.integers(0, 3), st.floats(0.0, np.pi / 2), st.floats(0.03, 0.08), st.floats(0.03, 0.08), st.floats(-3, 3))
def test_a_tilted_block_stands_on_one_edge(edge: int, angle: float, width: float, height: float, yaw: float) -> None:
    upright = spatial.transform(spatial.rotation_about("z", yaw), np.array([0.4, 0.1, height / 2]))
    pose = tilted(upright, width, height, edge, angle)
    signs = np.array([[x, y, z, 1.0] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    corners = (pose @ (signs * [width / 2, width / 2, height / 2, 1.0]).T)[2]
    assert np.sort(corners)[:2] == pytest.approx([0, 0], abs=1e-9), "two corners on the floor, none below"
    assert pose[2, 2] == pytest.approx(np.cos(angle), abs=1e-9)


def test_some_moments_without_motion_show_blocks_that_lean_and_call_none_of_them_free() -> None:
    found = look_around([FREE] * 10, RIG, STILL, 0, each=4)
    assert found is not None
    lean = np.hypot(*found.block[:, 5:].T)
    assert 0.1 < (lean > 0.1).mean() < 0.5 and lean.max() > 0.5
    assert not found.recovered[lean > 0.2].any() and found.recovered.any()


def test_demonstrations_end_a_margin_beyond_the_line() -> None:
    nearly = Start(scenes.scene({"b0": (scenes.CORNER - 0.044, scenes.CORNER - 0.044)}), scenes.B0)
    ends = []
    for margin in (0.0, 0.008):
        settings = RolloutSettings(horizon=12, burst_probability=0.0, margin=margin)
        ends.append([bool(of) for of in demonstrate([nearly], RIG, UPWARDS, 5, settings=settings)])
    assert ends == [[True], [False]]


def test_a_teacher_acts_on_the_box_as_it_is_and_only_stops_by_a_narrower_one() -> None:
    seen = []

    def act(x: torch.Tensor) -> torch.Tensor:
        seen.append(x)
        return torch.tensor([[0.0, 0.0, 1.0]]).expand(len(x), 3)

    demonstrate([FREE], RIG, Teacher(act, freed), 5, settings=RolloutSettings(burst_probability=0.0, margin=0.03))
    np.testing.assert_allclose(seen[0][0, :2], 10 * wall_gaps(_row(FREE))[0], atol=0.02)


def test_a_block_within_the_margin_is_free_but_not_a_place_to_stop() -> None:
    nearly = Start(scenes.scene({"b0": (scenes.CORNER - 0.044, scenes.CORNER - 0.044)}), scenes.B0)
    x = RenderedRecovery(nearly, RIG, 0.0, seed=1, still=True).x.clone()
    x[:, TIP][:, 2] += 0.1
    assert [(j.recovered, j.free) for j in STILL.judge(x, margin=0.008)] == [(False, True)]
    assert [(j.recovered, j.free) for j in STILL.judge(x)] == [(True, True)]


@dataclass
class Rising:
    """A student that lifts the hand and says that it is done, rightly or not."""

    done: float = 1.0
    picture: int = PICTURE

    def __call__(self, pictures: np.ndarray, state: np.ndarray) -> Prediction:
        n = len(state)
        assert pictures.shape == (n, len(VIEWS), PICTURE, PICTURE, 3)
        steps = np.tile([0.0, 0.0, 0.01], (n, 8, 1))
        return Prediction(steps, np.full(n, self.done), np.ones(n), np.full((n, len(BLOCK_NAMES)), 0.05))


def test_a_student_is_judged_by_the_truth_not_by_its_word() -> None:
    trials = try_student([CORNERED, FREE], RIG, Rising(), STILL, 0)
    assert [t is not None and t.stopped for t in trials] == [True, True]
    assert [t is not None and t.success for t in trials] == [False, True]
    assert trials[0] is not None and trials[0].steps == EXECUTE


def test_after_a_student_the_teacher_goes_on_and_only_it_is_recorded() -> None:
    found = demonstrate([FREE], RIG, UPWARDS, 11, student=Rising(done=0.0))
    (segment, *_) = found[0]
    assert segment.state[0, 8] > 0.14, "the student had lifted the hand before"


def test_the_teacher_is_called_where_a_student_believes_that_it_is_done() -> None:
    heights = []
    for done in (0.0, 1.0):
        found = demonstrate([FREE], RIG, UPWARDS, 11, student=Rising(done))
        heights.append(found[0][0].state[0, 8])
    assert heights[1] < heights[0] - 0.02


def test_hand_axes_of_a_turned_box_are_the_box_s() -> None:
    task = scenes.scene({"b0": (0.0, 0.0)}, box_yaw=0.15)
    scene = RenderedRecovery(Start(task, scenes.B0), RIG, 0.0, seed=0, still=True)
    assert scene.yaw == pytest.approx(0.15, abs=0.01)
    along = np.array([np.cos(0.15), np.sin(0.15), 0.0])
    np.testing.assert_allclose(to_hand(along, scene.yaw), [1, 0, 0], atol=0.01)


def test_unseen_looks_do_not_change_the_rest_of_a_start() -> None:
    from resync_robot.sim_training.physics.randomise import UNSEEN

    usual = draw_start(DOMAIN, gaussians(), 5)
    unseen = draw_start(DOMAIN, gaussians(), 5, UNSEEN)
    assert usual.task.initial == unseen.task.initial
    assert usual.task.physics["surfaces"] != unseen.task.physics["surfaces"]
    assert replace(usual, task=unseen.task) == unseen
