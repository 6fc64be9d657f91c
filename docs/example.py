"""Plan and run one episode with the shipped library, in simulation, with the exact state of every object.

Run it with `python docs/example.py`.
"""

from resync_robot.core.library import load_library
from resync_robot.core.rig import load_rig
from resync_robot.library_models import learned_model, shipped_library
from resync_robot.planning.execute import plan_and_execute
from resync_robot.planning.search import plan
from resync_robot.sim_training.domains import find_domain, world_task
from resync_robot.sim_training.physics.world import SimWorld

domain, rig = find_domain("cornered-insertion-s"), load_rig()
model = learned_model(domain, rig, load_library(shipped_library(domain.name)))

# A world is a pure function of scenario, seed and episode. In s1 the base of the tower begins in a corner.
task = world_task(domain, "s1", seed=1, episode=0)
atoms = model.abstraction.true_atoms(task.initial)
print("plan:", plan(model.operators, task.objects, atoms, task.goal, costs=model.costs))

# Ground, plan, run a skill, ground again, until the goal holds or the robot gives up.
result = plan_and_execute(SimWorld(task, rig), model, task.goal)
for attempt in result.transitions:
    print(f"{attempt.skill}({', '.join(o.name for o in attempt.objects)}):", "done" if attempt.succeeded else "failed")
print("goal reached" if result.success else f"{result.end.value}: {result.reason}")
