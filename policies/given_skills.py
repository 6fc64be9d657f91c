"""Every given skill of the arm, of which a domain has those that it has operators for."""

from __future__ import annotations

from collections.abc import Sequence

from resync_robot.core.rig import Rig
from resync_robot.core.skill import Skill
from resync_robot.core.symbols import Operator
from resync_robot.policies.drawers import drawer_skills
from resync_robot.policies.lids import lid_skills
from resync_robot.policies.scripted import scripted_skills
from resync_robot.policies.towers import tower_skills


def given_skills(rig: Rig, operators: Sequence[Operator]) -> tuple[Skill, ...]:
    """Those of these operators' names."""
    every = (*scripted_skills(rig), *lid_skills(rig), *drawer_skills(rig), *tower_skills(rig))
    wanted = {operator.name for operator in operators}
    return tuple(skill for skill in every if skill.name in wanted)
