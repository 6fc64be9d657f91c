"""How much of everything a stage does."""

from __future__ import annotations

from dataclasses import dataclass, field

from resync_robot.sim_training.learn_recovery import RecoverySettings
from resync_robot.sim_training.ppo import PpoSettings


@dataclass(frozen=True, kw_only=True)
class StagePreset:
    """The budgets of one stage."""

    failures: int = 200
    """Size of the mined set D^F."""
    recovery: RecoverySettings = field(default_factory=RecoverySettings)
    checks: int = 60
    """Fresh tasks in which the recovery is followed by the skill that failed."""
    dreams: int = 200
    """Of the first stage; twice as many for each further one, which has more combinations to tell apart."""
    attempts: int = 600

    def dreams_of(self, stage: int) -> int:
        """For the stage of that number, from 1."""
        return int(self.dreams * 2 ** (stage - 1))


STAGE_PRESETS = {
    "smoke": StagePreset(
        failures=20,
        recovery=RecoverySettings(
            attempts=60,
            ppo=PpoSettings(
                scenes=32, total_steps=30_000, least_steps=16_000, stop_at=0.95, minibatch=256, anneal_steps=20_000
            ),
            roll_outs=30,
        ),
        checks=16,
        dreams=80,
        attempts=240,
    ),
    "quick": StagePreset(),
    "full": StagePreset(failures=500, checks=200, dreams=1000, attempts=2000),
}
