"""What tests of the skills for lids, drawers and towers share."""

from __future__ import annotations

from resync_robot.core.rig import load_rig
from resync_robot.core.skill import SkillOutcome
from resync_robot.core.symbols import Object
from resync_robot.core.task import Task
from resync_robot.planning.skill_run import run_skill
from resync_robot.policies.drawers import drawer_skills
from resync_robot.policies.lids import lid_skills
from resync_robot.policies.scripted import scripted_skills
from resync_robot.policies.towers import tower_skills
from resync_robot.sim_training.physics.world import SimWorld
from tests.policies.followers import Follower
from tests.scenes import R

RIG = load_rig()
SKILLS = {s.name: s for s in (*scripted_skills(RIG), *lid_skills(RIG), *drawer_skills(RIG), *tower_skills(RIG))}


def build(task: Task, kind: type[SimWorld] = SimWorld) -> SimWorld:
    world = kind(task, RIG)
    assert world.settles()
    return world


def run(world: SimWorld | Follower, name: str, *objects: Object) -> SkillOutcome:
    return run_skill(world, SKILLS[name].ground((R, *objects)))
