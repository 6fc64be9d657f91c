"""How dreaming and planning grow with the stages that are known and with the objects of a scene.

    python tests/benchmarks/growth.py RUN_FOLDER [--objects 2 4 6 8] [--room 4] [--scenes 10] [--scenario l5]

For the library after each stage, and scenes with so many objects that its failures can be about, with every known cause
in the way of the first of them: how many combinations there are to dream of, and the time of grounding and of planning
to the domain's usual goal, on one core. Where a scene has room for fewer objects (`--room`), the others stand in a row
beyond it: neither grounding nor planning asks whether the robot reaches them. With `--scenario` scenes and goals are
those of a scenario, and the causes stand where it has them. Minutes of each step of the run stand in its metrics.json.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from resync_robot.core.errors import PlanningError
from resync_robot.core.library import load_library
from resync_robot.core.rig import load_rig
from resync_robot.core.state import State
from resync_robot.core.symbols import Type
from resync_robot.core.task import Task
from resync_robot.curriculum.dream import usual_objects
from resync_robot.learning.failures import FailureModel
from resync_robot.library_models import embodiment_of, learned_model
from resync_robot.planning.search import plan
from resync_robot.sim_training.domains import find_domain, world_task
from resync_robot.sim_training.dreaming import Dream, Dreamer, Placement

FRESH = 960_000_000
"""First seed of the scenes."""
BEYOND = 0.3
"""m between the objects that a scene has no room for."""


def crowded(task: Task, kind: Type, count: int) -> Task:
    """The task with as many objects of one type as are asked for: what is missing are copies of the last one, in a row
    that leads away from it."""
    here = task.initial.of_type(kind)
    copies = {}
    for i in range(len(here), count):
        x, y = task.initial.get(here[-1], "x", "y") + [0.0, -BEYOND * (1 + i - len(here))]
        copies[kind(f"{here[-1].name}-{i}")] = task.initial.with_features(here[-1], x=x, y=y)[here[-1]]
    state = State({**{o: task.initial[o] for o in task.initial}, **copies})
    return replace(task, objects=state.objects, initial=state)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("--objects", type=int, nargs="+", default=[2, 4, 6, 8])
    parser.add_argument("--room", type=int, default=8)
    parser.add_argument("--scenes", type=int, default=10)
    parser.add_argument("--scenario", help="scenes of this one, with as many objects more as are missing")
    args = parser.parse_args()
    torch.set_num_threads(1)
    metrics = json.loads((args.run / "metrics.json").read_text(encoding="utf-8"))
    print("| stage | minutes: dreams, concepts | objects | combinations | grounding ms | planning ms, p95 | steps |")
    print("|---|---|---|---|---|---|---|")
    for place in sorted((args.run / "stages").glob("*/library")):
        library = load_library(place)
        domain = find_domain(library.domain)
        rig = load_rig() if domain.embodiment is None else None
        model = learned_model(domain, rig, library)
        failures = tuple(FailureModel.from_learned(s.recovery, s.failure, domain) for s in library.stages)
        usual = usual_objects(domain, failures, tuple(s.scenario for s in library.stages), FRESH)
        before = tuple(Placement(i, "before", 0) for i in range(len(failures)))
        spent = [metrics[f"{place.parent.name}/{step}"]["seconds"] / 60 for step in ("dream", "discover")]
        for count in args.objects:
            there = {**usual, failures[-1].relevant: min(count, args.room)}
            dreamer = Dreamer(domain, embodiment_of(domain, rig), failures, model, there)
            grounding, planning, steps = [], [], []
            for i in range(args.scenes):
                if args.scenario is None:
                    scene = dreamer.task(Dream(before, FRESH + i))
                else:
                    scene = world_task(domain, args.scenario, FRESH, i)
                task = crowded(scene, failures[-1].relevant, count)
                begun = time.perf_counter()
                atoms = model.abstraction.true_atoms(task.initial)
                grounding.append(1000 * (time.perf_counter() - begun))
                try:
                    found = plan(model.operators, task.objects, atoms, task.goal, costs=model.costs)
                except PlanningError:
                    continue
                planning.append(1000 * found.seconds)
                steps.append(len(found.steps))
            shown = f"{np.median(planning):.0f}, {np.percentile(planning, 95):.0f}" if planning else "no plan"
            minutes, median = f"{spent[0]:.1f}, {spent[1]:.1f}", np.median(steps) if steps else 0
            combinations = len(dreamer.combinations()) if count <= args.room else "-"
            print(
                f"| {place.parent.name} | {minutes} | {count} | {combinations} | "
                f"{np.median(grounding):.1f} | {shown} | {median:.0f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
