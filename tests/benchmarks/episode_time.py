"""Where the time of an episode goes, on the robot's own clock, and what its pictures and its computing cost.

    OMP_NUM_THREADS=1 python tests/benchmarks/episode_time.py [--perception oracle] [--scenarios s0 s1 s3]
        [--episodes 2] [--seed 1080] [--json FILE]

The worlds are those of `evaluate --worlds unseen`. Every control step counts for its skill and for the way the tip is
sent meanwhile: `across`, `up`, `down`, `fingers` where only they move, and `still` otherwise. What `perceive` takes
counts as `scan`. `pictures` are whole ones, `parts` those that a skill looks at while it moves.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from resync_robot.core.joints import JointTarget
from resync_robot.core.library import load_library
from resync_robot.core.rig import Rig, load_rig
from resync_robot.core.skill import GroundSkill, SkillOutcome
from resync_robot.core.state import State
from resync_robot.core.world import ArmObservation
from resync_robot.deployment.devices import SimulatedDevices, open_simulated
from resync_robot.deployment.uncertain_atoms import with_sampled_atoms
from resync_robot.deployment.world import DeployedWorld, OracleWorld
from resync_robot.library_models import camera_recovery, initial_model, learned_model, shipped_library
from resync_robot.planning.execute import ExecuteSettings, Listener, Model, begin_after, plan_and_execute
from resync_robot.sim_training.domains import find_domain, world_task

DOMAIN = find_domain("cornered-insertion-s")
STILL = 1e-5
"""m or rad between two targets, or m of opening, that count as no motion."""


class Clock(Listener):
    """Adds up where the time goes."""

    def __init__(self, rig: Rig, now: Callable[[], float]) -> None:
        self._rig, self._now, self._since = rig, now, 0.0
        self._skill, self._way, self._last = "", "", None
        self.spent: Counter[str] = Counter()
        self.skills: list[str] = []

    def mark(self, what: str) -> None:
        """What has passed since the last mark was `what`."""
        now = self._now()
        self.spent[what] += now - self._since
        self._since = now

    def on_skill_start(self, skill: GroundSkill) -> None:
        self.mark("start")
        self._skill, self._way, self._last = skill.skill.name, "", None
        self.skills.append(skill.skill.name)

    def on_control(self, observation: ArmObservation, action: JointTarget) -> None:
        self._count()
        tip = self._rig.tip_pose(action.arm)[:3, 3]
        before, self._last = self._last, (tip, action.opening)
        if before is None:
            before = self._rig.tip_pose(observation.arm)[:3, 3], observation.commanded_opening
        across, up = float(np.hypot(*(tip - before[0])[:2])), float(tip[2] - before[0][2])
        if max(across, abs(up)) > STILL:
            self._way = "across" if across > abs(up) else "up" if up > 0 else "down"
        else:
            self._way = "fingers" if abs(action.opening - before[1]) > STILL else "still"

    def on_skill_end(self, skill: GroundSkill, outcome: SkillOutcome) -> None:
        self._count()
        self._way = ""

    def _count(self) -> None:
        if self._way:
            self.mark(f"{self._skill} {self._way}")


class Counted:
    """A camera that counts what it is asked for."""

    def __init__(self, camera: Any, asked: Counter[str]) -> None:
        self._camera, self._asked, self.name = camera, asked, camera.name

    def capture(self) -> Any:
        self._asked["pictures"] += 1
        return self._camera.capture()

    def cut_out(self, *args: Any) -> Any:
        self._asked["parts"] += 1
        return self._camera.cut_out(*args)


def run(scenario: str, seed: int, episode: int, rig: Rig, model: Model, given: Model, oracle: bool) -> dict[str, Any]:
    """One episode: how it ended and what it took."""
    task = world_task(DOMAIN, scenario, seed, episode, "unseen")
    with ExitStack() as stack:
        devices: SimulatedDevices = stack.enter_context(open_simulated(task, rig))
        clock, asked = Clock(rig, devices.clock), Counter[str]()
        cameras: Any = {name: Counted(camera, asked) for name, camera in devices.cameras.items()}
        kind = OracleWorld if oracle else DeployedWorld
        world = kind(
            devices.robot, cameras, rig, task.objects, devices.truth, abstraction=with_sampled_atoms(model).abstraction
        )

        def perceive() -> State:
            clock.mark("between")
            found = kind.perceive(world)
            clock.mark("scan")
            return found

        world.perceive = perceive  # type: ignore[method-assign]
        wall, cpu, begun = time.monotonic(), time.process_time(), devices.clock()
        begin_after(world, given, DOMAIN.scenario(scenario).begins_after, task.objects, clock)
        result = plan_and_execute(world, with_sampled_atoms(model), task.goal, ExecuteSettings(), clock)
        return {
            "scenario": scenario,
            "episode": episode,
            "success": bool(task.goal <= given.abstraction.true_atoms(devices.truth())),
            "end": result.end.value,
            "seconds": devices.clock() - begun,
            "cpu": time.process_time() - cpu,
            "wall": time.monotonic() - wall,
            "scans": world.scans,
            "pictures": asked["pictures"],
            "parts": asked["parts"],
            "skills": clock.skills,
            "spent": {what: round(s, 2) for what, s in clock.spent.items() if s > 0},
        }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--perception", choices=("camera", "oracle"), default="camera")
    parser.add_argument("--scenarios", nargs="+", default=["s0", "s1", "s3"])
    parser.add_argument("--episodes", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1080)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    rig, library, oracle = load_rig(), load_library(shipped_library(DOMAIN.name)), args.perception == "oracle"
    model = learned_model(DOMAIN, rig, library, [] if oracle else [camera_recovery(DOMAIN, rig, library)])
    given, rows, spent = with_sampled_atoms(initial_model(DOMAIN, rig)), [], Counter[str]()
    for scenario in args.scenarios:
        for episode in range(args.episodes):
            rows.append(run(scenario, args.seed, episode, rig, model, given, oracle))
            spent.update(rows[-1]["spent"])
            print(json.dumps({k: v for k, v in rows[-1].items() if k != "spent"}), flush=True)
            if args.json:
                args.json.write_text(json.dumps(rows), encoding="utf-8")
    for what, seconds in spent.most_common():
        print(f"{what}: {seconds / len(rows):.2f} s an episode")
    for what in ("seconds", "cpu", "scans", "pictures", "parts"):
        values = [row[what] for row in rows]
        print(f"{what}: median {np.median(values):.1f}, mean {np.mean(values):.1f}")
    print(f"{sum(row['success'] for row in rows)} of {len(rows)} reach their goal")


if __name__ == "__main__":
    main()
