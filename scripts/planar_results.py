"""Writes the tables of the planar domains in docs/results.md, from docs/planar.json.

    python scripts/planar_results.py [add EVALUATION.json --stage N --training-seed S ...]

`add` takes in files that `evaluate --json` wrote of the library after stage N that was trained with seed S; figures of
the same stage, seeds, scenario, method and horizon are replaced. Training seeds are summed in the tables, with the
successes of each behind the sum.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from resync_robot.core.files import read_text, write_text
from resync_robot.core.intervals import wilson

DOCS = Path(__file__).parents[1] / "docs"
BEGIN, END = "<!-- planar tables: scripts/planar_results.py writes them -->", "<!-- end of planar tables -->"
KEY = ("domain", "stage", "training_seed", "method", "scenario", "horizon", "seeds")
"""What tells figures apart."""
SOONER = 200
"""Control steps: the paper's horizon in Blocked Stacking."""
NAMES = {"resync": "this program", "rc": "Recovery Chaining", "initial": "given model only"}


def rows_of(evaluation: Mapping[str, Any], stage: int, training_seed: int) -> list[dict[str, Any]]:
    """The figures of one evaluation."""
    about = evaluation["provenance"]
    return [
        {
            **_sooner(evaluation, row),
            "domain": row["domain"],
            "stage": stage,
            "training_seed": training_seed,
            "method": row["method"],
            "scenario": row["scenario"],
            "horizon": about["horizon"],
            "seeds": [row["seed"]],
            "successes": row["successes"],
            "episodes": row["episodes"],
            "commit": about["git"][:7],
            "library": row["library_hash"][:12],
        }
        for row in evaluation["rows"]
    ]


def _sooner(evaluation: Mapping[str, Any], row: Mapping[str, Any]) -> dict[str, int]:
    """Successes within the paper's horizon, of the same episodes; nothing where their steps were not counted."""
    same = [
        e
        for e in evaluation.get("episodes", [])
        if all(e[k] == row[k] for k in ("method", "scenario", "seed", "library") if k in row)
    ]
    if len(same) != row["episodes"] or any(e.get("steps") is None for e in same):
        return {}
    return {"sooner": sum(e["success"] and e["steps"] <= SOONER for e in same)}


def merged(old: Iterable[dict[str, Any]], new: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """Both, the new figures in place of the old ones of the same kind, in the order of what tells them apart."""
    found = {json.dumps([row[k] for k in KEY]): row for row in (*old, *new)}

    def order(row: dict[str, Any]) -> tuple[Any, ...]:
        return (row["domain"], row["stage"], row["horizon"], int(row["scenario"]), row["method"], row["training_seed"])

    return sorted(found.values(), key=order)


def tables(data: Mapping[str, Any]) -> str:
    """Markdown: a table for each domain, stage and horizon; with how many of the same episodes were as quick as the
    paper's horizon, where that was counted."""
    shown: list[str] = []
    groups: dict[tuple[str, int, int], list[dict[str, Any]]] = {}
    for row in data["rows"]:
        groups.setdefault((row["domain"], row["stage"], row["horizon"]), []).append(row)
    for (domain, stage, horizon), rows in groups.items():
        methods = [m for m in NAMES if any(r["method"] == m for r in rows)]
        paper = data["paper"].get(domain, {}).get(str(stage), {})
        seeds = sorted({r["training_seed"] for r in rows if r["method"] == "resync"})
        commits = sorted({r["commit"] for r in rows})
        shown.append(
            f"{domain}, after stage {stage}, {horizon} control steps; training seeds {', '.join(map(str, seeds))} "
            f"({', '.join(commits)}):\n"
        )
        own = [r for r in rows if r["method"] == "resync"]
        sooner = [f"within {SOONER}"] if horizon > SOONER and own and all("sooner" in r for r in own) else []
        shown.append(f"| scenario | {' | '.join([*(NAMES[m] for m in methods), *sooner])} | paper |")
        shown.append("|---" * (len(methods) + len(sooner) + 2) + "|")
        for scenario in sorted({r["scenario"] for r in rows}, key=int):
            cells = [_cell([r for r in rows if r["scenario"] == scenario and r["method"] == m]) for m in methods]
            if sooner:
                same = [r for r in own if r["scenario"] == scenario]
                cells.append(f"{sum(r['sooner'] for r in same) / max(1, sum(r['episodes'] for r in same)):.2f}")
            shown.append(f"| {scenario} | {' | '.join(cells)} | {paper.get(scenario, '')} |")
        shown.append("")
    return "\n".join(shown).rstrip() + "\n"


def _cell(rows: list[dict[str, Any]]) -> str:
    won, tried = (sum(r[k] for r in rows) for k in ("successes", "episodes"))
    if not tried:
        return ""
    low, high = wilson(won, tried)
    each = ", ".join(str(r["successes"]) for r in rows)
    return f"{won / tried:.2f} [{low:.2f}, {high:.2f}] of {tried}" + (f": {each}" if len(rows) > 1 else "")


def written(page: str, text: str) -> str:
    """The page with the tables between its marks. Raises SystemExit where it has none."""
    if BEGIN not in page or END not in page:
        raise SystemExit(f"docs/results.md has no line '{BEGIN}' with '{END}' behind it")
    before, after = page.split(BEGIN)[0], page.split(END)[1]
    return f"{before}{BEGIN}\n\n{text}\n{END}{after}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command")
    add = commands.add_parser("add")
    add.add_argument("evaluations", type=Path, nargs="+")
    add.add_argument("--stage", type=int, required=True)
    add.add_argument("--training-seed", type=int, required=True)
    args = parser.parse_args()
    path, page = DOCS / "planar.json", DOCS / "results.md"
    data = json.loads(read_text(path))
    if args.command == "add":
        for file in args.evaluations:
            data["rows"] = merged(data["rows"], rows_of(json.loads(read_text(file)), args.stage, args.training_seed))
        rows = ",\n".join("  " + json.dumps(row) for row in data["rows"])
        write_text(path, f'{{"paper": {json.dumps(data["paper"])},\n"rows": [\n{rows}\n]}}\n')
    write_text(page, written(read_text(page), tables(data)))


if __name__ == "__main__":
    main()
