"""Cornered Insertion without physics: geometry decides which skill succeeds. Made for tests of concept learning.

Pick needs `pick_gap` between two opposite faces of the block and the walls, Insert needs `insert_gap` at its base,
a recovery pushes the block `recovered` m clear of every wall. The rules see true states, learning sees noisy ones.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from resync_robot.core.relations import Relations
from resync_robot.core.spatial import quat_from_yaw, yaw_of
from resync_robot.core.state import State
from resync_robot.core.symbols import Atom, Atoms, GroundOperator, Object, Operator, Predicate, Type, Variable
from resync_robot.core.trajectory import Trajectory, Transition
from resync_robot.core.vocabulary import BLOCK, BOX, ROBOT, TYPES
from resync_robot.learning.dataset import StageData
from resync_robot.learning.features import perturb
from resync_robot.sim_training.domains.cornered_insertion_s.corner import RELATIONS, in_box

HAND_EMPTY, HOLDING = Predicate("HandEmpty", (ROBOT,)), Predicate("Holding", (ROBOT, BLOCK))
ON = Predicate("On", (BLOCK, BLOCK))
R, B, B0, B1 = Variable("?r", ROBOT), Variable("?b", BLOCK), Variable("?b0", BLOCK), Variable("?b1", BLOCK)
X = Variable("?x", BOX)
PICK = Operator("Pick", (R, B), frozenset({HAND_EMPTY(R)}), frozenset({HOLDING(R, B)}), frozenset({HAND_EMPTY(R)}))
INSERT = Operator(
    "Insert",
    (R, B0, B1),
    frozenset({HOLDING(R, B0)}),
    frozenset({ON(B0, B1), HAND_EMPTY(R)}),
    frozenset({HOLDING(R, B0)}),
)
RECOVERY = ("Recover", (ROBOT, BLOCK, BOX))
ROBOT_0, BOX_0 = ROBOT("robot"), BOX("box")


@dataclass(frozen=True)
class Given:
    """The part of a domain that concept learning reads."""

    name: str
    types: tuple[Type, ...]
    predicates: tuple[Predicate, ...]
    classifiers: Mapping[str, Callable[[State, tuple[Object, ...]], float]]
    operators: tuple[Operator, ...]
    relations: Relations = field(default_factory=dict)


SIZE, HEIGHT = 0.06, 0.045
INNER, WALL_Z, WALL = 0.30, 0.11, 0.03
OPEN, CLOSED = 0.12, 0.06


def _hand_empty(state: State, args: tuple[Object, ...]) -> float:
    return float(state.get(args[0], "opening")[0] > 0.09)


def holding(state: State, args: tuple[Object, ...]) -> float:
    robot, block = state[args[0]], state[args[1]]
    return float(robot[7] < 0.09 and np.linalg.norm(robot[:3] - block[:3]) < 0.02)


def _on(state: State, args: tuple[Object, ...]) -> float:
    a, b = state[args[0]], state[args[1]]
    return float(np.linalg.norm(a[:2] - b[:2]) < 0.02 and abs(a[2] - b[2] - HEIGHT) < 0.015)


DOMAIN = Given(
    "toy-insertion",
    tuple(TYPES.values()),
    (HAND_EMPTY, HOLDING, ON),
    {"HandEmpty": _hand_empty, "Holding": holding, "On": _on},
    (PICK, INSERT),
    RELATIONS,
)


def first_stage(trajectories: Sequence[Trajectory]) -> StageData:
    """Data of the stage that learns `Recover` from failures of Pick."""
    return StageData(*RECOVERY, "Pick", trajectories)


@dataclass
class Toy:
    """Rules, and the random numbers of one data set."""

    seed: int = 0
    noise: bool = True
    pick_gap: float = 0.028
    insert_gap: float = 0.015
    recovered: float = 0.035
    rng: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)

    # Geometry

    def gap(self, state: State, block: Object) -> float:
        """The free space, m, on both sides of the block along the better of its two axes."""
        position, heading = in_box(state[BOX_0][None], state[block][None])
        p, half = position[0, :2], INNER / 2
        if np.any(np.abs(p) > half):
            return 0.2
        best = 0.0
        for axis in (heading[0], heading[0] + np.pi / 2):
            u = np.array([np.cos(axis), np.sin(axis)])
            # Distance from the centre to the wall that a ray meets first, both ways.
            with np.errstate(divide="ignore"):
                rays = [np.min(np.where(np.abs(v) > 1e-9, (half - np.sign(v) * p) / np.abs(v), 9.0)) for v in (u, -u)]
            best = max(best, min(rays) - SIZE / 2)
        return best

    def scene(self, blocks: int, place: Callable[[int], str]) -> State:
        """Blocks in a box somewhere; `place(i)` says how block i lies: corner, wall, middle gap, free or outside."""
        rng = self.rng
        yaw = rng.uniform(-np.pi, np.pi)
        box = [*rng.uniform([0.35, -0.2], [0.6, 0.2]), 0.0, *quat_from_yaw(yaw), INNER, INNER, WALL_Z, WALL]
        features = {
            BOX_0: np.array(box),
            ROBOT_0: np.array([0.4, 0.0, 0.35, 0.0, 1.0, 0.0, 0.0, OPEN]),
        }
        taken: list[np.ndarray] = []
        for i in range(blocks):
            kind = place(i)
            for _ in range(200):
                p, turn = self._pose(kind)
                if all(np.linalg.norm(p - q) > 0.095 for q in taken):
                    break
            taken.append(p)
            c, s = np.cos(yaw), np.sin(yaw)
            world = np.array(box[:2]) + np.array([c * p[0] - s * p[1], s * p[0] + c * p[1]])
            features[BLOCK(f"b{i}")] = np.array([*world, HEIGHT / 2, *quat_from_yaw(yaw + turn), SIZE, SIZE, HEIGHT])
        return State(features)

    def _pose(self, kind: str) -> tuple[np.ndarray, float]:
        rng, edge = self.rng, INNER / 2 - SIZE / 2
        signs, quarter = rng.choice([-1.0, 1.0], 2), rng.integers(4) * np.pi / 2
        if kind in ("corner", "gap"):
            gaps = rng.uniform(0, 0.003, 2) if kind == "corner" else rng.uniform(0.003, 0.04, 2)
            return signs * (edge - gaps), quarter + rng.normal(0, 0.01)
        if kind == "after":
            return signs * (edge - rng.uniform(self.recovered, 0.07, 2)), quarter + rng.normal(0, 0.1)
        if kind == "wall":
            p = np.array([edge - rng.uniform(0, 0.02), rng.uniform(-0.05, 0.05)]) * signs
            return (p if rng.random() < 0.5 else p[::-1]), quarter + rng.normal(0, 0.01)
        if kind == "outside":
            radius, angle = rng.uniform(0.30, 0.36), rng.uniform(-np.pi, np.pi)
            return radius * np.array([np.cos(angle), np.sin(angle)]), rng.uniform(-np.pi, np.pi)
        return rng.uniform(-0.07, 0.07, 2), rng.uniform(-np.pi, np.pi)

    # Skills

    def run(self, state: State, skill: str, objects: tuple[Object, ...]) -> tuple[State, bool]:
        """The true state after a skill, and whether it did what its operator promises."""
        robot, block = objects[0], objects[1]
        held = [b for b in state.of_type(BLOCK) if holding(state, (robot, b))]
        covered = [b for b in state.of_type(BLOCK) if any(_on(state, (o, b)) for o in state.of_type(BLOCK) if o != b)]
        if skill == "Pick":
            if held or block in covered or self.gap(state, block) < self.pick_gap:
                return state, False
            return self._move(state, {block: np.array([0.4, 0.0, 0.35])}, CLOSED), True
        if skill == "Insert":
            base = objects[2]
            if block not in held or base in covered or self.gap(state, base) < self.insert_gap:
                return state, False
            return self._move(
                state, {block: state[base][:3] + np.array([0, 0, HEIGHT])}, OPEN, yaw_of(state[base][3:7])
            ), True
        if held or block in covered:
            return state, False
        box = state[objects[2]]
        position, heading = in_box(box[None], state[block][None])
        p, edge = position[0, :2], INNER / 2 - SIZE / 2
        if np.any(np.abs(p) > INNER / 2):
            return state, False
        others = [in_box(box[None], state[b][None])[0][0, :2] for b in state.of_type(BLOCK) if b != block]
        for _ in range(200):
            limit = edge - self.rng.uniform(self.recovered, 0.07, 2)
            goal = np.sign(p) * np.minimum(np.abs(p), limit)
            if all(np.linalg.norm(goal - q) > 0.08 for q in others):
                break
        yaw = yaw_of(box[3:7])
        c, s = np.cos(yaw), np.sin(yaw)
        world = box[:2] + np.array([c * goal[0] - s * goal[1], s * goal[0] + c * goal[1]])
        turn = yaw + heading[0] + self.rng.normal(0, 0.1)
        return self._move(state, {block: np.array([*world, HEIGHT / 2])}, OPEN, turn), True

    @staticmethod
    def _move(state: State, to: dict[Object, np.ndarray], opening: float, yaw: float | None = None) -> State:
        features = {o: state[o].copy() for o in state}
        for block, position in to.items():
            features[block][:3] = position
            if yaw is not None:
                features[block][3:7] = quat_from_yaw(yaw)
        features[ROBOT_0][7] = opening
        return State(features)

    # Data

    def seen(self, state: State) -> State:
        """The state as perception reports it."""
        if not self.noise:
            return state
        return State({o: perturb(o.type, state[o][None], self.rng)[0] for o in state})

    def mend(self, state: State, objects: tuple[Object, ...]) -> tuple[str, tuple[Object, ...]]:
        """The recovery to try after Pick failed on these objects."""
        return "Recover", (*objects, BOX_0)

    def record(
        self,
        state: State,
        attempts: Iterable[tuple[str, tuple[Object, ...]]],
        goal: Atoms,
        source: str,
        mends: int = 0,
    ) -> Trajectory:
        """Run attempts in order until one fails; up to `mends` failed Picks are mended and tried again."""
        transitions: list[Transition] = []
        queue, seen = list(attempts), self.seen(state)
        while queue:
            skill, objects = queue.pop(0)
            after, succeeded = self.run(state, skill, objects)
            seen_after = self.seen(after)
            transitions.append(Transition(seen, skill, objects, seen_after, succeeded))
            state, seen = after, seen_after
            if not succeeded:
                if not (mends and skill == "Pick"):
                    break
                queue = [self.mend(state, objects), (skill, objects), *queue]
                mends -= 1
        solved = all(_on(state, a.args) for a in goal)  # type: ignore[arg-type]
        return Trajectory(tuple(transitions), goal, solved, source)

    def dreams(self, count: int, tower: float = 0.25) -> list[Trajectory]:
        """Before and after the recovery around every block, in equal shares, run reactively."""
        result = []
        for n in range(count):
            blocks = int(self.rng.integers(2, 5))
            reference, before = n // 2 % blocks, n % 2 == 0
            hard = self.rng.choice(["gap", "wall", "free", "outside"])
            kinds = {reference: "corner" if before else "after"}
            state = self.scene(blocks, lambda i, k=kinds, h=hard: k.get(i, "free" if self.rng.random() < 0.7 else h))
            b = [BLOCK(f"b{i}") for i in range(blocks)]
            steps = [("Pick", (ROBOT_0, b[0])), ("Insert", (ROBOT_0, b[0], b[1]))]
            goal = {ON(b[0], b[1])}
            if blocks > 2 and self.rng.random() < tower:
                steps += [("Pick", (ROBOT_0, b[2])), ("Insert", (ROBOT_0, b[2], b[0]))]
                goal.add(ON(b[2], b[0]))
            source = f"{'before' if before else 'after'}@b{reference}"
            found = [self.record(state, steps, frozenset(goal), source, mends=1)]
            if before and reference == 1 and not found[0].solved:
                # A base cannot be recovered any more with a block in the hand: once again, recovering it first.
                first = ("Recover", (ROBOT_0, b[1], BOX_0))
                found.append(self.record(state, [first, *steps], frozenset(goal), source))
            result += found
        return result

    def attempts(self, count: int, covered: bool = True) -> list[Trajectory]:
        """Single tries of Pick and Insert, spread over the ways a block can lie, under another block included."""
        result = []
        b = [BLOCK(f"b{i}") for i in range(3)]
        kinds = ["corner", "gap", "gap", "wall", "free", "outside", *(["covered"] if covered else [])]
        insert = [("Pick", (ROBOT_0, b[0])), ("Insert", (ROBOT_0, b[0], b[1]))]
        for n in range(count):
            kind = kinds[n // 2 % len(kinds)]
            tried = int(n % 2 == 0)
            state = self.scene(3, lambda i, k=kind, t=tried: k if i == t and k != "covered" else "free")
            if kind == "covered":
                last = ("Pick", (ROBOT_0, b[1])) if n % 2 else ("Insert", (ROBOT_0, b[2], b[1]))
                tries = [*insert, last] if n % 2 else [*insert, ("Pick", (ROBOT_0, b[2])), last]
            else:
                tries = insert[:1] if n % 2 else insert
            result.append(self.record(state, tries, frozenset({ON(b[0], b[1])}), "attempt"))
        return result

    # Tests

    def scenario(self, name: str) -> tuple[State, Atoms]:
        """An initial true state and a goal: S0 to S6 of Cornered Insertion-S."""
        b = [BLOCK(f"b{i}") for i in range(4)]
        cornered, goal, blocks = {
            "S0": ({0: "corner"}, {ON(b[0], b[1])}, 2),
            "S1": ({0: "corner"}, {ON(b[1], b[0])}, 2),
            "S2": ({0: "corner", 1: "corner"}, {ON(b[1], b[0])}, 2),
            "S3": ({0: "corner", 3: "corner"}, {ON(b[1], b[0]), ON(b[2], b[1])}, 4),
            "S4": ({}, {ON(b[1], b[0])}, 2),
            "S5": ({0: "wall"}, {ON(b[1], b[0])}, 2),
            "S6": ({0: "gap"}, {ON(b[1], b[0])}, 2),
        }[name]
        while True:
            state = self.scene(blocks, lambda i: cornered.get(i, "free"))
            gaps = [self.gap(state, b[i]) for i in range(blocks) if i not in cornered]
            if min(gaps, default=1.0) > 0.035:
                return state, frozenset(goal)

    def execute(
        self, state: State, goal: Atoms, decide: Callable[[State, Atoms], GroundOperator | None], budget: int = 14
    ) -> tuple[bool, list[str]]:
        """Follow `decide(seen state, atoms held false) -> next step`; after a failed step it hears of it."""
        done: list[str] = []
        failed: set[Atom] = set()
        for _ in range(budget):
            if all(_on(state, a.args) for a in goal):  # type: ignore[arg-type]
                return True, done
            step = decide(self.seen(state), frozenset(failed))
            if step is None:
                return False, done
            state, succeeded = self.run(state, step.name, step.objects)
            done.append(str(step) + ("" if succeeded else " failed"))
            if not succeeded and step.name == "Pick":
                failed.add(HOLDING(*step.objects))
            if succeeded and step.name in ("Recover", "Push"):
                failed.discard(HOLDING(*step.objects[:2]))
        return False, done
