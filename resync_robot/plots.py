"""Pictures of figures, for run folders and the README."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from resync_robot.core.files import whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def save_figure(figure: Figure, path: Path) -> None:
    """Write it as PNG, whole or not at all, with this program's name in it (`core.files.FIGURE`). Raises OSError."""
    with whole(path) as beside:
        figure.savefig(beside, dpi=130, format="png", metadata={"Software": "resync-robot"})


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
    save_figure(figure, path)
    plt.close(figure)


def draw_distillation(
    losses: Sequence[tuple[float, float]], points: Sequence[Mapping[str, float]], chosen: int, path: Path
) -> None:
    """Loss of the camera policy, and how often it recovered in closed loop, over training steps, as PNG.

    Args:
        losses: (step, loss of the action).
        points: `step`, `success` and `worlds` of each trial.
        chosen: the step whose policy was kept.
    """
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axis = plt.subplots(figsize=(6, 3.4), layout="constrained")
    axis.plot([s for s, _ in losses], [v for _, v in losses], color="#999999", linewidth=1)
    axis.set(xlabel="training steps", ylabel="loss of the action", yscale="log", xlim=(0, None))
    right = axis.twinx()
    rates = [100 * p["success"] / max(1, p["worlds"]) for p in points]
    right.plot([p["step"] for p in points], rates, "o-", color="#1f6fb4", linewidth=2)
    right.axvline(chosen, color="#1f6fb4", linewidth=0.8, linestyle="--")
    right.set(ylabel="recovered by camera (%)", ylim=(0, 102))
    axis.set_title(f"Camera policy: {max(rates):.0f} % of {points[-1]['worlds']:.0f} held-out worlds", fontsize=10)
    save_figure(figure, path)
    plt.close(figure)
