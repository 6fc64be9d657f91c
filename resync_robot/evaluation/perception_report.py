"""What an evaluation of perception found: errors by condition, objects missed and made up, how honest the doubt is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.stats import chi2

from resync_robot.core.intervals import wilson
from resync_robot.figures import save_figure

if TYPE_CHECKING:
    from resync_robot.evaluation.perception_trial import ObjectRow, SceneRow

LEVELS = (0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99)
"""Nominal levels at which ellipses are checked."""
FIGURES = ("position_mm", "yaw_deg", "width_mm", "height_mm")
ALL, TWINS = "all blocks", "two of one colour"


def perception_report(scenes: Sequence[SceneRow]) -> dict[str, Any]:
    """The rows as plain data with their summary; `perception.evaluate_perception` describes the fields."""
    objects = [o for s in scenes for o in s.objects]
    seconds = [t for s in scenes for t in s.seconds]
    return {
        "summary": [_summary(name, rows) for name, rows in _by_condition(objects)],
        "scenes": len(scenes),
        "false_objects": sum(s.false for s in scenes),
        "seconds": {"median": float(np.median(seconds)), "p95": float(np.percentile(seconds, 95))},
        "views_median": float(np.median([s.views for s in scenes])),
        "rows": [asdict(s) for s in scenes],
    }


def perception_table(report: dict[str, Any]) -> str:
    """Markdown; a pair of numbers is median and 95th percentile."""
    lines = [
        "| condition | n | found | position mm | yaw deg | width mm | height mm | in 95 % ellipse | yaw in 95 % |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for row in report["summary"]:
        cells = [f"{row[f]['median']:.2f}, {row[f]['p95']:.2f}" if row[f] else "-" for f in FIGURES]
        cells += [f"{100 * row[c]['0.95']:.0f} %" if row[c] else "-" for c in ("place_coverage", "yaw_coverage")]
        share = 100 * row["found"] / row["n"]
        lines.append(f"| {row['condition']} | {row['n']} | {share:.1f} % | " + " | ".join(cells) + " |")
    t = report["seconds"]
    lines.append(
        f"\n{report['scenes']} scenes, {report['false_objects']} false objects; computing a scan of "
        f"{report['views_median']:.0f} views: median {t['median']:.2f} s, p95 {t['p95']:.2f} s."
    )
    return "\n".join(lines)


def draw_reliability(report: dict[str, Any], path: Path) -> None:
    """How often the truth lies within ellipses of each level, against that level, as PNG."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axis = plt.subplots(figsize=(5.6, 5.4), layout="constrained")
    levels = np.array(LEVELS)
    axis.plot([0.45, 1], [0.45, 1], color="#666666", linewidth=1, linestyle="--", label="as it should be")
    for row in report["summary"]:
        if not row["place_coverage"] or row["n"] < 10:
            continue
        thick = 2.5 if row["condition"] == ALL else 1.0
        share = [row["place_coverage"][str(level)] for level in levels]
        axis.plot(levels, share, "o-", markersize=3, linewidth=thick, label=f"{row['condition']} ({row['n']})")
    axis.set(
        xlabel="probability that the robot gives to its ellipse",
        ylabel="share of true positions within the ellipse",
        xlim=(0.45, 1),
        ylim=(0.3, 1.01),
    )
    axis.set_title(f"How honest is the doubt about where things are? {report['scenes']} scenes", fontsize=10)
    figure.supxlabel(
        "Above the dashed line the robot is too cautious, below it too sure. In brackets: how many were looked at.",
        fontsize=8,
        color="#555555",
    )
    axis.grid(alpha=0.25)
    axis.legend(fontsize=7)
    save_figure(figure, path)
    plt.close(figure)


def _by_condition(objects: Sequence[ObjectRow]) -> list[tuple[str, list[ObjectRow]]]:
    names = sorted({o.condition for o in objects})
    groups = [(name, [o for o in objects if o.condition == name]) for name in names]
    groups.append((TWINS, [o for o in objects if o.twin]))
    blocks = [o for o in objects if o.name != "box"]
    return [(name, rows) for name, rows in (*groups, (ALL, blocks)) if rows]


def _summary(name: str, rows: Sequence[ObjectRow]) -> dict[str, Any]:
    found = [r for r in rows if r.found]
    entry: dict[str, Any] = {"condition": name, "n": len(rows), "found": len(found)}
    entry["found_ci95"] = list(wilson(len(found), len(rows)))
    for figure in FIGURES:
        values = [getattr(r, figure) for r in found]
        entry[figure] = (
            {"median": float(np.median(values)), "p95": float(np.percentile(values, 95)), "max": float(max(values))}
            if values
            else None
        )
    for key, distance, freedom in (("place_coverage", "place_distance", 2), ("yaw_coverage", "yaw_distance", 1)):
        distances = np.array([getattr(r, distance) for r in found])
        entry[key] = (
            {str(level): float(np.mean(distances <= chi2.ppf(level, freedom))) for level in LEVELS} if found else None
        )
    return entry
