"""What a lid covers, what rides in the hand, what goes with a drawer: by estimates made by hand, without pictures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from resync_robot.core import spatial
from resync_robot.core.fittings import DRAWER as BUILT
from resync_robot.core.fittings import LID as LID_SHAPE
from resync_robot.core.rig import Rig
from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.core.vocabulary import DRAWER, LID
from resync_robot.deployment.uncertain_atoms import SampledAbstraction
from resync_robot.perception.belief import Belief
from resync_robot.perception.blocks import BlockEstimate, Glimpse
from resync_robot.perception.fittings import FittingEstimate
from resync_robot.perception.ground import Ground
from resync_robot.perception.known import somewhere_in
from resync_robot.perception.naming import MissingObjectsError
from resync_robot.perception.objects import SceneEstimate, SceneEstimator, catalogue_of
from resync_robot.perception.pose import BoxEstimate, box_under, upright_covariance
from resync_robot.planning.abstract import Abstraction
from resync_robot.planning.search import plan
from resync_robot.sim_training.domains.cornered_insertion_l.domain import CORNERED_INSERTION_L, tower
from tests.perception.estimates import B0, B1, FLOOR, HEIGHT, THE_BOX, WIDTH, R, block, box, robot

THE_LID, THE_DRAWER = LID("lid"), DRAWER("drawer")
RIM = FLOOR + 0.105
ABSTRACTION = SampledAbstraction(Abstraction(CORNERED_INSERTION_L.predicates, CORNERED_INSERTION_L.classifiers))


def lid(x: float = 0.48, y: float = 0.0, bottom: float = RIM) -> FittingEstimate:
    size = LID_SHAPE.size
    return FittingEstimate("lid", np.array([x, y, bottom + size[2] / 2, 1, 0, 0, 0, *size]), np.eye(10) * 1e-6)


def drawer(opening: float) -> FittingEstimate:
    """One that opens towards the robot."""
    x, z = 0.5 - BUILT.front[0] / 2 - opening, BUILT.lift + BUILT.front[2] / 2
    covariance = np.zeros((11, 11))
    covariance[:7, :7] = upright_covariance(np.full(3, 1e-6), 1e-6, spatial.quat_from_yaw(np.pi))
    covariance[7, 7] = 2.5e-7
    return FittingEstimate(
        "drawer", np.array([x, 0.42, z, *spatial.quat_from_yaw(np.pi), opening, *BUILT.front]), covariance
    )


def scene(*blocks: BlockEstimate, fittings: tuple[FittingEstimate, ...]) -> SceneEstimate:
    return SceneEstimate(box(), {b.name: b for b in blocks}, {}, fittings={f.name: f for f in fittings})


LIDDED, UNCOVERED = (lid(), drawer(0.0)), (lid(0.55, -0.45, 0.0), drawer(0.0))


@pytest.fixture
def furnished(rig: Rig) -> Belief:
    estimator = SceneEstimator(rig, catalogue_of(rig, furnished=True))
    return Belief(R, THE_BOX, (B0, B1), rig, estimator, (THE_LID, THE_DRAWER))


def atoms(state: State) -> set[str]:
    return {str(a) for a in ABSTRACTION.true_atoms(state)}


def test_what_a_lid_covers_is_somewhere_in_the_box_and_a_plan_begins_with_the_lid(furnished: Belief) -> None:
    state = furnished.update(scene(block("b1", 0.24, -0.5, 0.0), fittings=LIDDED), robot())
    assert furnished.report.covered == ("b0",) and not furnished.report.missing
    rough = state.covariance(B0)
    assert rough is not None and 0.05 < np.sqrt(rough[0, 0]) < 0.10
    assert {a for a in atoms(state) if "b0" in a} == {"Outside(b0)"}, "nothing else is certain of it"
    found = plan(CORNERED_INSERTION_L.operators, state.objects, ABSTRACTION.true_atoms(state), tower("b0", "b1"))
    assert found.steps[0].name == "RemoveLid"
    assert not any(np.linalg.norm(p - state[B0][:2]) < 0.1 for p in furnished.unclear_places()), "no look helps"


def test_once_the_lid_is_off_a_block_is_measured_as_if_it_had_never_been_guessed(furnished: Belief) -> None:
    furnished.update(scene(block("b1", 0.24, -0.5, 0.0), fittings=LIDDED), robot())
    there = block("b0", 0.36, 0.11)
    state = furnished.update(scene(there, block("b1", 0.24, -0.5, 0.0), fittings=UNCOVERED), robot())
    np.testing.assert_allclose(state[B0], there.features)
    assert state.covariance(B0)[0, 0] == pytest.approx(1e-6) and not furnished.report.covered


def test_a_block_that_is_not_under_the_lid_either_is_nowhere(furnished: Belief) -> None:
    furnished.update(scene(block("b1", 0.24, -0.5, 0.0), fittings=LIDDED), robot())
    with pytest.raises(MissingObjectsError, match="did not find b0"):
        furnished.update(scene(block("b1", 0.24, -0.5, 0.0), fittings=UNCOVERED), robot())
    assert B0 not in furnished.state(robot()) and B1 in furnished.state(robot())


def test_without_a_lid_on_the_box_nothing_is_covered(furnished: Belief) -> None:
    with pytest.raises(MissingObjectsError, match="did not find b0"):
        furnished.update(scene(block("b1", 0.24, -0.5, 0.0), fittings=UNCOVERED), robot())


def test_what_only_shows_under_another_block_is_not_as_sure_as_if_it_had_been_measured(furnished: Belief) -> None:
    furnished.update(scene(block("b1", 0.24, -0.5, 0.0), fittings=LIDDED), robot())
    on_it = block("b1", 0.48, 0.0, FLOOR + HEIGHT, stacked=True)
    shown = replace(scene(on_it, fittings=UNCOVERED), glimpses={"b0": Glimpse("b0", np.array([0.48, 0.0]))})
    state = furnished.update(shown, robot())
    assert np.sqrt(state.covariance(B0)[9, 9]) > 0.002 and state[B0][7] == pytest.approx(WIDTH)


def test_a_block_seen_before_keeps_its_place_under_a_lid(furnished: Belief) -> None:
    blocks = block("b0", 0.36, 0.11), block("b1", 0.24, -0.5, 0.0)
    before = furnished.update(scene(*blocks, fittings=UNCOVERED), robot())
    after = furnished.update(scene(blocks[1], fittings=LIDDED), robot())
    assert furnished.report.hidden == ("b0",) and np.array_equal(after[B0], before[B0])
    with pytest.raises(MissingObjectsError, match="b1"):
        furnished.update(scene(fittings=LIDDED), robot())


def test_a_box_that_nobody_sees_is_about_where_its_lid_is_until_it_is_measured(furnished: Belief) -> None:
    catalogue = catalogue_of(furnished._estimator.rig, furnished=True)
    guess = box_under(lid().features, catalogue)
    assert guess is not None and not guess.seen
    assert box_under(lid(bottom=0.0).features, catalogue) is None, "it lies on the table"
    unseen = replace(scene(block("b1", 0.24, -0.5, 0.0), fittings=LIDDED), box=guess)
    state = furnished.update(unseen, robot())
    assert "LidOn(lid)" in atoms(state)
    measured = furnished.update(
        scene(block("b0", 0.36, 0.1), block("b1", 0.24, -0.5, 0.0), fittings=UNCOVERED), robot()
    )
    np.testing.assert_allclose(measured[THE_BOX], box().features)
    again = furnished.update(replace(unseen, box=BoxEstimate(guess.features + 0.01, guess.covariance, False)), robot())
    np.testing.assert_allclose(again[THE_BOX], box().features, err_msg="what was measured is better")


def test_what_is_anywhere_in_the_box_is_inside_its_walls(rig: Rig) -> None:
    known = somewhere_in(box().features, catalogue_of(rig))
    assert np.sqrt(12 * known.covariance[0, 0]) + known.features[7] == pytest.approx(0.30)
    assert known.features[2] - known.features[9] / 2 == pytest.approx(FLOOR)


def test_a_lid_rides_with_the_hand_that_holds_its_knob_and_stays_where_that_lets_go(furnished: Belief) -> None:
    furnished.update(scene(block("b1", 0.24, -0.5, 0.0), fittings=LIDDED), robot())
    tip_z = RIM + LID_SHAPE.size[2] + 0.010
    for opening in (0.06, 0.04, 0.031):
        furnished.state(robot(0.48, 0.0, tip_z, opening))
    assert furnished.held == THE_LID and furnished.grasp_is_certain
    held = furnished.state(robot(0.55, -0.45, 0.25, 0.031))
    assert held[THE_LID][:3] == pytest.approx([0.55, -0.45, 0.25 - tip_z + lid().features[2]], abs=1e-6)
    assert not {a for a in atoms(held) if a.startswith("HandEmpty")}
    down = furnished.state(robot(0.55, -0.45, 0.022, 0.031))
    let_go = furnished.state(robot(0.55, -0.45, 0.30, 0.06))
    assert furnished.held is None and np.array_equal(let_go[THE_LID], down[THE_LID])


def lifted_tower(belief: Belief) -> State:
    """b0 on b1, gripped by the lower one and lifted."""
    upper, lower = block("b0", 0.45, 0.05, FLOOR + HEIGHT), block("b1", 0.45, 0.05)
    belief.update(scene(upper, lower, fittings=UNCOVERED), robot())
    for opening in (0.14, 0.10, WIDTH + 0.001):
        belief.state(robot(0.45, 0.05, FLOOR + HEIGHT / 2, opening))
    return belief.state(robot(0.45, 0.05, 0.30, WIDTH))


def test_what_is_seated_on_a_held_block_rides_on_it(furnished: Belief) -> None:
    state = lifted_tower(furnished)
    assert furnished.held == B1 and furnished.in_hand == (B1, B0)
    assert state[B0][2] - state[B1][2] == pytest.approx(HEIGHT)
    seen = furnished.update(scene(fittings=UNCOVERED), robot(0.45, 0.05, 0.30, WIDTH))
    assert furnished.report.held == ("b1", "b0") and not furnished.report.missing
    assert "HoldingTower(r, b0, b1)" in atoms(seen)


def test_what_was_left_behind_does_not_ride(furnished: Belief) -> None:
    lifted_tower(furnished)
    dropped = block("b0", 0.47, 0.06)
    state = furnished.update(scene(dropped, fittings=UNCOVERED), robot(0.45, 0.05, 0.30, WIDTH))
    assert furnished.in_hand == (B1,)
    assert "Holding(r, b1)" in atoms(state) and "HoldingTower(r, b0, b1)" not in atoms(state)
    assert np.array_equal(furnished.state(robot(0.5, 0.2, 0.30, WIDTH))[B0], state[B0])


def test_a_lower_block_does_not_ride_on_what_is_lifted_off_it(furnished: Belief) -> None:
    furnished.update(
        scene(block("b0", 0.45, 0.05, FLOOR + HEIGHT), block("b1", 0.45, 0.05), fittings=UNCOVERED), robot()
    )
    for opening in (0.14, 0.10, WIDTH + 0.001):
        furnished.state(robot(0.45, 0.05, FLOOR + 1.5 * HEIGHT, opening))
    assert furnished.in_hand == (B0,)


def put_away(belief: Belief, opening: float) -> State:
    """A tower in the middle of what is open of the drawer."""
    x = 0.5 - opening / 2
    upper, lower = block("b0", x, 0.42, BUILT.floor + HEIGHT), block("b1", x, 0.42, BUILT.floor)
    return belief.update(scene(upper, lower, fittings=(UNCOVERED[0], drawer(opening))), robot())


def test_what_stands_in_a_drawer_goes_with_it_and_is_remembered_when_it_is_closed(furnished: Belief) -> None:
    before = put_away(furnished, BUILT.travel)
    goal = {str(a) for a in tower("b0", "b1")}
    assert atoms(before) >= goal - {"DrawerClosed(drawer)"}
    after = furnished.update(scene(fittings=(UNCOVERED[0], drawer(0.0))), robot())
    assert set(furnished.report.hidden) == {"b0", "b1"}
    assert after[B1][0] - before[B1][0] == pytest.approx(BUILT.travel)
    for thing in (B0, B1):
        assert after.covariance(thing)[0, 0] == before.covariance(thing)[0, 0], "nothing was at work in there"
    assert goal <= atoms(after)


def test_a_drawer_that_shows_where_its_block_should_be_hides_none(furnished: Belief) -> None:
    put_away(furnished, BUILT.travel)
    with pytest.raises(MissingObjectsError, match="b0, b1"):
        furnished.update(scene(fittings=(UNCOVERED[0], drawer(BUILT.travel))), robot())


def test_the_ground_is_the_table_the_floor_of_the_box_or_that_of_a_tray(rig: Rig) -> None:
    ground = Ground(catalogue_of(rig), box().features, {"drawer": drawer(BUILT.travel).features})
    for place, height in (((0.24, -0.5), 0.0), ((0.48, 0.0), FLOOR), ((0.42, 0.42), BUILT.floor), ((0.30, 0.42), 0.0)):
        assert ground.height(np.array(place)) == pytest.approx(height)
    assert ground.tray_at(np.array([0.42, 0.42])) == "drawer"
    assert not ground.is_under_cabinet(np.array([0.42, 0.42]), WIDTH)
    assert ground.is_under_cabinet(np.array([0.48, 0.42]), WIDTH), "half of it"


def test_what_a_lid_covers_stays_unknown_when_pictures_are_of_something_else(furnished: Belief) -> None:
    blocks = (block("b1", 0.24, -0.5, 0.0),)
    before = furnished.update(scene(*blocks, fittings=LIDDED), robot())
    opened = (lid(), drawer(BUILT.travel))
    after = furnished.update(scene(*blocks, fittings=opened), robot(), changed=[THE_DRAWER])
    assert furnished.report.covered == ("b0",) and not furnished.report.missing
    assert after.get(THE_DRAWER, "opening")[0] == pytest.approx(BUILT.travel)
    assert np.array_equal(after[B0], before[B0])


def test_lid_and_drawer_are_as_they_were_unless_they_may_have_changed(furnished: Belief) -> None:
    blocks = block("b0", 0.36, 0.11), block("b1", 0.24, -0.5, 0.0)
    before = furnished.update(scene(*blocks, fittings=UNCOVERED), robot())
    # Pictures of a block show them in part, or not at all.
    beside = scene(blocks[0], fittings=(drawer(0.010),))
    after = furnished.update(beside, robot(), changed=[B0])
    for thing in (THE_LID, THE_DRAWER):
        assert np.array_equal(after[thing], before[thing])
    moved = furnished.update(beside, robot(), changed=[THE_DRAWER])
    assert moved.get(THE_DRAWER, "opening")[0] == pytest.approx(0.010)
    with pytest.raises(MissingObjectsError, match="lid"):
        furnished.update(beside, robot(), changed=[THE_LID])


def test_a_box_is_measured_anew_where_it_was_uncovered_and_else_left_as_it_was(furnished: Belief) -> None:
    b1 = block("b1", 0.24, -0.5, 0.0)
    furnished.update(scene(b1, fittings=LIDDED), robot())
    better = replace(box(), features=box().features + 0.002 * np.eye(11)[0])
    seen = replace(scene(block("b0", 0.36, 0.11), b1, fittings=UNCOVERED), box=better)
    for changed, x in (([THE_LID], 0.480), ([THE_LID, THE_BOX], 0.482)):
        assert furnished.update(seen, robot(), changed=changed).get(THE_BOX, "x")[0] == pytest.approx(x)


@pytest.mark.parametrize(("changed", "given"), [(None, False), ([THE_DRAWER], True), ([THE_BOX], False)])
def test_pictures_are_measured_against_the_box_unless_it_is_what_changed(
    furnished: Belief, monkeypatch: pytest.MonkeyPatch, changed: list[Object] | None, given: bool
) -> None:
    catalogue = catalogue_of(furnished._estimator.rig, furnished=True)
    guess = box_under(lid().features, catalogue)
    assert guess is not None
    b1 = block("b1", 0.24, -0.5, 0.0)
    furnished.update(replace(scene(b1, fittings=LIDDED), box=guess), robot())
    boxes: list[BoxEstimate | None] = []

    def estimate(frames: object, known: BoxEstimate | None) -> SceneEstimate:
        boxes.append(known)
        return scene(b1, fittings=LIDDED)

    monkeypatch.setattr(furnished._estimator, "estimate", estimate)
    furnished.update_from_scan([], robot(), changed=changed)
    (known,) = boxes
    assert (known is not None) == given
    # It is reckoned from its lid, and no picture can be put right by it.
    assert known is None or not known.seen
