"""Pictures of figures, for run folders and the README."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path


def draw_learning_curve(curve: Mapping[str, Sequence[float]], path: Path) -> None:
    """Success rate over control steps and minutes, as PNG."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axis = plt.subplots(figsize=(6, 3.4), layout="constrained")
    steps = [s / 1000 for s in curve["steps"]]
    axis.plot(steps, [100 * r for r in curve["success"]], color="#1f6fb4", linewidth=2)
    axis.set(xlabel="control steps (thousands)", ylabel="episodes recovered (%)", ylim=(0, 102), xlim=(0, None))
    axis.axhline(95, color="#999999", linewidth=0.8, linestyle="--")
    axis.grid(alpha=0.25)
    axis.set_title(f"Recovery skill: {steps[-1]:.0f} k steps in {curve['seconds'][-1] / 60:.1f} min", fontsize=10)
    figure.savefig(path, dpi=130)
    plt.close(figure)
