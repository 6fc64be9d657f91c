"""Recovery Chaining reacts to a failure that its detector knows, and to no other."""

from __future__ import annotations

import numpy as np
import pytest

from resync_robot.baselines.recovery_chaining import RecoveryChaining, detector_of
from resync_robot.core.errors import LibraryError
from resync_robot.core.library import Record
from resync_robot.core.rig import load_rig
from resync_robot.core.skill import GroundSkill
from resync_robot.curriculum.context import Known
from resync_robot.learning.recovery_policy import OBSERVATION_SIZE
from resync_robot.learning.terminals import train_terminal
from resync_robot.sim_training.domains import find_domain
from tests import scenes
from tests.libraries import DOMAIN, recovery_record
from tests.scenes import B0, B1, THE_BOX, R

CORNERED = find_domain(DOMAIN)
MODEL = Known(domain=CORNERED.spec, rig=load_rig()).with_recovery(CORNERED.recovery, recovery_record()).open().model
STATE = scenes.scene({"b0": (scenes.CORNER, scenes.CORNER), "b1": (0.0, 0.0)}).initial
PICK, INSERT = MODEL.skill("Pick").ground((R, B0)), MODEL.skill("Insert").ground((R, B1, B0))


def react(record: Record, failed: GroundSkill) -> GroundSkill | None:
    return RecoveryChaining(((MODEL.skill("Recover"), detector_of(CORNERED, record)),))(failed, STATE)


@pytest.mark.parametrize("failed", [PICK, INSERT])
def test_a_detected_failure_is_answered_with_the_recovery_of_the_last_block(failed: GroundSkill) -> None:
    answer = react(recovery_record(failed=0.9), failed)
    assert str(answer) == "Recover(r, b0, box)"


@pytest.mark.parametrize("failed", [PICK, INSERT])
def test_what_the_detector_does_not_know_is_not_answered(failed: GroundSkill) -> None:
    assert react(recovery_record(failed=0.1), failed) is None


def test_the_detector_is_asked_about_each_block_by_itself() -> None:
    """A detector that knows small gaps answers for the cornered block, whichever argument it is."""
    import torch

    generator = torch.Generator().manual_seed(0)
    seen = torch.randn(400, OBSERVATION_SIZE, generator=generator)
    seen[:, :2] = torch.rand(400, 2, generator=generator)  # wall gaps, dm
    detector, accuracy = train_terminal(seen, (seen[:, :2].amin(-1) < 0.3).long(), seed=0, epochs=25, batch=64)
    assert accuracy > 0.8
    record = recovery_record()
    tensors = {k: v for k, v in record.tensors.items() if not k.startswith("failed.")}
    tensors |= {f"failed.{k}": np.array(v) for k, v in detector.to_record().tensors.items()}
    record = Record(record.meta, tensors)
    assert str(react(record, MODEL.skill("Insert").ground((R, B0, B1)))) == str(
        MODEL.skill("Recover").ground((R, B0, THE_BOX))
    )
    assert react(record, MODEL.skill("Pick").ground((R, B1))) is None


def test_a_record_without_a_detector_is_refused() -> None:
    record = recovery_record()
    with pytest.raises(LibraryError):
        detector_of(CORNERED, Record({"policy": record.meta["policy"]}, record.tensors))
