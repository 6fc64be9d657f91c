"""How much of everything a stage does."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from resync_robot.sim_training.learn_recovery import RecoverySettings
from resync_robot.sim_training.ppo import PpoSettings

TRAINING_SEEDS = 1_000_000
"""Each training seed owns this many world seeds from seed * TRAINING_SEEDS on; evaluation draws from elsewhere."""


@dataclass(frozen=True, kw_only=True)
class StagePreset:
    """The budgets of one stage."""

    failures: int = 200
    """Size of the mined set D^F."""
    explained: int = 40
    """The same where the recovery is known already: enough to tell what failed, and where its cause lies."""
    recovery: RecoverySettings = field(default_factory=RecoverySettings)
    checks: int = 60
    """Fresh tasks in which the recovery is followed by the skill that failed."""
    dreams: int = 200
    """Of the first stage; twice as many for each further one, which has more combinations to tell apart."""
    attempts: int = 600
    """Single attempts of the failed skill, with its causes anywhere between before and after the recovery."""

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


def _for_an_arm(preset: StagePreset, **budgets: int) -> StagePreset:
    """A run of an arm's skill takes as long as a hundred actions, so fewer are asked for; and it has to press a block
    in three dimensions, which takes a larger net. Nearly all succeed after half of the least actions; the rest is for
    the noise of exploration to go, for a skill acts without it."""
    r = preset.recovery
    ppo = replace(r.ppo, std_end=PpoSettings().std_end, anneal_from=0.0, stop_at=min(r.ppo.stop_at, 0.95))
    recovery = replace(
        r,
        attempts=min(r.attempts, 200),
        judged=replace(r.judged, verdicts=0.01, surest=0.95),
        ppo=replace(ppo, least_steps=max(ppo.least_steps, 60_000)),
        elsewhere=0,
        roll_outs=min(r.roll_outs, 60),
        width=256,
        depth=4,
    )
    return replace(preset, recovery=recovery, **budgets)


ARM_PRESETS = {
    "smoke": _for_an_arm(STAGE_PRESETS["smoke"], failures=16, checks=8, dreams=48, attempts=96),
    "quick": _for_an_arm(STAGE_PRESETS["quick"], checks=24, dreams=150, attempts=300),
    "full": _for_an_arm(STAGE_PRESETS["full"], dreams=600),
}
