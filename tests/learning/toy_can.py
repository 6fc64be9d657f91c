"""A second failure for the toy: a can beside a block stops the fingers, and `Push` moves it away.

The can is a type of its own, which no earlier data know. Pick needs `clear` m between the centres of block and can,
Insert the same at its base. Blocks can be cornered as well.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from resync_robot.core.state import State
from resync_robot.core.symbols import ROUND, SE3, Atoms, Object, Type
from resync_robot.core.trajectory import Trajectory
from resync_robot.core.vocabulary import BLOCK, ROBOT
from tests.learning.toy import BOX_0, DOMAIN, ON, ROBOT_0, Toy, holding

CAN = Type("can", (*SE3, "radius", "height"), pose=SE3, symmetry=ROUND)
CAN_0, RADIUS, CAN_HEIGHT = CAN("can"), 0.025, 0.08
PUSH = (ROBOT, BLOCK, CAN)
DOMAIN_WITH_CAN = replace(DOMAIN, types=(*DOMAIN.types, CAN))


@dataclass
class ToyWithCan(Toy):
    """The toy with a can in every scene of its own; its scenarios are `can` and `both` besides those of the toy."""

    clear: float = 0.085
    away: float = 0.105

    def near(self, state: State, block: Object) -> bool:
        """Does a can stand in the way of the fingers at this block?"""
        return self.gap_to_can(state, block) < self.clear

    @staticmethod
    def gap_to_can(state: State, block: Object) -> float:
        """The distance, m, between the centres of the block and the nearest can."""
        return min((float(np.linalg.norm(state[c][:2] - state[block][:2])) for c in state.of_type(CAN)), default=1.0)

    def with_can(self, state: State, block: Object, least: float, most: float) -> State | None:
        """The state with the can so far, m, from a block, and in nobody else's way; None where there is no room."""
        for _ in range(400):
            r, angle = self.rng.uniform(least, most), self.rng.uniform(-np.pi, np.pi)
            p = state[block][:2] + r * np.array([np.cos(angle), np.sin(angle)])
            if all(np.linalg.norm(p - state[b][:2]) > self.away for b in state.of_type(BLOCK) if b != block):
                can = np.array([*p, CAN_HEIGHT / 2, 1.0, 0.0, 0.0, 0.0, RADIUS, CAN_HEIGHT])
                return State({**{o: state[o] for o in state}, CAN_0: can})
        return None

    def scene_with_can(self, blocks: int, place: Callable[[int], str], beside: int, least: float, most: float) -> State:
        """A scene of the toy with the can so far from block `beside`."""
        while True:
            found = self.with_can(self.scene(blocks, place), BLOCK(f"b{beside}"), least, most)
            if found is not None:
                return found

    def run(self, state: State, skill: str, objects: tuple[Object, ...]) -> tuple[State, bool]:
        if skill == "Push":
            held = any(holding(state, (ROBOT_0, b)) for b in state.of_type(BLOCK))
            for most in (0.16, 0.3, 0.6):
                moved = None if held else self.with_can(state, objects[1], self.away, most)
                if moved is not None:
                    return moved, True
            return state, False
        if (skill == "Pick" and self.near(state, objects[1])) or (skill == "Insert" and self.near(state, objects[2])):
            return state, False
        after, succeeded = super().run(state, skill, objects)
        for _ in range(50):
            if skill != "Recover" or not succeeded or self.gap_to_can(after, objects[1]) > self.away:
                break
            # A recovery does not bring its block beside a can.
            after, succeeded = super().run(state, skill, objects)
        return after, succeeded

    def mend(self, state: State, objects: tuple[Object, ...]) -> tuple[str, tuple[Object, ...]]:
        return ("Push", (*objects, CAN_0)) if self.near(state, objects[1]) else super().mend(state, objects)

    def dreams(self, count: int, tower: float = 0.0) -> list[Trajectory]:
        """The can before and after `Push` around every block, in equal shares; a fourth of them with a cornered block,
        as a product over both failures has it."""
        result = []
        b = [BLOCK(f"b{i}") for i in range(4)]
        for n in range(count):
            blocks = int(self.rng.integers(2, 5))
            reference, before = n // 2 % blocks, n % 2 == 0
            cornered = int(self.rng.integers(blocks)) if n % 4 == 3 else -1
            gaps = (0.056, 0.08) if before else (self.away, 0.16)
            state = self.scene_with_can(blocks, lambda i, c=cornered: "corner" if i == c else "free", reference, *gaps)
            steps = [("Pick", (ROBOT_0, b[0])), ("Insert", (ROBOT_0, b[0], b[1]))]
            goal = frozenset({ON(b[0], b[1])})
            source = f"{'before' if before else 'after'}@b{reference}"
            found = [self.record(state, steps, goal, source, mends=2)]
            if not found[0].solved:
                # What hinders at the base cannot be mended any more with a block in the hand.
                first = [("Push", (ROBOT_0, b[1], CAN_0))] if self.near(state, b[1]) else []
                first += [("Recover", (ROBOT_0, b[1], BOX_0))] if self.gap(state, b[1]) < self.insert_gap else []
                found.append(self.record(state, [*first, *steps], goal, source, mends=2))
            result += found
        return result

    def attempts(self, count: int, covered: bool = True) -> list[Trajectory]:
        """Single tries of Pick and Insert with the can from beside the fingers to well away from them."""
        result = []
        b0, b1 = BLOCK("b0"), BLOCK("b1")
        insert = [("Pick", (ROBOT_0, b0)), ("Insert", (ROBOT_0, b0, b1))]
        for n in range(count):
            state = self.scene_with_can(3, lambda i: "free", int(n % 2 == 0), 0.056, 0.125)
            result.append(self.record(state, insert[: 1 + (n % 2 == 0)], frozenset({ON(b0, b1)}), "attempt"))
        return result

    def scenario(self, name: str) -> tuple[State, Atoms]:
        """`can`: beside the base or the block to pick; `both`: the base in a corner, the can beside the other one."""
        if name not in ("can", "both"):
            return super().scenario(name)
        while True:
            bare, goal = super().scenario("S1" if name == "both" else "S4")
            state = self.with_can(bare, BLOCK(f"b{self.rng.integers(2) if name == 'can' else 1}"), 0.056, 0.075)
            if state is not None:
                return state, goal
