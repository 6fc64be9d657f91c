from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from resync_robot.core import spatial
from resync_robot.core.errors import PerceptionError, UnknownNameError
from resync_robot.core.rig import Rig
from resync_robot.core.state import State
from resync_robot.core.vocabulary import BLOCK
from resync_robot.deployment.uncertain_atoms import samples
from resync_robot.perception.belief import Belief
from resync_robot.perception.blocks import STOREY_SIGMA, BlockEstimate, Glimpse
from resync_robot.perception.naming import MissingObjectsError, UnsettledSceneError
from resync_robot.perception.objects import SceneEstimate
from resync_robot.perception.pose import HEIGHT_SIGMA, tie_height, yaw_variance_of
from resync_robot.sim_training.domains.cornered_insertion_s.domain import on
from tests.perception.estimates import B0, B1, FLOOR, HEIGHT, THE_BOX, WIDTH, R, block, box, grasp, robot, scene


def test_nothing_is_known_before_a_scan(belief: Belief) -> None:
    with pytest.raises(PerceptionError, match="no scan was made"):
        belief.state(robot())


def test_a_block_that_the_catalogue_does_not_have_is_refused(rig: Rig) -> None:
    with pytest.raises(UnknownNameError, match="b9"):
        Belief(R, THE_BOX, (BLOCK("b9"),), rig)


def test_a_scan_becomes_a_state_with_covariance(belief: Belief) -> None:
    state = belief.update(scene(block("b0", 0.45, 0.05), block("b1", 0.45, 0.30, 0.0)), robot())
    assert set(state.objects) == {R, THE_BOX, B0, B1}
    assert state.get(B0, "x", "y") == pytest.approx([0.45, 0.05])
    assert state.covariance(B0) is not None
    assert state.covariance(R) is None
    assert belief.report.seen == ("b0", "b1")


def test_sizes_are_averaged_and_poses_replaced(belief: Belief) -> None:
    belief.update(scene(block("b0", 0.45, 0.05), block("b1", 0.45, 0.30, 0.0)), robot())
    wider = block("b0", 0.47, 0.05)
    wider.features[7:9] = WIDTH + 0.002
    state = belief.update(scene(wider, block("b1", 0.45, 0.30, 0.0)), robot())
    assert state.get(B0, "size_x")[0] == pytest.approx(WIDTH + 0.001)
    assert state.get(B0, "x")[0] == pytest.approx(0.47)


def test_the_quarter_turn_nearest_to_the_last_one_is_kept(belief: Belief) -> None:
    belief.update(scene(block("b0", 0.45, 0.05, yaw=0.75), block("b1", 0.45, 0.30, 0.0)), robot())
    state = belief.update(scene(block("b0", 0.45, 0.05, yaw=-0.76), block("b1", 0.45, 0.30, 0.0)), robot())
    assert float(spatial.yaw_of(state[B0][3:7])) == pytest.approx(np.pi / 2 - 0.76)


def test_the_held_block_needs_not_be_seen(belief: Belief) -> None:
    belief.update(scene(block("b0", 0.45, 0.05), block("b1", 0.45, 0.30, 0.0)), robot())
    grasp(belief, 0.45, 0.05)
    state = belief.update(scene(block("b1", 0.46, 0.30, 0.0)), robot(0.46, 0.0, 0.33, WIDTH))
    assert belief.report.held == ("b0",)
    assert state.get(B0, "z")[0] == pytest.approx(0.33, abs=0.001)


def test_a_block_under_a_tower_keeps_a_wider_estimate(belief: Belief) -> None:
    before = belief.update(scene(block("b0", 0.45, 0.05), block("b1", 0.45, 0.30, 0.0)), robot())
    after = belief.update(scene(block("b1", 0.451, 0.05, FLOOR + HEIGHT, stacked=True)), robot())
    assert belief.report.hidden == ("b0",)
    assert np.array_equal(after[B0], before[B0])
    assert after.covariance(B0)[0, 0] > 4 * before.covariance(B0)[0, 0]


def test_a_glimpse_of_the_side_moves_the_hidden_block_under_its_cover(belief: Belief) -> None:
    belief.update(scene(block("b0", 0.45, 0.05), block("b1", 0.45, 0.30, 0.0)), robot())
    state = belief.update(
        scene(block("b1", 0.52, 0.0, FLOOR + HEIGHT, stacked=True), glimpses=(Glimpse("b0", np.array([0.53, 0.01])),)),
        robot(),
    )
    assert state.get(B0, "x", "y", "z") == pytest.approx([0.52, 0.0, FLOOR + HEIGHT / 2], abs=0.001)


def test_a_tower_known_from_the_first_scan(belief: Belief) -> None:
    state = belief.update(
        scene(block("b1", 0.52, 0.0, FLOOR + HEIGHT, stacked=True), glimpses=(Glimpse("b0", np.array([0.53, 0.01])),)),
        robot(),
    )
    assert state.get(B0, "x", "y", "z") == pytest.approx([0.52, 0.0, FLOOR + HEIGHT / 2], abs=0.003)
    assert np.sqrt(state.covariance(B0)[9, 9]) >= 0.002


@pytest.mark.parametrize("cover", [block("b1", 0.52, 0.05, FLOOR + HEIGHT, stacked=True), block("b1", 0.45, 0.05)])
def test_a_block_that_nothing_hides_is_missing(belief: Belief, cover: BlockEstimate) -> None:
    belief.update(scene(block("b0", 0.45, 0.05), block("b1", 0.45, 0.30, 0.0)), robot())
    with pytest.raises(MissingObjectsError, match="did not find b0") as error:
        belief.update(scene(cover), robot())
    assert error.value.names == ("b0",)
    assert error.value.seen == ("b1",)
    assert belief.state(robot()).get(B0, "x", "y") == pytest.approx([0.45, 0.05])


def test_never_seen_is_missing_and_has_no_features(belief: Belief) -> None:
    with pytest.raises(MissingObjectsError, match="b0"):
        belief.update(scene(block("b1", 0.45, 0.30, 0.0)), robot())
    assert B0 not in belief.state(robot())


def test_a_tipped_block_is_named(belief: Belief) -> None:
    belief.update(scene(block("b0", 0.45, 0.05, upright=False), block("b1", 0.45, 0.30, 0.0)), robot())
    assert belief.report.tipped == ("b0",)


def test_a_tipped_block_is_not_known_to_be_upright_nor_to_carry_anything(belief: Belief) -> None:
    upper = block("b1", 0.45, 0.05, FLOOR + HEIGHT, stacked=True)
    belief.update(scene(block("b0", 0.45, 0.05), block("b1", 0.45, 0.30, 0.0)), robot())
    belief.update(scene(block("b0", 0.45, 0.05, upright=False), upper), robot())
    tipped = belief.state(robot())
    assert 0.1 < share_on(tipped, "b1", "b0") < 0.9
    leaning = [s.get(B0, "qx", "qy") for s in samples(tipped, 200)]
    assert np.degrees(2 * np.std(leaning, axis=0)).min() > 20
    # Seen upright, it is known again.
    assert share_on(belief.update(scene(block("b0", 0.45, 0.05), upper), robot()), "b1", "b0") == 1.0


def share_on(state: State, upper: str, lower: str, count: int = 400) -> float:
    """Of the poses that a state allows, those with one block seated on another."""
    return float(np.mean([on(s, (BLOCK(upper), BLOCK(lower))) for s in samples(state, count)]))


@pytest.mark.parametrize("storeys", [2, 3])
def test_that_a_tower_seen_at_once_is_one_is_not_in_doubt(rig: Rig, storeys: int) -> None:
    belief = Belief(R, THE_BOX, [BLOCK(f"b{i}") for i in range(storeys)], rig)
    top = block(f"b{storeys - 1}", 0.52, 0.0, FLOOR + (storeys - 1) * HEIGHT, stacked=True)
    tie_height(top.covariance, STOREY_SIGMA * np.sqrt(1 - 1 / storeys), HEIGHT_SIGMA)
    glimpses = tuple(Glimpse(f"b{i}", np.array([0.525, 0.005])) for i in range(storeys - 1))
    state = belief.update(scene(top, glimpses=glimpses), robot())
    order = sorted(state.of_type(BLOCK), key=lambda b: -state.get(b, "z")[0])
    for upper, lower in pairwise(order):
        assert share_on(state, upper.name, lower.name) > 0.95


@pytest.mark.parametrize("unseated", [0.0, 0.012])
def test_nor_is_one_whose_blocks_were_measured_before(belief: Belief, unseated: float) -> None:
    belief.update(scene(block("b0", 0.45, 0.05), block("b1", 0.5, -0.1)), robot())
    cover = block("b1", 0.452, 0.051, FLOOR + HEIGHT + unseated, stacked=True)
    state = belief.update(scene(cover, glimpses=(Glimpse("b0", np.array([0.451, 0.05])),)), robot())
    share = share_on(state, "b1", "b0")
    assert share > 0.99 if unseated == 0.0 else share < 0.01


def test_a_height_that_is_off_moves_the_middle_and_leaves_the_face_it_is_reckoned_from() -> None:
    for sign, from_top in ((1, True), (-1, False)):
        covariance = np.zeros((10, 10))
        tie_height(covariance, 0.004, 0.0005, from_top)
        assert np.linalg.eigvalsh(covariance).min() > -1e-15
        near, far = (np.eye(10)[2] + side * sign * np.eye(10)[9] / 2 for side in (1, -1))
        assert np.sqrt(near @ covariance @ near) == pytest.approx(0.0005)
        assert np.sqrt(far @ covariance @ far) == pytest.approx(np.hypot(0.0005, 0.004))


def test_another_look_takes_the_place_of_the_last_one(belief: Belief) -> None:
    belief.update(scene(block("b0", 0.45, 0.05), block("b1", 0.45, 0.30, 0.0)), robot())
    cover = block("b1", 0.451, 0.05, FLOOR + HEIGHT, stacked=True)
    cover.features[7:9] = WIDTH + 0.002
    once = belief.update(scene(cover), robot())
    for _ in range(2):
        again = belief.update(scene(cover), robot(), again=True)
        assert again == once
        for thing in (B0, B1):
            np.testing.assert_array_equal(again.covariance(thing), once.covariance(thing))
    more = belief.update(scene(cover), robot())
    assert more.covariance(B0)[0, 0] > once.covariance(B0)[0, 0], "another scan later is another matter"


def test_a_lower_block_never_measured_stays_so_however_often_it_is_looked_at(belief: Belief) -> None:
    glimpsed = scene(block("b1", 0.52, 0.0, FLOOR + HEIGHT), glimpses=(Glimpse("b0", np.array([0.53, 0.01])),))
    once = belief.update(glimpsed, robot())
    assert np.sqrt(once.covariance(B0)[9, 9]) == pytest.approx(0.005)
    again = belief.update(glimpsed, robot(), again=True)
    np.testing.assert_array_equal(again.covariance(B0), once.covariance(B0))


def test_another_look_finds_what_the_first_one_missed_as_if_it_had_not(belief: Belief) -> None:
    both = scene(block("b0", 0.45, 0.05), block("b1", 0.45, 0.30, 0.0))
    with pytest.raises(MissingObjectsError):
        belief.update(scene(block("b1", 0.45, 0.30, 0.0)), robot())
    again = belief.update(both, robot(), again=True)
    grasp(belief, 0.45, 0.05)
    assert again[B0] == pytest.approx(both.blocks["b0"].features)
    # A hand that seemed empty at first sight holds its block after the second.
    with pytest.raises(MissingObjectsError, match="b1"):
        belief.update(scene(block("b0", 0.52, 0.01)), robot(0.46, 0.0, 0.33, WIDTH))
    assert belief.held is None
    belief.update(scene(block("b1", 0.46, 0.30, 0.0)), robot(0.46, 0.0, 0.33, WIDTH), again=True)
    assert belief.held == B0


def test_what_should_be_there_and_is_not_seen_may_have_moved(belief: Belief) -> None:
    before = belief.update(scene(block("b0", 0.45, 0.05), block("b1", 0.45, 0.30, 0.0)), robot())
    wide = []
    for _ in range(2):
        with pytest.raises(MissingObjectsError):
            belief.update(scene(block("b1", 0.45, 0.30, 0.0)), robot())
        wide.append(belief.state(robot()).covariance(B0))
    assert np.sqrt(np.diag(wide[0])[:2]) == pytest.approx(0.02)
    assert np.sqrt(yaw_variance_of(wide[0])) == pytest.approx(0.3)
    np.testing.assert_allclose(wide[0], wide[1])
    np.testing.assert_array_equal(belief.state(robot()).covariance(B1), before.covariance(B1))


def test_both_what_is_missing_and_what_was_seen_twice_are_named(belief: Belief) -> None:
    belief.update(scene(block("b0", 0.45, 0.05), block("b1", 0.45, 0.30, 0.0)), robot())
    twice = SceneEstimate(box(), {"b0": block("b0", 0.52, 0.15)}, {}, surplus=(block("b0", 0.5, -0.15),))
    with pytest.raises(UnsettledSceneError, match=r"did not find b1.*2 things that may be b0") as error:
        belief.update(twice, robot())
    assert error.value.names == ("b1", "b0")


@pytest.mark.parametrize("middle, bottom", [("b0", "b1"), ("b1", "b0")])
def test_two_blocks_hidden_under_a_third_stand_on_each_other(rig: Rig, middle: str, bottom: str) -> None:
    belief = Belief(R, THE_BOX, (B0, B1, BLOCK("b2")), rig)
    belief.update(
        scene(block(bottom, 0.52, 0.0), block(middle, 0.45, 0.30, FLOOR + HEIGHT), block("b2", 0.4, -0.3)), robot()
    )
    glimpses = tuple(Glimpse(n, np.array([0.525, 0.005])) for n in ("b0", "b1"))
    state = belief.update(scene(block("b2", 0.52, 0.0, FLOOR + 2 * HEIGHT, stacked=True), glimpses=glimpses), robot())
    heights = [state.get(BLOCK(n), "z")[0] for n in (bottom, middle, "b2")]
    assert heights == pytest.approx([FLOOR + (i + 0.5) * HEIGHT for i in range(3)], abs=0.001)


@pytest.mark.parametrize("unseated", [0.0, 0.012])
def test_a_cover_that_lies_on_the_stud_is_not_believed_to_be_seated(belief: Belief, unseated: float) -> None:
    belief.update(scene(block("b0", 0.45, 0.05), block("b1", 0.5, -0.1)), robot())
    cover = block("b1", 0.452, 0.051, FLOOR + HEIGHT + unseated, stacked=True)
    glimpse = Glimpse("b0", np.array([0.451, 0.05]))
    state = belief.update(scene(cover, glimpses=(glimpse,)), robot())
    above, beneath = state.get(B1, "z")[0], state.get(B0, "z")[0]
    assert above - beneath == pytest.approx(HEIGHT + unseated, abs=0.001)


def test_what_cannot_have_changed_is_as_it_was_and_needs_not_be_seen(belief: Belief) -> None:
    before = belief.update(scene(block("b0", 0.45, 0.05), block("b1", 0.45, 0.30, 0.0)), robot())
    after = belief.update(scene(block("b0", 0.50, 0.0)), robot(), changed=[B0])
    assert after.get(B0, "x", "y") == pytest.approx([0.50, 0.0])
    assert np.array_equal(after[B1], before[B1]) and np.array_equal(after.covariance(B1), before.covariance(B1))
    # What the better look knew is not given away for two pictures from afar.
    again = belief.update(scene(block("b0", 0.50, 0.0), block("b1", 0.453, 0.30, 0.0)), robot(), changed=[B0])
    assert np.array_equal(again[B1], before[B1])
    with pytest.raises(MissingObjectsError, match="did not find b0"):
        belief.update(scene(block("b1", 0.45, 0.30, 0.0)), robot(), changed=[B0])


def test_what_is_seen_elsewhere_has_changed_whatever_was_thought(belief: Belief) -> None:
    belief.update(scene(block("b0", 0.45, 0.05), block("b1", 0.45, 0.30, 0.0)), robot())
    after = belief.update(scene(block("b0", 0.45, 0.05), block("b1", 0.50, 0.25, 0.0)), robot(), changed=[B0])
    assert after.get(B1, "x", "y") == pytest.approx([0.50, 0.25])


def test_a_block_that_was_left_alone_may_hide_another(belief: Belief) -> None:
    tower = scene(
        block("b1", 0.52, 0.0, FLOOR + HEIGHT, stacked=True), glimpses=(Glimpse("b0", np.array([0.52, 0.0])),)
    )
    belief.update(tower, robot())
    belief.update(tower, robot(), changed=[B0])
    assert belief.report.hidden == ("b0",) and not belief.report.missing
