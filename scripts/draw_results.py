"""Draws docs/results.png, the chart of the README, from docs/results.json.

    python scripts/draw_results.py [SERIES=EVALUATION.json ...]

SERIES is a key of "series" in that file, such as camera. Given files that `evaluate --json` wrote, the figures of the
series are first replaced by theirs; a series named several times is the sum of its files. Prints what the README says.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from pathlib import Path
from typing import Any

from resync_robot.core.files import read_text, write_text
from resync_robot.core.intervals import wilson
from resync_robot.figures import save_figure

DOCS = Path(__file__).parents[1] / "docs"
COLOURS = ("#1f6fb4", "#e08214", "#9a9a9a")
WIDTH = 0.26
SEEN = {"camera": "all by camera", "oracle": "with the exact state"}
"""What a series is measured with, by the `--perception` of its evaluations."""


def counts(reached: dict[str, str]) -> dict[str, tuple[int, int]]:
    """(successes, episodes) of each scenario, from words such as "149 of 150"."""
    return {scenario: tuple(map(int, words.split(" of "))) for scenario, words in reached.items()}  # type: ignore[misc]


def take(series: dict[str, Any], files: list[Path]) -> None:
    """Replace the figures of one series by those of evaluations. Raises SystemExit where they are of another kind."""
    successes: Counter[str] = Counter()
    episodes: Counter[str] = Counter()
    commits: list[str] = []
    worlds: list[str] = []
    for file in files:
        found = json.loads(read_text(file))
        provenance = found["provenance"]
        for what in ("perception", "skills"):
            if provenance[what] != series[what]:
                raise SystemExit(f"{file}: {what} is {provenance[what]}; '{series['name']}' needs {series[what]}")
        rows = [row for row in found["rows"] if row["method"] == series["method"]]
        if not rows or sum(row["episodes"] for row in found["rows"]) < provenance["planned"]:
            raise SystemExit(f"{file}: it is unfinished, or holds no episode of the method {series['method']}")
        for row in rows:
            successes[row["scenario"]] += row["successes"]
            episodes[row["scenario"]] += row["episodes"]
        commits.append(provenance["git"][:7])
        worlds.append(provenance["worlds"])
    if len(set(worlds)) > 1:
        raise SystemExit(f"'{series['name']}': {' and '.join(sorted(set(worlds)))} worlds are not added up")
    series["worlds"], series["git"] = worlds[0], list(dict.fromkeys(commits))
    series["reached"] = {scenario: f"{successes[scenario]} of {episodes[scenario]}" for scenario in sorted(episodes)}


def sentence(series: dict[str, Any]) -> str:
    """How many episodes of all scenarios together reached their goal, as in the README."""
    found = counts(series["reached"]).values()
    return f"{sum(s for s, _ in found)} of {sum(n for _, n in found)}"


def draw(results: dict[str, Any], path: Path) -> None:
    """Success rates with Wilson intervals: the scenarios, and beside them the paper's real robot, as PNG."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    scenarios = sorted({s for series in results["series"].values() for s in series["reached"]})
    groups = list(dict.fromkeys(g for reached in results["paper"].values() for g in reached))
    places = {name: i + 0.5 * (name in groups) for i, name in enumerate([*scenarios, *groups])}
    figure, axis = plt.subplots(figsize=(8.4, 3.4), layout="constrained")
    for i, (key, series) in enumerate(results["series"].items()):
        found = counts({**series["reached"], **results["paper"].get(key, {})})
        rates = [s / n for s, n in found.values()]
        low, high = zip(*(wilson(s, n) for s, n in found.values()), strict=True)
        bars = axis.bar(
            [places[name] + (i - 1) * WIDTH for name in found],
            rates,
            WIDTH,
            color=COLOURS[i],
            label=f"{series['name']}\n(in simulation {SEEN[series['perception']]})",
            # Rounding can put a rate a hair outside its own interval.
            yerr=[[max(0.0, r - b) for r, b in zip(rates, low, strict=True)],
                  [max(0.0, b - r) for r, b in zip(rates, high, strict=True)]],
            error_kw={"elinewidth": 0.9, "ecolor": "#333333"},
        )  # fmt: skip
        for bar, rate, top in zip(bars, rates, high, strict=True):
            # In figures too: a bar of no height is a result, not one that is missing.
            at, colour = (0.02, "white") if rate > 0.2 else (top + 0.02, "#333333")
            middle = bar.get_x() + WIDTH / 2
            axis.text(middle, at, f"{rate:.2f}", ha="center", va="bottom", fontsize=6.5, rotation=90, color=colour)
    axis.axvline(len(scenarios) - 0.25, color="#999999", linewidth=0.8)
    axis.set_xticks(list(places.values()), [name.replace(" ", "\n") for name in places])
    axis.set(ylabel="episodes that reach their goal", ylim=(0, 1.05), xlim=(-0.6, max(places.values()) + 0.6))
    axis.text(len(scenarios) - 0.2, 1.08, "the paper's real robot", fontsize=9)
    axis.text(-0.6, 1.08, "simulation, by scenario", fontsize=9)
    axis.grid(axis="y", alpha=0.25)
    axis.set_axisbelow(True)
    figure.legend(loc="outside lower center", ncols=3, frameon=False, fontsize=9)
    save_figure(figure, path)
    plt.close(figure)


def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*", metavar="SERIES=EVALUATION.json")
    parser.add_argument("--docs", type=Path, default=DOCS, help="the folder that holds results.json")
    args = parser.parse_args(arguments)
    data = args.docs / "results.json"
    results = json.loads(read_text(data))
    given: dict[str, list[Path]] = {}
    for word in args.files:
        key, equals, file = word.partition("=")
        if not equals or key not in results["series"]:
            raise SystemExit(f"{word} is not SERIES=FILE with a series of {', '.join(results['series'])}")
        given.setdefault(key, []).append(Path(file))
    for key, files in given.items():
        take(results["series"][key], files)
    if given:
        write_text(data, json.dumps(results, indent=2) + "\n")
    draw(results, args.docs / "results.png")
    for series in results["series"].values():
        print(f"{series['name']}: {sentence(series)}, {', '.join(series['git'])}")


if __name__ == "__main__":
    main(sys.argv[1:])
