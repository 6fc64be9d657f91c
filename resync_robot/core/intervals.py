"""How far a rate is known from so many trials."""

from __future__ import annotations


def wilson(successes: int, trials: int, z: float = 1.96) -> tuple[float, float]:
    """The 95 % confidence interval of a rate (Wilson 1927), which behaves at 0 and 1 as well."""
    if trials == 0:
        return 0.0, 1.0
    rate, n = successes / trials, trials
    centre, half = rate + z * z / (2 * n), z * ((rate * (1 - rate) + z * z / (4 * n)) / n) ** 0.5
    return max(0.0, (centre - half) / (1 + z * z / n)), min(1.0, (centre + half) / (1 + z * z / n))
