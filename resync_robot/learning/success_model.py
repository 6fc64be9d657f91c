"""Where would a skill succeed? A classifier of the states that it begins in, fitted to attempts.

It stands for attempts that nobody has time to make: a recovery is rewarded for going where the failed skill looks
likely to succeed, and an attempt has the last word.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import nn

from resync_robot.core.errors import TrainingError


@dataclass(frozen=True, kw_only=True)
class SuccessModelSettings:
    """How the classifier is fitted."""

    width: int = 64
    learning_rate: float = 1e-3
    first_steps: int = 400
    """Gradient steps of the first fit."""
    steps: int = 40
    """Of each later one, which goes on from the last."""
    batch: int = 256
    smoothing: float = 0.02
    """Labels are this far from 0 and 1: away from all attempts the odds then keep a slope to climb."""
    blur: float = 0.5
    """Noise on what the potential is fitted to, in standard deviations of each feature: it then climbs where
    probabilities are flat, far away from success."""
    remembered: int = 20_000
    """The latest attempts that are kept."""


class SuccessModel:
    """P(nothing keeps the skill from its effects | the relational features of the state that it begins in).

    Where nothing obstructs, a skill may still miss its effects, or they may not be seen: then a failed attempt says
    less than one that succeeded. How often that happens is told by attempts where nothing obstructs, and the fit allows
    for it (forward correction of noisy labels, Patrini et al. 2017).

    Args:
        features: length of a feature vector.
        seed: of the weights and of the order of the data.
    """

    def __init__(self, features: int, seed: int, settings: SuccessModelSettings | None = None) -> None:
        self.settings = settings or SuccessModelSettings()
        self._random = torch.Generator().manual_seed(seed)
        width = self.settings.width
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self._nets = nn.ModuleDict({name: _net(features, width) for name in ("sharp", "blurred")})
        self._mean, self._scale = torch.zeros(features), torch.ones(features)
        self._optimiser = torch.optim.AdamW(self._nets.parameters(), lr=self.settings.learning_rate)
        self._x, self._y = torch.zeros(0, features), torch.zeros(0)
        self._free = np.zeros(2)
        self._fitted = False

    @property
    def attempts(self) -> int:
        """How many are remembered."""
        return len(self._y)

    @property
    def has_both(self) -> bool:
        """Whether some of them succeeded and some failed."""
        return 0 < int((self._y > 0.5).sum()) < len(self._y)

    def remembered(self) -> tuple[Float[np.ndarray, "n d"], Bool[np.ndarray, "n"]]:
        """The attempts: what they began with, and whether they succeeded."""
        return self._x.double().numpy(), self._y.numpy() > 0.5

    @property
    def reliability(self) -> float:
        """The share of attempts that succeed where nothing obstructs; 1 as long as there was none."""
        won, tried = self._free
        return float((won + 1) / (tried + 1))

    def add_free(self, succeeded: Bool[np.ndarray, "n"]) -> None:
        """Count attempts where nothing obstructs; `add` is told of them as of any other."""
        self._free = self._free + [np.sum(succeeded), len(succeeded)]

    def add(self, features: Float[np.ndarray, "n d"], succeeded: Bool[np.ndarray, "n"]) -> None:
        """Remember attempts: where they began, and whether they succeeded."""
        keep = -self.settings.remembered
        self._x = torch.cat([self._x, torch.as_tensor(features, dtype=torch.float32)])[keep:]
        self._y = torch.cat([self._y, torch.as_tensor(succeeded, dtype=torch.float32)])[keep:]

    def fit(self) -> float:
        """Fit to all that is remembered, going on from the last fit; both outcomes weigh the same.

        Returns:
            The mean loss of the last ten steps.

        Raises:
            TrainingError: all remembered attempts ended alike.
        """
        s, yes = self.settings, self._y > 0.5
        if not yes.any() or yes.all():
            ended = "succeeded" if len(yes) and yes.all() else "failed"
            raise TrainingError(f"all {len(yes)} attempts {ended}: nothing tells where the skill succeeds")
        if not self._fitted:
            # Fixed from here on, so that the odds of one state can be compared over time.
            self._mean, self._scale = self._x.mean(0), self._x.std(0).clamp(min=1e-3)
        steps = s.steps if self._fitted else s.first_steps
        self._fitted = True
        places = (torch.nonzero(~yes).flatten(), torch.nonzero(yes).flatten())
        target = self._y * (1 - 2 * s.smoothing) + s.smoothing
        most = among_balanced(self.reliability, float(yes.float().mean()))
        losses: list[float] = []
        for _ in range(steps):
            halves = [of[torch.randint(len(of), (s.batch // 2,), generator=self._random)] for of in places]
            rows = torch.cat(halves)
            noise = self.settings.blur * torch.randn(len(rows), self._x.shape[1], generator=self._random)
            loss, blurred = (
                corrected_loss(self._logits(name, self._x[rows], by), target[rows], most)
                for name, by in (("sharp", 0 * noise), ("blurred", noise))
            )
            self._optimiser.zero_grad()
            (loss + blurred).backward()  # type: ignore[no-untyped-call]
            self._optimiser.step()
            losses.append(float(loss.detach()))
        return float(np.mean(losses[-10:]))

    def probability(self, features: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "n"]:
        """Of success from each state; one half before the first fit."""
        if not self._fitted:
            return np.full(len(features), 0.5)
        with torch.no_grad():
            return torch.sigmoid(self._logits("sharp", torch.as_tensor(features, dtype=torch.float32))).double().numpy()

    @property
    def fitted(self) -> bool:
        """Whether it knows anything yet."""
        return self._fitted

    def potential(self, features: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "n"]:
        """Blurred log-odds of success, from 0 where failure is certain to 1; one half before the first fit."""
        most = float(np.log((1 - self.settings.smoothing) / self.settings.smoothing))
        if not self._fitted:
            return np.full(len(features), 0.5)
        with torch.no_grad():
            odds = self._logits("blurred", torch.as_tensor(features, dtype=torch.float32)).double().numpy()
        return np.clip(0.5 + odds / (2 * most), 0.0, 1.0)

    def _logits(self, name: str, x: torch.Tensor, noise: torch.Tensor | float = 0.0) -> torch.Tensor:
        found: torch.Tensor = self._nets[name](((x - self._mean) / self._scale).clamp(-5, 5) + noise).squeeze(-1)
        return found

    def weights(self) -> dict[str, np.ndarray]:
        """What `load` needs: for copies in other processes."""
        free = torch.from_numpy(self._free)
        tensors = {"mean": self._mean, "scale": self._scale, "free": free, **self._nets.state_dict()}
        return {name: value.numpy().copy() for name, value in tensors.items()}

    def load(self, weights: dict[str, np.ndarray]) -> None:
        """Predict as the model whose weights these are."""
        tensors = {name: torch.from_numpy(value) for name, value in weights.items()}
        self._mean, self._scale = tensors.pop("mean"), tensors.pop("scale")
        self._free = tensors.pop("free").numpy()
        self._nets.load_state_dict(tensors)
        self._fitted = True


def among_balanced(reliability: float, share: float) -> float:
    """Probability that an attempt succeeded which nothing obstructed, where both outcomes weigh the same.

    Args:
        reliability: that probability among all attempts.
        share: of these, those that succeeded.
    """
    won, lost = reliability * (1 - share), (1 - reliability) * share
    return won / (won + lost)


def corrected_loss(
    logits: torch.Tensor, target: torch.Tensor, most: float, weights: torch.Tensor | None = None
) -> torch.Tensor:
    """Binary cross-entropy of outcomes, where one that nothing obstructs succeeds with probability `most` only.

    Args:
        logits: log-odds that nothing obstructs.
    """
    if most == 1.0:
        return nn.functional.binary_cross_entropy_with_logits(logits, target, weights)
    return nn.functional.binary_cross_entropy((most * torch.sigmoid(logits)).clamp(1e-6, 1 - 1e-6), target, weights)


def _net(inputs: int, width: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, width), nn.Tanh(), nn.Linear(width, width), nn.Tanh(), nn.Linear(width, 1))
