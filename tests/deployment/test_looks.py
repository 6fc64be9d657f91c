"""Where the robot looks again before it acts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pytest

from resync_robot.core import spatial
from resync_robot.core.joints import JointTarget
from resync_robot.core.rig import load_rig
from resync_robot.core.state import State
from resync_robot.core.symbols import Atom, Object, Predicate
from resync_robot.core.vocabulary import BLOCK
from resync_robot.core.world import CameraFrame
from resync_robot.deployment import world as worlds
from resync_robot.deployment.uncertain_atoms import SampledAbstraction
from resync_robot.deployment.world import MORE_LOOKS, DeployedWorld
from resync_robot.hardware.sim import SimRobot
from resync_robot.perception.belief import ScanReport
from resync_robot.perception.catalogue import Catalogue
from resync_robot.perception.naming import MissingObjectsError
from resync_robot.perception.objects import catalogue_of
from resync_robot.perception.scan import Scan
from resync_robot.planning.abstract import Abstraction
from resync_robot.sim_training.domains.cornered_insertion_l.domain import CORNERED_INSERTION_L
from resync_robot.sim_training.physics.world import SimWorld
from tests import furnished_scenes, scenes
from tests.deployment.pretended import Told, Whole, silent
from tests.perception.raycast import FLOOR, Table

RIG = load_rig()
FURNISHED_TASK = CORNERED_INSERTION_L.scenario("l0").sample(np.random.default_rng(0), 0)
STRIPED = Predicate("Striped", (BLOCK,))
ROUND = len(Scan(RIG).configurations)


class Eye(Whole):
    """A wrist camera that sees a drawn table from wherever the arm was sent."""

    def __init__(self, table: Table) -> None:
        super().__init__("wrist")
        self.table, self.at = table, [RIG.arm.home]

    def capture(self) -> CameraFrame:
        self.asked.append("picture")
        return self.table.picture(self.at[-1])


@dataclass
class Looking:
    """A deployment that looks at a drawn table with one block at x = 0.45."""

    world: DeployedWorld
    eye: Eye
    doubts: list[tuple[dict[str, float], int]]


def looking(monkeypatch: pytest.MonkeyPatch, stripe: float = 1.0, blocks: tuple[str, ...] = ("b0",)) -> Looking:
    """With a predicate that is true of blocks in every other stripe of the table, so wide in m."""
    table = Table(RIG, Catalogue())
    table.block("b0", 0.45, 0.05, FLOOR, 0.2, 0.060, 0.045)
    eye, doubts = Eye(table), []
    monkeypatch.setattr(worlds, "travel", lambda stream, q: eye.at.append(q))

    def striped(state: State, objects: tuple[Object, ...]) -> float:
        return float(state.get(objects[0], "x")[0] // stripe % 2)

    def on_doubt(atoms: Mapping[Atom, float], looks: int) -> None:
        doubts.append(({str(a): p for a, p in atoms.items()}, looks))

    simulated = SimWorld(scenes.scene({name: (0.0, 0.1 * i) for i, name in enumerate(blocks)}), RIG)
    robot = SimRobot(simulated)
    robot.connect()
    abstraction = SampledAbstraction(Abstraction((STRIPED,), {"Striped": striped}))
    world = DeployedWorld(
        robot, {"wrist": eye}, RIG, simulated.task.objects, witness=Told(on_doubt=on_doubt), abstraction=abstraction
    )
    return Looking(world, eye, doubts)


def test_what_is_certain_is_looked_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    certain = looking(monkeypatch)
    certain.world.perceive()
    assert len(certain.eye.asked) == ROUND and not certain.doubts


def test_what_the_hand_carries_is_told_of_wherever_it_goes(monkeypatch: pytest.MonkeyPatch) -> None:
    world = looking(monkeypatch).world
    world.perceive()
    told: list[State] = []
    world._witness = Told(on_seen=told.append)
    measured = replace(world._measure(), opening=0.060)
    monkeypatch.setattr(world, "_measure", lambda: measured)
    world.observe()
    assert not told, "nothing is carried yet"
    world.belief.attach(scenes.B0, RIG.robot_features(measured.q, measured.opening))
    tips = []
    for turned in (0.0, 0.3):
        measured = replace(measured, q=measured.q + [turned, 0, 0, 0, 0, 0])
        tips.append(RIG.tip_pose(measured.q))
        world.observe()
    before, after = (spatial.pose_from_features(state[scenes.B0][:7]) for state in told)
    np.testing.assert_allclose(spatial.inverse(tips[0]) @ before, spatial.inverse(tips[1]) @ after, atol=1e-9)
    assert np.linalg.norm(after[:3, 3] - before[:3, 3]) > 0.05


def test_an_atom_in_doubt_is_looked_at_again_and_then_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    unsure = looking(monkeypatch, 0.0003)
    state = unsure.world.perceive()
    assert len(unsure.eye.asked) == ROUND + 2 * MORE_LOOKS
    ((shares, looks),) = unsure.doubts
    assert looks == 1 + MORE_LOOKS and 0.1 < shares["Striped(b0)"] < 0.9
    # More pictures, less doubt about the place.
    before, after = (s.covariance(scenes.B0)[0, 0] for s in (looking(monkeypatch).world.perceive(), state))
    assert after < before


@pytest.mark.slow
def test_a_block_that_nobody_ever_saw_is_looked_for_everywhere(monkeypatch: pytest.MonkeyPatch) -> None:
    missing = looking(monkeypatch, blocks=("b0", "b1"))
    with pytest.raises(MissingObjectsError, match="did not find b1"):
        missing.world.perceive()
    assert len(missing.eye.asked) == ROUND * (1 + MORE_LOOKS)


@pytest.mark.slow
def test_one_that_was_seen_before_is_looked_for_where_it_stood(monkeypatch: pytest.MonkeyPatch) -> None:
    world = looking(monkeypatch)
    before = world.world.perceive()
    world.eye.table, world.eye.asked = Table(RIG, Catalogue()), []
    told: list[tuple[tuple[str, ...], str]] = []
    world.world._witness = Told(on_unsettled=lambda names, words: told.append((tuple(names), words)))
    after = world.world.perceive()
    assert [names for names, _ in told] == [("b0",)] and "did not find b0" in told[0][1]
    assert after.covariance(scenes.B0)[0, 0] > 100 * before.covariance(scenes.B0)[0, 0], "it may have moved"
    assert len(world.eye.asked) == ROUND + 2 * MORE_LOOKS
    assert world.world.missing == ("b0",)
    assert np.array_equal(after[scenes.B0], before[scenes.B0]), "it keeps its old place"


def test_what_a_plan_may_hang_on_is_looked_at_first(monkeypatch: pytest.MonkeyPatch) -> None:
    world = looking(monkeypatch, 0.0003).world
    true = scenes.scene({"b0": (0.0, 0.0)}).initial
    state = State({o: true[o] for o in true.objects}, {scenes.B0: np.eye(10) * 1e-6})
    badly_seen = [np.array([0.36 + 0.06 * i, -0.25]) for i in range(4)]
    monkeypatch.setattr(world.belief, "unclear_places", lambda: badly_seen)
    first, *_ = world.scan.towards(state.get(scenes.B0, "x", "y"))
    looks = world._where_to_look(state, None)
    np.testing.assert_array_equal(looks[0], first)
    assert len(looks) <= 2 * worlds.MOST_PLACES
    # Nobody knows where to look for what was never seen: everywhere, whatever else is in doubt.
    never = world._where_to_look(state, MissingObjectsError(("b1",), ("b0",)))
    assert len(never) == len(looks) + ROUND
    assert len(world._where_to_look(state, MissingObjectsError(("b0",), ()))) == len(looks)


def stir(seen: Looking, monkeypatch: pytest.MonkeyPatch, x: float, y: float) -> None:
    """A skill sends the hand down to a place of the table."""
    tip = spatial.transform(spatial.rotation_about("x", np.pi), np.array([x, y, 0.05]))
    flange = spatial.inverse(RIG.arm.world_T_base) @ tip @ spatial.inverse(RIG.gripper.flange_T_tip)
    q = RIG.arm.kinematics.inverse_branch(flange, RIG.arm.kinematics.branch_of(RIG.arm.home))
    with monkeypatch.context() as m:
        m.setattr(seen.world.stream, "run", silent)
        seen.world.act(JointTarget(q, 0.0), 0.02)


def test_after_a_skill_only_what_the_hand_may_have_moved_is_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = looking(monkeypatch)
    before = seen.world.perceive()
    stir(seen, monkeypatch, 0.46, 0.02)
    seen.eye.table, seen.eye.asked = Table(RIG, Catalogue()), []
    seen.eye.table.block("b0", 0.48, 0.02, FLOOR, 0.2, 0.060, 0.045)
    after = seen.world.perceive()
    assert len(seen.eye.asked) == 2
    assert after.get(scenes.B0, "x", "y") == pytest.approx([0.48, 0.02], abs=0.002)
    assert np.array_equal(after[scenes.THE_BOX], before[scenes.THE_BOX])
    # What the hand has been near is seen; from there on it counts anew.
    stir(seen, monkeypatch, 0.46, 0.35)
    seen.eye.asked = []
    assert seen.world.perceive()[scenes.B0] == pytest.approx(after[scenes.B0])


def test_after_a_skill_of_a_drawer_only_the_drawer_is_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    catalogue = catalogue_of(RIG, furnished=True)
    depth, thickness = catalogue.drawers["drawer"].cabinet[0], catalogue.drawers["drawer"].front[0]

    def table(opening: float) -> Table:
        drawn = Table(RIG, catalogue)
        drawn.block("b0", 0.45, 0.05, FLOOR, 0.2, 0.060, 0.045)
        drawn.lid("lid", 0.55, -0.46, 0.0, 0.0)
        drawn.drawer("drawer", 0.61, 0.425, np.pi, opening)
        return drawn

    eye, task = Eye(table(0.0)), furnished_scenes.furnished({"b0": (0.0, 0.0)})
    monkeypatch.setattr(worlds, "travel", lambda stream, q: eye.at.append(q))
    robot = SimRobot(SimWorld(task, RIG))
    robot.connect()
    world = DeployedWorld(robot, {"wrist": eye}, RIG, task.objects)
    before = world.perceive()
    assert len(eye.asked) == len(world.scan.configurations)
    seen = Looking(world, eye, [])
    stir(seen, monkeypatch, 0.61 - depth / 2 - thickness - 0.07, 0.425)
    eye.table, eye.asked = table(0.15), []
    after = world.perceive()
    assert len(eye.asked) == 2
    assert after.get(furnished_scenes.THE_DRAWER, "opening")[0] == pytest.approx(0.15, abs=0.002)
    for thing in (scenes.B0, scenes.THE_BOX, furnished_scenes.THE_LID):
        assert np.array_equal(after[thing], before[thing])


@pytest.mark.parametrize(("held", "everywhere"), [(None, False), (scenes.B0, True)])
def test_what_fell_out_of_the_hand_on_the_way_is_looked_for_everywhere(
    monkeypatch: pytest.MonkeyPatch, held: Object | None, everywhere: bool
) -> None:
    """The hand was low somewhere else, and the block was in it on the way."""
    seen = looking(monkeypatch)
    seen.world.perceive()
    stir(seen, monkeypatch, 0.46, 0.35)
    if held is not None:
        seen.world._trace.follow(np.array([0.45, 0.05, 0.3]), [held])
    seen.eye.asked = []
    seen.world.perceive()
    assert (len(seen.eye.asked) >= ROUND) == everywhere


@pytest.mark.slow
def test_what_is_not_where_the_hand_may_have_left_it_is_looked_for_everywhere(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = looking(monkeypatch)
    seen.world.perceive()
    stir(seen, monkeypatch, 0.46, 0.02)
    seen.eye.table, seen.eye.asked = Table(RIG, Catalogue()), []
    seen.world.perceive()
    assert len(seen.eye.asked) == 2 + ROUND + 2 * MORE_LOOKS
    assert seen.world.missing == ("b0",)


def test_a_box_that_was_pushed_is_looked_at_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = looking(monkeypatch)
    before = seen.world.perceive()
    stir(seen, monkeypatch, 0.46, 0.02)
    known = seen.world.belief._known
    moved = known[scenes.THE_BOX].features + np.array([0.02, *[0.0] * 10])
    known[scenes.THE_BOX] = replace(known[scenes.THE_BOX], features=moved)
    seen.eye.asked = []
    after = seen.world.perceive()
    assert len(seen.eye.asked) == 2 + ROUND
    assert after.get(scenes.THE_BOX, "x") == pytest.approx(before.get(scenes.THE_BOX, "x"), abs=0.002)


def test_no_look_is_spent_on_what_a_lid_covers(monkeypatch: pytest.MonkeyPatch) -> None:
    world = looking(monkeypatch, 0.0003).world
    true = scenes.scene({"b0": (0.0, 0.0)}).initial
    state = State({o: true[o] for o in true.objects}, {scenes.B0: np.eye(10) * 1e-6})
    assert world._where_to_look(state, None)
    world.belief.report = ScanReport(covered=("b0",))
    assert not world._where_to_look(state, None)


def test_what_nobody_has_ever_seen_ends_the_episode_at_a_later_scan_too(monkeypatch: pytest.MonkeyPatch) -> None:
    world = looking(monkeypatch).world
    true = scenes.scene({"b0": (0.0, 0.0)}).initial
    monkeypatch.setattr(world, "scan", lambda *args: [])
    monkeypatch.setattr(world, "_where_to_look", lambda state, error: [])
    for missing in ("b1", "b0"):
        error = MissingObjectsError((missing,), ())
        monkeypatch.setattr(world, "_take_in", lambda frames, again, changed, error=error: (true, error, None))
        world.scans = 3
        if missing == "b1":
            with pytest.raises(MissingObjectsError, match="did not find b1"):
                world._look_around()
        else:
            assert world._look_around() is true and world.missing == ("b0",), "it keeps its old place"


def test_a_round_shows_what_a_task_has_on_the_table() -> None:
    worlds_of = []
    for task in (scenes.scene({"b0": (0.0, 0.0)}), FURNISHED_TASK):
        robot = SimRobot(SimWorld(task, RIG))
        robot.connect()
        worlds_of.append(DeployedWorld(robot, {}, RIG, task.objects))
    small, furnished = worlds_of
    assert len(small.scan.configurations) == ROUND < len(furnished.scan.configurations)
    assert set(furnished.belief._estimator.catalogue.hues) > set(small.belief._estimator.catalogue.hues)
