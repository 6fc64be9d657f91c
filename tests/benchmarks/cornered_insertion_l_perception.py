"""How well a scan sees Cornered Insertion-L: errors against the simulator's truth over random rendered scenes.

    OMP_NUM_THREADS=1 python tests/benchmarks/cornered_insertion_l_perception.py
        [--scenes 30] [--first 0] [--pictures DIR] [--again]

Nothing moves but the camera. Each view's pose is off, lights and surfaces are drawn, usual and unseen ones in turn. The
scenes take turns, too: the lid on and the drawer closed; the lid off and the drawer closed or ajar; a tower in an open
drawer; a block in the way of the drawer; the lid on and the drawer open; a tower elsewhere and any opening.
`--again` looks a second time at the lid, the drawer and the open box, each by few chosen pictures.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np

from resync_robot.core import fittings, spatial
from resync_robot.core.errors import PerceptionError
from resync_robot.core.rig import load_rig
from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.core.task import Task
from resync_robot.core.vocabulary import BLOCK, DRAWER, LID
from resync_robot.core.world import CameraFrame
from resync_robot.perception import sights
from resync_robot.perception.belief import Belief
from resync_robot.perception.naming import UnsettledSceneError
from resync_robot.perception.next_views import next_views
from resync_robot.perception.objects import SceneEstimator, catalogue_of
from resync_robot.perception.pose import inside_box, yaw_variance_of
from resync_robot.perception.scan import FURNISHED, Scan
from resync_robot.sim_training.domains.cornered_insertion_l.domain import tower
from resync_robot.sim_training.domains.cornered_insertion_l.layouts import (
    THE_BOX,
    THE_DRAWER,
    FurnishedLayout,
    R,
    sample_task,
)
from resync_robot.sim_training.physics.camera_noise import NoisySensor, Tone
from resync_robot.sim_training.physics.randomise import PICTURED, UNSEEN
from resync_robot.sim_training.physics.world import SimWorld
from resync_robot.sim_training.scenes.perception import _stack

RIG = load_rig()
LAYOUTS = (
    FurnishedLayout(cornered=("b0",), free=("b1",)),
    FurnishedLayout(cornered=("b0",), free=("b1", "b2"), lid_on=False),
    FurnishedLayout(free=("b0", "b1", "b2"), lid_on=False, drawer_open=True),
    FurnishedLayout(cornered=("b0",), free=("b1",), in_the_way=("b2",), lid_on=False),
    FurnishedLayout(cornered=("b0", "b1"), free=("b2",), drawer_open=True),
    FurnishedLayout(free=("b0", "b1", "b2"), lid_on=False),
)
AJAR, TOWER_IN_DRAWER, TOWER = 1, 2, 5


def scene(index: int) -> Task:
    """A pure function of its number."""
    rng, kind = np.random.default_rng([index, 77]), index % len(LAYOUTS)
    ranges = (PICTURED, UNSEEN)[index // len(LAYOUTS) % 2]
    task = sample_task(rng, index, tower("b0", "b1"), LAYOUTS[kind], ranges)
    features = {o: np.array(task.initial[o]) for o in task.objects}
    drawer = features[THE_DRAWER]
    if kind in (AJAR, TOWER):
        most = fittings.DRAWER.travel if kind == TOWER else float(rng.choice([0.0, 0.02]))
        drawer[7] = rng.uniform(0.0, most)
        drawer[:2] += drawer[7] * spatial.pose_from_features(drawer[:7])[:2, 0]
    if kind in (TOWER, TOWER_IN_DRAWER):
        upper, lower = BLOCK("b0"), BLOCK("b1")
        at = features[lower].copy()
        if kind == TOWER_IN_DRAWER:
            middle = spatial.pose_from_features(drawer[:7]) @ np.array([-drawer[7] / 2, 0.0, 0.0, 1.0])
            at[:7] = [*middle[:2], fittings.DRAWER.floor + at[9] / 2, *spatial.quat_from_yaw(rng.uniform(-0.1, 0.1))]
        at[2] += (features[upper][9] - at[9]) / 2
        features[upper], features[lower] = _stack(rng, at, features[upper][7:], features[lower][7:])
    return Task(task.objects, State(features), task.goal, task.physics, index)


def look(
    task: Task, index: int
) -> tuple[list[CameraFrame], Scan, State, Callable[[Sequence[np.ndarray]], list[CameraFrame]]]:
    """The first round of pictures of a scan, the truth, and how to take more pictures."""
    world, scan = SimWorld(task, RIG, rendered=True), Scan(RIG, FURNISHED)
    if not world.settles():
        raise SystemExit(f"scene {index} does not stand still")
    sensor = NoisySensor(index, RIG.camera("wrist"), tone=Tone.of(task.physics))

    def take(configurations: Sequence[np.ndarray]) -> list[CameraFrame]:
        return scan(
            lambda q: world.built.set_configuration(q, RIG.gripper.max_opening),
            lambda: sensor.apply(world.render("wrist")),
            configurations,
        )

    return take(scan.configurations), scan, world.perceive(), take


def looks_again(state: State, lid_on: bool) -> dict[Object, sights.Sight]:
    """What is looked at by few pictures, and what these have to show."""
    again = {o: sights.of_lid(state[o]) for o in state.of_type(LID)}
    again |= {o: sights.of_drawer(state[o], fittings.DRAWER) for o in state.of_type(DRAWER)}
    return again if lid_on else again | {THE_BOX: sights.of_box(state[THE_BOX])}


def by_few_pictures(
    belief: Belief, scan: Scan, take: Callable[[Sequence[np.ndarray]], list[CameraFrame]], lid_on: bool
) -> Iterator[tuple[Object, int, State | None]]:
    """Each thing that is looked at again, by how many pictures, and what is believed then; None where that is open."""
    opening, at = RIG.gripper.max_opening, scan.configurations[-1]
    state, known = belief.state(RIG.robot_features(at, opening)), dict(belief._known)
    solids = [s for o in state.of_type(DRAWER) for s in sights.cabinet_and_front(state[o], fittings.DRAWER)]
    for obj, sight in looks_again(state, lid_on).items():
        views = next_views(scan, RIG, [], state[THE_BOX], at, False, [sight], solids)
        inside = [b for b in state.of_type(BLOCK) if inside_box(state[b][:2], state[THE_BOX])]
        changed = [obj, *(inside if obj == THE_BOX else ())]
        try:
            yield obj, len(views), belief.update_from_scan(take(views), RIG.robot_features(at, opening), False, changed)
        except PerceptionError as error:
            print(f"{obj}: {error.what}", flush=True)
            yield obj, len(views), None
        belief._known = dict(known)


def errors(believed: State, obj, true: np.ndarray) -> dict[str, float]:
    """Of one object: mm, degrees, and squared Mahalanobis distances of x and y, of the yaw and of an opening."""
    off, covariance = believed[obj] - true, believed.covariance(obj)
    period = 2 * np.pi if obj.type == DRAWER else np.pi / 2
    turn = float(spatial.wrap(spatial.yaw_of(believed[obj][3:7]) - spatial.yaw_of(true[3:7]), period))
    found = {
        "xy mm": 1e3 * float(np.linalg.norm(off[:2])),
        "z mm": 1e3 * abs(off[2]),
        "yaw deg": abs(float(np.degrees(turn))),
        "in 95 %": float(off[:2] @ np.linalg.solve(covariance[:2, :2], off[:2]) < 5.99),
        "yaw in 95 %": float(turn**2 / yaw_variance_of(covariance) < 3.84),
    }
    if obj.type == DRAWER:
        found |= {"opening mm": 1e3 * abs(off[7]), "opening in 95 %": float(off[7] ** 2 / covariance[7, 7] < 3.84)}
    return found


def condition(task: Task, obj, believed: Belief) -> str:
    if obj.type != BLOCK:
        lid_on = task.initial.get(LID("lid"), "z")[0] > 0.05
        return f"{obj.name}, the lid {'on' if lid_on else 'off'}" if obj == THE_BOX or obj.type == LID else obj.name
    where = task.initial[obj]
    tray = believed._ground.tray_at(where[:2]) is not None
    inside = np.all(np.abs(where[:2] - task.initial[THE_BOX][:2]) < 0.17)
    place = "in the drawer" if tray else "in the box" if inside else "on the table"
    stacked = index_kind(task) in (TOWER, TOWER_IN_DRAWER) and obj.name in ("b0", "b1")
    return f"{'upper ' if obj.name == 'b0' else 'lower '}block of a tower" if stacked else f"block {place}"


def index_kind(task: Task) -> int:
    return task.seed % len(LAYOUTS)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=30)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--pictures", type=Path)
    parser.add_argument("--again", action="store_true")
    args = parser.parse_args()
    rows, lost = defaultdict(list), defaultdict(int)
    for index in range(args.first, args.first + args.scenes):
        task = scene(index)
        frames, scan, truth, take = look(task, index)
        if args.pictures:
            args.pictures.mkdir(parents=True, exist_ok=True)
            grid = np.vstack([np.hstack([f.colour for f in frames[k : k + 3]]) for k in (0, 3, 6)])
            cv2.imwrite(str(args.pictures / f"{index:03d}.png"), grid[..., ::-1])
        of = {kind: [o for o in task.objects if o.type == kind] for kind in (BLOCK, LID, DRAWER)}
        estimator = SceneEstimator(RIG, catalogue_of(RIG, furnished=True))
        belief = Belief(R, THE_BOX, of[BLOCK], RIG, estimator, of[LID] + of[DRAWER])
        robot = RIG.robot_features(scan.configurations[-1], RIG.gripper.max_opening)
        try:
            belief.update_from_scan(frames, robot)
        except UnsettledSceneError as error:
            print(f"{index}: {error.what}", flush=True)
        except PerceptionError as error:
            print(f"{index}: nothing at all: {error.what}", flush=True)
            continue
        state = belief.state(robot)
        for obj in task.objects:
            if obj == R or obj.name in belief.report.covered:
                continue
            under = condition(task, obj, belief)
            if obj.name in (*belief.report.missing, *belief.report.ambiguous) or obj not in state:
                lost[under] += 1
            else:
                rows[under].append(errors(state, obj, truth[obj]) | {"scene": index})
        lid_on = truth.get(LID("lid"), "z")[0] > 0.05
        for thing, pictures, believed in by_few_pictures(belief, scan, take, lid_on) if args.again else ():
            inside = [o for o in of[BLOCK] if thing == THE_BOX and inside_box(truth[o][:2], truth[THE_BOX])]
            for obj in (thing, *inside):
                under = f"{condition(task, obj, belief)}, by few pictures"
                if believed is None:
                    lost[under] += 1
                else:
                    rows[under].append(errors(believed, obj, truth[obj]) | {"pictures": pictures, "scene": index})
    for under in sorted({*rows, *lost}):
        print(f"{under}: found {len(rows[under])} of {len(rows[under]) + lost[under]}")
        for what in [w for w in rows[under][0] if w != "scene"] if rows[under] else ():
            values = np.array([row[what] for row in rows[under]])
            shown = (
                f"{100 * values.mean():.0f} %"
                if "%" in what
                else "{:.2f}, {:.2f}, {:.2f}".format(*np.percentile(values, [50, 95, 100]))
            )
            worst = "" if "%" in what else f" in scene {rows[under][int(values.argmax())]['scene']:.0f}"
            print(f"    {what}: {shown}{worst}")


if __name__ == "__main__":
    main()
