"""One random scene against the simulator's truth: the first round of pictures that a deployment takes, not the second
looks that it takes where something stays in doubt."""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from resync_robot.core import spatial
from resync_robot.core.damage import Shape
from resync_robot.core.errors import PerceptionError, UnknownNameError
from resync_robot.core.options import MOST_EPISODES
from resync_robot.core.rig import Rig
from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.core.vocabulary import BLOCK
from resync_robot.perception.belief import Belief
from resync_robot.perception.catalogue import Catalogue
from resync_robot.perception.naming import UnsettledSceneError
from resync_robot.perception.objects import SceneEstimate, SceneEstimator
from resync_robot.perception.pose import yaw_variance_of
from resync_robot.perception.scan import Scan
from resync_robot.sim_training.domains.cornered_insertion_s.layouts import THE_BOX, R
from resync_robot.sim_training.physics.camera_noise import NoisySensor, Tone
from resync_robot.sim_training.physics.randomise import LOOKS
from resync_robot.sim_training.physics.world import SimWorld
from resync_robot.sim_training.scenes.perception import SINGLES, TWIN, PerceptionScene, draw_scene

BOX_CONDITION, HOLDING = "the box", "while one is held"
HELD_EVERY = 4
"""In every so many scenes a block goes into the hand and the scan is repeated."""
FALSE_BEYOND = 0.030
"""m from every block of its colour at which an estimate is one of nothing."""


NUMBER: Shape = (float, type(None))
OBJECT: Shape = {
    "seed": int,
    "scene": int,
    "name": str,
    "condition": str,
    "twin": bool,
    "found": bool,
    **dict.fromkeys(("position_mm", "yaw_deg", "width_mm", "height_mm", "place_distance", "yaw_distance"), NUMBER),
}
SCENE: Shape = {
    "seed": int,
    "scene": int,
    "objects": [OBJECT],
    "false": int,
    "views": int,
    "seconds": [float],
    "complaint": str,
}
"""An `ObjectRow` and a `SceneRow` in a file."""


@dataclass(frozen=True, kw_only=True)
class ObjectRow:
    """How one object of a scene was estimated.

    Attributes:
        seed, scene: which one; `draw_scene` draws it from these.
        condition: how it stood.
        twin: another block has its colour.
        found: it was seen, or is known to be hidden, and nothing about it is open.
        position_mm, yaw_deg, width_mm, height_mm: errors; None where it was not found.
        place_distance: squared Mahalanobis distance of x and y (chi-squared, 2 degrees of freedom).
        yaw_distance: that of the yaw (1 degree of freedom).
    """

    seed: int
    scene: int
    name: str
    condition: str
    twin: bool
    found: bool
    position_mm: float | None = None
    yaw_deg: float | None = None
    width_mm: float | None = None
    height_mm: float | None = None
    place_distance: float | None = None
    yaw_distance: float | None = None


@dataclass(frozen=True, kw_only=True)
class SceneRow:
    """One scene, the number `scene` of its `seed`. `false`: objects reported that are not there; `seconds`: computing
    after each round of pictures; `complaint`: the error where the scan ended with one."""

    seed: int
    scene: int
    objects: tuple[ObjectRow, ...]
    false: int
    views: int
    seconds: tuple[float, ...]
    complaint: str


def run_scene(rig: Rig, job: tuple[int, int, str]) -> SceneRow:
    """Build, render, spoil, scan once, estimate and compare the scene of that (seed, index, looks).

    Raises:
        RenderError: no device can render.
    """
    seed, index, looks = job
    # A scene that does not stand still has no truth to compare with; the next one takes its place.
    for attempt in range(20):
        drawn = draw_scene(seed, index + MOST_EPISODES * attempt, LOOKS[looks])
        world = SimWorld(drawn.task, rig, rendered=True)
        if world.settles():
            break
    sensor = NoisySensor(index + 1000 * seed, rig.camera("wrist"), tone=Tone.of(drawn.task.physics))
    trial = _Trial(rig, drawn, world, sensor)
    rounds = [trial.look((seed, index))]
    lifted = _can_be_lifted(drawn)
    if index % HELD_EVERY == 0 and lifted is not None:
        trial.hold(lifted)
        rounds.append(trial.look((seed, index)))
    return SceneRow(
        seed=seed,
        scene=index,
        objects=tuple(o for r in rounds for o in r.objects),
        false=sum(r.false for r in rounds),
        views=trial.views,
        seconds=tuple(trial.seconds),
        complaint="; ".join(filter(None, trial.complaints)),
    )


def _can_be_lifted(drawn: PerceptionScene) -> Object | None:
    """A block that carries none and touches none."""
    alone = sorted(name for name, condition in drawn.conditions.items() if condition in SINGLES)
    return BLOCK(alone[0]) if alone else None


@dataclass(frozen=True)
class _Round:
    objects: tuple[ObjectRow, ...]
    false: int


class _Trial:
    """The robot's side of one scene, and what it got right."""

    def __init__(self, rig: Rig, drawn: PerceptionScene, world: SimWorld, sensor: NoisySensor) -> None:
        self.rig, self.drawn, self.world, self.sensor = rig, drawn, world, sensor
        self.scan = Scan(rig)
        self.estimator = SceneEstimator(rig, Catalogue(hues=drawn.hues))
        self.blocks = [o for o in drawn.task.objects if o.type == BLOCK]
        self.belief = Belief(R, THE_BOX, self.blocks, rig, self.estimator)
        self.opening, self.held = rig.gripper.max_opening, None  # type: tuple[float, Object | None]
        self.views, self.seconds, self.complaints = 0, [], []  # type: tuple[int, list[float], list[str]]

    def look(self, number: tuple[int, int]) -> _Round:
        """One scan, taken in by the belief and compared with the truth."""
        frames = self.scan(self._move, lambda: self.sensor.apply(self.world.render("wrist")))
        self.views = len(frames)
        scene: SceneEstimate | None = None
        state: State | None = None
        complaint = ""
        features = self.rig.robot_features(self.scan.configurations[-1], self.opening)
        begun = time.process_time()
        try:
            scene = self.estimator.estimate(frames)
            state = self.belief.update(scene, features)
        except UnsettledSceneError as error:
            complaint = error.what
            with suppress(PerceptionError):
                state = self.belief.state(features)
        except PerceptionError as error:
            complaint = error.what
        self.seconds.append(time.process_time() - begun)
        self.complaints.append(complaint)
        # The held block is where the tips are, whatever the pictures show; the others are what such a scan is about.
        report = self.belief.report
        left_out = {*report.ambiguous, *report.missing, *([self.held.name] if self.held else [])}
        rows, false = compare(self.drawn, state, self.world.perceive(), left_out, number)
        if scene is not None:
            names = {b.name for b in self.blocks}
            false += sum(n not in names for n in scene.blocks) + len(scene.surplus)
        if self.held is not None:
            rows = tuple(replace(r, condition=HOLDING) for r in rows if r.name != self.held.name)
            false += self.belief.held != self.held
        return _Round(rows, false)

    def hold(self, block: Object) -> None:
        """Put a block between the pads, as a grasp would, and let the robot know."""
        self.held, self.opening = block, float(self.world.task.initial.get(block, "size_x")[0])
        self._move(self.rig.arm.home)
        # A belief without this block has complained already.
        with suppress(UnknownNameError):
            self.belief.attach(block, self.rig.robot_features(self.rig.arm.home, self.opening))

    def _move(self, q: np.ndarray) -> None:
        self.world.built.set_configuration(q, self.opening)
        if self.held is not None:
            self.world.place(self.held, self.rig.robot_features(q, self.opening)[:7])


def compare(
    drawn: PerceptionScene, believed: State | None, true: State, open_names: set[str], number: tuple[int, int]
) -> tuple[tuple[ObjectRow, ...], int]:
    """A row for every object, and how many estimates are of nothing.

    Blocks of one colour are compared in the order that fits best: which is which cannot be seen.
    """
    pairs: dict[Object, Object] = {}
    groups: dict[float, list[Object]] = {}
    for block in true.of_type(BLOCK):
        groups.setdefault(drawn.hues[block.name], []).append(block)
    false = 0
    for group in groups.values():
        estimates = {} if believed is None else {b: believed[b] for b in group if b in believed}
        found = [b for b in estimates if b.name not in open_names]
        away = np.array([[_apart(estimates[f], true[t]) for t in group] for f in found]).reshape(len(found), len(group))
        for f, t in zip(*linear_sum_assignment(away), strict=True):
            if away[f, t] < FALSE_BEYOND:
                pairs[group[t]] = found[f]
            else:
                false += 1
    if believed is not None and THE_BOX in believed:
        pairs[THE_BOX] = THE_BOX
    rows = []
    for obj in (THE_BOX, *true.of_type(BLOCK)):
        label = BOX_CONDITION if obj == THE_BOX else drawn.conditions[obj.name]
        alike = obj != THE_BOX and TWIN in drawn.conditions and drawn.hues[obj.name] == drawn.hues[TWIN]
        errors = _errors(believed, pairs[obj], true[obj]) if believed is not None and obj in pairs else {}
        rows.append(
            ObjectRow(
                seed=number[0],
                scene=number[1],
                name=obj.name,
                condition=label,
                twin=alike,
                found=obj in pairs,
                **errors,
            )
        )
    return tuple(rows), false


def _apart(first: np.ndarray, second: np.ndarray) -> float:
    return float(np.linalg.norm(first[:3] - second[:3]))


def _errors(believed: State, obj: Object, true: np.ndarray) -> dict[str, float]:
    error = believed[obj] - true
    turn = float(spatial.wrap(spatial.yaw_of(believed[obj][3:7]) - spatial.yaw_of(true[3:7]), np.pi / 2))
    covariance = believed.covariance(obj)
    place = np.inf if covariance is None else error[:2] @ np.linalg.solve(covariance[:2, :2], error[:2])
    return {
        "position_mm": 1e3 * float(np.linalg.norm(error[:3])),
        "yaw_deg": abs(float(np.degrees(turn))),
        "width_mm": 1e3 * float(np.abs(error[7:9]).max()),
        "height_mm": 1e3 * abs(float(error[9])),
        "place_distance": float(place),
        "yaw_distance": np.inf if covariance is None else turn**2 / yaw_variance_of(covariance),
    }
