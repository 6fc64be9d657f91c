"""A domain has the skills that it has operators for, each over the same types."""

import pytest

from resync_robot.core.domain_faults import skill_faults
from resync_robot.core.rig import load_rig
from resync_robot.policies.given_skills import given_skills
from resync_robot.policies.scripted import scripted_skills
from resync_robot.sim_training.domains import find_domain


@pytest.mark.parametrize("name", ["cornered-insertion-s", "cornered-insertion-l"])
def test_every_operator_has_its_skill_and_no_other_is_there(name: str) -> None:
    domain = find_domain(name)
    skills = given_skills(load_rig(), domain.operators)
    assert list(skill_faults(domain, skills)) == []
    assert {s.name for s in skills} == {o.name for o in domain.operators}


def test_those_of_cornered_insertion_s_are_pick_insert_and_place() -> None:
    found = given_skills(load_rig(), find_domain("cornered-insertion-s").operators)
    assert found == scripted_skills(load_rig())
