"""How hard the state-based `Recover` presses on the ways by which its effort limit can be kept, in the same worlds.

    python tests/benchmarks/pressing_force.py [--worlds 3] [--ways capped,yielding,neither] [--delay 0.008]

"capped": the simulated arm caps its joint torques. "yielding": its setpoints yield to the felt force, as those of a
UR7e do (`hardware/yielding.py`), which it feels `--delay` s late. "neither": a stiff arm, as a UR7e without that would
be. The guard against force at the tip is set aside, or it would end what is measured here. An episode ends with its
first `Recover`.
"""

from __future__ import annotations

import argparse
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from resync_robot.core.joints import JointTarget
from resync_robot.core.library import Library, load_library
from resync_robot.core.rig import Rig, load_rig
from resync_robot.core.skill import GroundSkill, SkillOutcome
from resync_robot.core.symbols import GroundOperator
from resync_robot.deployment.world import OracleWorld
from resync_robot.hardware.base import SERVO_PERIOD, RobotState, StarvedError
from resync_robot.hardware.sim import SimRobot
from resync_robot.hardware.workspace import Workspace
from resync_robot.hardware.yielding import Yielding
from resync_robot.library_models import learned_model, shipped_library
from resync_robot.planning.execute import Listener, plan_and_execute
from resync_robot.sim_training.domains import find_domain, world_task
from resync_robot.sim_training.physics.world import SimWorld

RIG = Path(__file__).parents[2] / "hardware" / "emulated.toml"


class PressingRobot(SimRobot):
    """Writes down what the tip feels, and how hard the hand is in contact, while an effort limit is set.

    Attributes:
        forces: (felt, contact) in N at every physics step of that time.
    """

    def __init__(self, world: SimWorld, rig: Rig, delay: float) -> None:
        super().__init__(world)
        self._world, self._rig = world, rig
        self._limit: tuple[float, ...] | None = None
        self._felt: deque[tuple[np.ndarray, np.ndarray]] = deque(maxlen=1 + round(delay / SERVO_PERIOD))
        self.forces: list[tuple[float, float]] = []

    def connect(self) -> None:
        super().connect()
        state = self.state()
        self._felt.append((state.q, wrench(state)))

    def limit_effort(self, limit: tuple[float, ...] | None) -> None:
        self._limit = limit
        self.cap(limit)

    def cap(self, limit: tuple[float, ...] | None) -> None:
        """By the simulated drives."""
        super().limit_effort(limit)

    def servo(self, q: np.ndarray, opening: float) -> None:
        super().servo(q, opening)
        state = self.state()
        self._felt.append((state.q, wrench(state)))
        if self._limit is not None and self._ticks == 0:
            contact = max((force for _, force in self._world.hand_contacts()), default=0.0)
            self.forces.append((float(np.linalg.norm(state.tip_force)), contact))


class StiffRobot(PressingRobot):
    """Its clock does not wait for setpoints, as far as the stream can tell, and it caps nothing."""

    def __init__(self, world: SimWorld, rig: Rig, delay: float) -> None:
        super().__init__(world, rig, delay)
        self._workspace = Workspace(rig)
        self._rests_at: np.ndarray | None = None

    def connect(self) -> None:
        super().connect()
        state = self.state()
        self._last = JointTarget(state.q, state.opening)

    def cap(self, limit: tuple[float, ...] | None) -> None:
        pass

    def speed_fraction(self) -> float:
        return 1.0

    def due(self) -> float:
        return self.state().time

    def last_sent(self) -> JointTarget:
        return self._last

    def stay_in(self, workspace: Workspace) -> None:
        self._workspace = workspace

    def play(
        self,
        setpoints: np.ndarray,
        openings: np.ndarray,
        stop: np.ndarray,
        after_each: Callable[[], None] | None = None,
    ) -> None:
        if self._rests_at is not None:
            q, self._rests_at = self._rests_at, None
            raise StarvedError(q)
        for q, opening in zip(setpoints, openings.tolist(), strict=True):
            self.servo(q, opening)
            if after_each is not None:
                after_each()

    def servo(self, q: np.ndarray, opening: float) -> None:
        self._last = JointTarget(q.copy(), opening)
        super().servo(q, opening)


class YieldingRobot(StiffRobot):
    """What the link of a UR7e does between path and wire, done here."""

    _yielding: Yielding | None = None

    def cap(self, limit: tuple[float, ...] | None) -> None:
        arm, self._yielding = self._yielding, None
        if arm is not None:
            while not arm.at_rest:
                self.servo(arm.brake(), self._last.opening)
            self._rests_at = arm.position
        if limit is not None:
            felt = wrench(self.state())
            self._yielding = Yielding(self._rig, self._workspace, np.array(limit), self._last.arm, felt)

    def servo(self, q: np.ndarray, opening: float) -> None:
        if self._yielding is not None and self._limit is not None:
            q = self._yielding.follow(q, *self._felt[0])
        super().servo(q, opening)


WAYS: dict[str, type[PressingRobot]] = {"capped": PressingRobot, "yielding": YieldingRobot, "neither": StiffRobot}


class UntilRecovered(Listener):
    """Ends the episode with its first skill that has an effort limit."""

    def __init__(self, robot: PressingRobot, world: SimWorld) -> None:
        self._robot, self._world = robot, world
        self.ending, self.seconds, self._begin = "not needed", 0.0, 0.0

    def on_skill_start(self, skill: GroundSkill) -> None:
        self._begin = self._world.time

    def on_skill_end(self, skill: GroundSkill, outcome: SkillOutcome) -> None:
        if self._robot.forces and not self.seconds:
            self.ending, self.seconds = outcome.ending.value, self._world.time - self._begin

    def confirm(self, step: GroundOperator) -> bool:
        return not self.seconds


def wrench(state: RobotState) -> np.ndarray:
    """(6,) of the world on the tip; the simulated hand feels no torque."""
    return np.concatenate([state.tip_force, np.zeros(3)])


def press(library: Library, rig: Rig, way: str, scenario: str, seed: int, delay: float) -> str:
    """One episode as a row of the table."""
    domain = find_domain(library.domain)
    task = world_task(domain, scenario, seed, 0)
    simulated = SimWorld(task, rig)
    with WAYS[way](simulated, rig, delay) as robot:
        world = OracleWorld(robot, {}, rig, task.objects, live_state=simulated.perceive)
        heard = UntilRecovered(robot, simulated)
        end = plan_and_execute(world, learned_model(domain, rig, library, None), task.goal, listener=heard)
    if not robot.forces:
        return f"| {seed} | {way} | {heard.ending}, {end.end.value} | | | | |"
    felt, contact = np.array(robot.forces).T
    figures = f"{felt.max():.0f} | {np.quantile(felt, 0.99):.0f} | {contact.max():.0f} | {heard.seconds:.1f}"
    return f"| {seed} | {way} | {heard.ending or end.reason} | {figures} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--library", type=Path)
    parser.add_argument("--scenario", default="s1")
    parser.add_argument("--seed", type=int, default=0, help="of the first world")
    parser.add_argument("--worlds", type=int, default=3)
    parser.add_argument("--ways", default=",".join(WAYS))
    parser.add_argument("--delay", type=float, default=0.008, help="s")
    args = parser.parse_args()
    rig = load_rig(RIG)
    if rig.controller is None:
        raise LookupError(f"{RIG} has no [controller]")
    rig = replace(rig, controller=replace(rig.controller, force_limit=np.inf))
    library = load_library(args.library or shipped_library("cornered-insertion-s"))
    print("| world | way | Recover | tip, most N | tip, 99 % N | contact, most N | s |")
    print("|---|---|---|---|---|---|---|")
    for seed in range(args.seed, args.seed + args.worlds):
        for way in args.ways.split(","):
            print(press(library, rig, way, args.scenario, seed, args.delay), flush=True)


if __name__ == "__main__":
    main()
