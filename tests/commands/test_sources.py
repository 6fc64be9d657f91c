"""A camera policy is used where it is good for it, and otherwise not without a word."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from resync_robot.commands.sources import deployed_by_camera, why_not_by_camera
from resync_robot.core.errors import ConfigError
from resync_robot.core.library import Library
from resync_robot.core.rig import load_rig
from resync_robot.deployment.settings import DeployConfig
from resync_robot.sim_training.domains import find_domain
from tests.libraries import DOMAIN, given_library, with_camera_policy

CORNERED = find_domain(DOMAIN)
RIG = Path(__file__).parents[2] / "hardware" / "emulated.toml"


@pytest.mark.parametrize(
    ("figures", "why"),
    [
        (with_camera_policy(4, 8).stages[0].figures, ""),
        (with_camera_policy(3, 8).stages[0].figures, "recovered in only 3 of the 8 trials"),
        ({}, ""),
        ({"distil": {"points": [], "chosen": 1}}, ""),
        ({"distil": {"points": [{"step": 1}], "chosen": 1}}, ""),
        ({"distil": []}, ""),
    ],
)
def test_a_camera_policy_that_failed_its_trials_is_found_by_what_training_left(
    figures: dict[str, Any], why: str
) -> None:
    library = with_camera_policy(1, 1)
    stage = replace(library.stages[0], figures=figures)
    found = why_not_by_camera(CORNERED, replace(library, stages=(stage,)))
    assert why in found and bool(why) == bool(found)
    assert "no camera policy for Recover" in why_not_by_camera(CORNERED, given_library())


@pytest.mark.parametrize(
    ("given", "args", "expected", "said"),
    [
        (given_library(), {}, False, ""),
        (with_camera_policy(8, 8), {}, True, ""),
        (with_camera_policy(8, 8), {"perception": "oracle"}, False, ""),
        (with_camera_policy(8, 8), {"skills": "state"}, False, ""),
        (with_camera_policy(0, 8), {}, False, "only 0 of the 8 trials"),
        (with_camera_policy(0, 8), {"skills": "camera"}, True, ""),
    ],
)
def test_a_camera_policy_that_failed_its_trials_is_not_used_without_a_word(
    given: Library, args: dict[str, Any], expected: bool, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert deployed_by_camera(DeployConfig(**args), CORNERED, load_rig(), given) is expected
    out = capsys.readouterr().out
    assert said in out and bool(said) == bool(out) == ("-> use it all the same: --skills camera" in out)


def test_a_real_arm_has_nothing_else_to_follow_a_block_by() -> None:
    rig = load_rig(RIG)
    config, domain = DeployConfig(backend="ur7e"), CORNERED
    assert deployed_by_camera(config, domain, rig, given_library()) is False, "an emulated one has"
    assert rig.controller is not None
    real = replace(rig, controller=replace(rig.controller, emulated=False))
    with pytest.raises(
        ConfigError, match=r"no camera policy for Recover, and on a real arm(?s:.)*train-sim.*--skills state$"
    ):
        deployed_by_camera(config, domain, real, given_library())
    with pytest.raises(ConfigError, match=r"only 0 of the 8 trials(?s:.)*or use it all the same: --skills camera"):
        deployed_by_camera(config, domain, real, with_camera_policy(0, 8))
