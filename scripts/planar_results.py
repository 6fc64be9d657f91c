"""Writes the tables of the planar domains in docs/results.md, from docs/planar.json.

    python scripts/planar_results.py [add EVALUATION.json --stage N --training-seed S [--variant NAME] ...]

`add` takes in files that `evaluate --json` wrote of the library after stage N that was trained with seed S; figures of
the same stage, seeds, scenario, method, horizon and variant are replaced. Training seeds are summed in the tables, with
the successes of each behind the sum. A variant is a library that was learned with something left out or otherwise
(tests/benchmarks/learning_ablations.py); it goes into tables of its own.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from resync_robot.core.files import read_text, write_text
from resync_robot.core.intervals import wilson

DOCS = Path(__file__).parents[1] / "docs"
BEGIN, END = "<!-- planar tables: scripts/planar_results.py writes them -->", "<!-- end of planar tables -->"
KEY = ("domain", "stage", "training_seed", "method", "scenario", "horizon", "seeds", "variant")
"""What tells figures apart."""
SOONER = 200
"""Control steps: the paper's horizon in Blocked Stacking."""
WHOLE = "whole"
"""The variant that leaves nothing out."""
NAMES = {"resync": "this program", "rc": "Recovery Chaining", "initial": "given model only"}


def rows_of(
    evaluation: Mapping[str, Any], stage: int, training_seed: int, variant: str = WHOLE
) -> list[dict[str, Any]]:
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
            **({} if variant == WHOLE else {"variant": variant}),
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
    found = {json.dumps([row.get(k, WHOLE) for k in KEY]): row for row in (*old, *new)}

    def order(row: dict[str, Any]) -> tuple[Any, ...]:
        what = row["domain"], row["stage"], row["horizon"], row.get("variant", ""), int(row["scenario"])
        return (*what, row["method"], row["training_seed"])

    return sorted(found.values(), key=order)


def tables(data: Mapping[str, Any]) -> str:
    """Markdown: a table for each domain, stage and horizon; with how many of the same episodes were as quick as the
    paper's horizon, where that was counted."""
    shown: list[str] = []
    groups: dict[tuple[str, int, int], list[dict[str, Any]]] = {}
    for row in (r for r in data["rows"] if "variant" not in r):
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
    return "\n".join([*shown, *_variant_tables(data["rows"], data.get("scenarios", {}))]).rstrip() + "\n"


def _variant_tables(rows: Sequence[Mapping[str, Any]], scenarios: Mapping[str, Mapping[str, str]]) -> list[str]:
    """A table for each domain, stage and horizon that a variant was tried at: success by what the scenarios are.

    Args:
        scenarios: of each domain and stage ("blocked-stacking 2"), what each is: "train", "test", "earlier".
    """
    shown: list[str] = []
    tried = dict.fromkeys((r["domain"], r["stage"], r["horizon"]) for r in rows if "variant" in r)
    for domain, stage, horizon in tried:
        same = [
            r
            for r in rows
            if (r["domain"], r["stage"], r["horizon"], r["method"]) == (domain, stage, horizon, "resync")
        ]
        kinds = scenarios.get(f"{domain} {stage}", {})
        groups = list(dict.fromkeys(kinds.values()))
        shown.append(f"{domain}, after stage {stage}, {horizon} control steps, with something left out or otherwise:\n")
        shown += [f"| variant | {' | '.join(groups)} |", "|---" * (len(groups) + 1) + "|"]
        for variant in dict.fromkeys(r.get("variant", WHOLE) for r in same):
            of = [r for r in same if r.get("variant", WHOLE) == variant]
            cells = [_by_seed([r for r in of if kinds.get(r["scenario"]) == group]) for group in groups]
            shown.append(f"| {variant} ({', '.join(sorted({r['commit'] for r in of}))}) | {' | '.join(cells)} |")
        shown.append("")
    return shown


def _by_seed(rows: Sequence[Mapping[str, Any]]) -> str:
    """Several scenarios together, for each training seed and on the whole."""
    sums = [
        {k: sum(r[k] for r in rows if r["training_seed"] == seed) for k in ("successes", "episodes")}
        for seed in sorted({r["training_seed"] for r in rows})
    ]
    return _cell(sums)


def _cell(rows: Sequence[Mapping[str, Any]]) -> str:
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
    add.add_argument("--variant", default=WHOLE)
    add.add_argument("--domain", help="whose table it goes to; default: that of the evaluation")
    args = parser.parse_args()
    path, page = DOCS / "planar.json", DOCS / "results.md"
    data = json.loads(read_text(path))
    if args.command == "add":
        for file in args.evaluations:
            rows = rows_of(json.loads(read_text(file)), args.stage, args.training_seed, args.variant)
            data["rows"] = merged(data["rows"], [{**r, "domain": args.domain or r["domain"]} for r in rows])
        lines = ",\n".join("  " + json.dumps(row) for row in data["rows"])
        heads = "".join(f'"{k}": {json.dumps(v)},\n' for k, v in data.items() if k != "rows")
        write_text(path, f'{{{heads}"rows": [\n{lines}\n]}}\n')
    write_text(page, written(read_text(page), tables(data)))


if __name__ == "__main__":
    main()
