"""Pictures of figures, for run folders and the README."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image, ImageDraw

from resync_robot.figures import font, save_figure
from resync_robot.planning.model_graph import ModelGraph, Node

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BLUE, GREY, ORANGE = "#1f6fb4", "#999999", "#d9780f"


def contact_sheet(shown: UInt8[np.ndarray, "r c v h w 3"], views: Sequence[str]) -> UInt8[np.ndarray, "y x 3"]:
    """Pictures of several runs, a row each, at moments from begin to end, by several cameras; with their names."""
    rows, columns, cameras, height, width = shown.shape[:5]
    left, above, gap = 56, 40, 10
    step = cameras * width + gap
    sheet = Image.new("RGB", (left + columns * step - gap, above + rows * height), (255, 255, 255))
    draw = ImageDraw.Draw(sheet)
    for c in range(columns):
        x = left + c * step
        share = 100 * c / max(1, columns - 1)
        moment = "begin" if c == 0 else "end" if c == columns - 1 else f"{share:.0f} % of the time"
        draw.text((x + cameras * width / 2, 11), moment, (0, 0, 0), font(13, True), anchor="mm")
        for v, view in enumerate(views):
            draw.text((x + (v + 0.5) * width, 30), view, (80, 80, 80), font(12), anchor="mm")
            for r in range(rows):
                sheet.paste(Image.fromarray(shown[r, c, v]), (x + v * width, above + r * height))
    for r in range(rows):
        draw.text((left - 8, above + (r + 0.5) * height), f"world {r + 1}", (80, 80, 80), font(11), anchor="rm")
    return np.asarray(sheet)


def draw_learning_curve(
    curve: Mapping[str, Sequence[float]], path: Path, first_time_limit: float = 0.0, stop_at: float | None = None
) -> None:
    """Success rate over control steps, as PNG.

    Args:
        first_time_limit: control steps after which the first episodes run out of time. Before, only those count that
            ended early, so that the rate may begin too high, and fall.
        stop_at: rate at which training may end.
    """
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axis = plt.subplots(figsize=(6.4, 4.0), layout="constrained")
    steps, rates = np.array(curve["steps"]) / 1000, 100 * np.array(curve["success"])
    counted = np.array(curve["steps"]) >= first_time_limit
    axis.plot(steps[counted], rates[counted], color=BLUE, linewidth=2)
    caption = "Episodes as PPO samples them, noise and all; mean over the last 400 that ended."
    early = np.flatnonzero(~counted)
    if len(early):
        axis.plot(steps[: len(early) + 1], rates[: len(early) + 1], color=GREY, linewidth=1, linestyle=":")
        axis.axvspan(0, first_time_limit / 1000, color=GREY, alpha=0.2, linewidth=0)
        caption += (
            "\nGrey: no episode has run out of time yet, so only those count that ended early. Where the rate falls"
            "\nbehind it no skill is lost: from there on all of them count."
        )
    if stop_at is not None:
        axis.axhline(100 * stop_at, color=GREY, linewidth=0.8, linestyle="--")
        axis.text(
            0.99, 100 * stop_at - 2, f"training may end at {100 * stop_at:.0f} %", fontsize=8, color="#555555",
            va="top", ha="right", transform=axis.get_yaxis_transform(),
        )  # fmt: skip
    axis.set(xlabel="control steps (thousands)", ylabel="episodes recovered (%)", ylim=(0, 102), xlim=(0, None))
    axis.grid(alpha=0.25)
    minutes = curve["seconds"][-1] / 60
    axis.set_title(
        f"Learning the recovery: {rates[-1]:.0f} % after {steps[-1]:.0f} k steps, {minutes:.1f} min", fontsize=10
    )
    figure.supxlabel(caption, fontsize=8, color="#555555")
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

    figure, (upper, lower) = plt.subplots(2, 1, figsize=(6.4, 5.0), sharex=True, layout="constrained")
    steps = np.array([p["step"] for p in points])
    shares = [(p["success"], max(1, p["worlds"])) for p in points]
    rates = np.array([100 * good / of for good, of in shares])
    upper.plot(steps, rates, "o", color=BLUE)
    for step, rate, (good, of) in zip(steps, rates, shares, strict=True):
        words = f"{good:.0f} of {of:.0f}" + (", kept" if step == chosen else "")
        upper.annotate(words, (step, rate), (0, -14), textcoords="offset points", fontsize=8, ha="center")
    upper.set(ylabel="worlds recovered (%)", ylim=(0, 105))
    kept = float(rates[list(steps).index(chosen)]) if chosen in steps else float(rates.max())
    upper.set_title(f"The camera policy: recovers {kept:.0f} % of worlds that it was not trained in", fontsize=10)
    lower.plot([s for s, _ in losses], [v for _, v in losses], color="#666666", linewidth=1)
    lower.set(xlabel="training steps", ylabel="loss of the action", yscale="log", xlim=(0, 1.06 * steps.max()))
    for axis in (upper, lower):
        axis.grid(alpha=0.25)
        for step in steps[:-1]:
            axis.axvline(step, color=GREY, linewidth=0.8, linestyle="--")
    figure.supxlabel(
        "Above: the policy as it was then, alone, at the first attempt. Below: error of what it does, on its training"
        "\npictures. Dashed: it has driven by itself, and what its teacher showed it from there joins its pictures.",
        fontsize=8,
        color="#555555",
    )
    save_figure(figure, path)
    plt.close(figure)


def draw_model(graph: ModelGraph, path: Path) -> None:
    """Which skill makes what true for which, from above to below, as PNG: skills framed, what was learned orange.

    What a skill brings back for an earlier one is drawn dotted.
    """
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    places = graph.places()
    wide, across = 0.085 * max(len(n.name) for n in places) + 0.35, max(len(layer) for layer in graph.layers)
    figure = plt.figure(figsize=(wide * across, 0.55 * len(graph.layers)))
    axis = figure.add_axes((0, 0, 1, 1), xlim=(-wide * across / 2, wide * across / 2), ylim=(0, len(graph.layers)))
    axis.set_axis_off()
    where = {n: np.array([wide * x, len(graph.layers) - layer - 0.5]) for n, (x, layer) in places.items()}
    halves = {node: _draw_node(node, where[node], axis) for node in places}
    for a, b in graph.edges:
        down = places[a][1] < places[b][1]
        arrow = {"arrowstyle": "-|>", "color": BLUE if down else GREY, "linestyle": "-" if down else ":"}
        bent = {"connectionstyle": f"arc3,rad={0 if down else 0.25}", "shrinkA": 0, "shrinkB": 1}
        # From edge to edge of what they are written in.
        along = where[b] - where[a]
        begin, end = (along * np.min(halves[n] / np.maximum(np.abs(along), 1e-9)) for n in (a, b))
        axis.annotate("", where[b] - end, where[a] + begin, arrowprops={**arrow, **bent}, zorder=0)
    save_figure(figure, path)
    plt.close(figure)


def _draw_node(node: Node, at: Float[np.ndarray, "2"], axis: Axes) -> Float[np.ndarray, "2"]:
    """Half the width and half the height of its frame, as long as the axes as `at`."""
    colour = ORANGE if node.learned else BLUE if node.skill else "black"
    ink, face = ("white", colour) if node.skill else (colour, "white")
    around = {"boxstyle": "round,pad=0.25", "facecolor": face, "edgecolor": colour if node.learned else face}
    weight = "bold" if node.skill else "normal"
    text = axis.text(*at, node.name, color=ink, size=9, weight=weight, ha="center", va="center", bbox=around)
    axis.figure.draw_without_rendering()  # only then has the frame its size
    drawn = text.get_bbox_patch().get_window_extent().transformed(axis.transData.inverted())
    return np.array([drawn.width, drawn.height]) / 2
