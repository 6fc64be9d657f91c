"""Evaluation of perception alone: random scenes, scanned and compared with what is there."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from resync_robot import __version__
from resync_robot.console import Stages, say
from resync_robot.core.damage import check_shape
from resync_robot.core.errors import ConfigError
from resync_robot.core.files import FIGURE, check_output
from resync_robot.core.options import MOST_EPISODES, MOST_WORKERS, check_range, check_seeds
from resync_robot.core.rig import load_rig
from resync_robot.core.runs import git_hash
from resync_robot.evaluation.perception_report import draw_reliability, perception_report, perception_table
from resync_robot.evaluation.perception_trial import SCENE, ObjectRow, SceneRow, run_scene
from resync_robot.evaluation.report import count_once
from resync_robot.evaluation.result_file import ResultFile
from resync_robot.sim_training.parallel import parallel_map
from resync_robot.sim_training.physics.randomise import LOOKS


def evaluate_perception(
    scenes: int,
    seeds: Sequence[int],
    workers: int,
    json: Path | None,
    rig_file: Path | None = None,
    resume: bool = False,
    looks: str = "usual",
) -> None:
    """Scan `scenes` scenes of each seed, write a JSON file and a picture beside it where one is named, print the table.

    The file holds `summary`, one entry for each condition (`condition`, `n`, `found`, `found_ci95`; `median`, `p95` and
    `max` of `position_mm`, `yaw_deg`, `width_mm`, `height_mm`; `place_coverage` and `yaw_coverage`, level -> share of
    truths within that ellipse); `scenes`, `false_objects`, `views_median`, `seconds` (computing); `rows`, the fields of
    `perception_trial.SceneRow`; and `provenance`.

    Args:
        looks: of surfaces, light and camera, as in `resync_robot.sim_training.physics.randomise.LOOKS`.

    Raises:
        ResyncError: bad input, or no device can render.
    """
    check_range("--scenes", scenes, 1, MOST_EPISODES)
    check_seeds(seeds)
    check_range("--workers", workers, 1, MOST_WORKERS)
    if looks not in LOOKS:
        raise ConfigError(f"--worlds {looks} has no meaning with --perception-only", f"give one of {', '.join(LOOKS)}")
    rig, seeds = load_rig(rig_file), count_once("seed", seeds)
    if json:
        if json.suffix == ".png":
            raise ConfigError(f"--json {json} has the name of the picture beside it", "give a name such as report.json")
        check_output(json.with_suffix(".png"), FIGURE, [rig_file], f"--json {json}: its picture")
    jobs = [(seed, scene, looks) for seed in seeds for scene in range(scenes)]
    file = ResultFile(
        path=json,
        jobs=jobs,
        rows="rows",
        settings={"version": __version__, "git": git_hash(), "rig": rig.hash, "worlds": looks},
        more={"seeds": list(seeds), "scenes": scenes},
        inputs=[rig_file],
        report=perception_report,
        parse=partial(_parse, looks),
    )
    with file.open(resume), Stages(("scan",)) as bars, bars.stage("scan") as progress:
        todo = file.todo
        for job, row in zip(todo, parallel_map(run_scene, todo, partial(load_rig, rig_file), workers), strict=True):
            file.add(job, row)
            rows = file.done.values()
            found = sum(o.found for r in rows for o in r.objects) / sum(len(r.objects) for r in rows)
            progress(len(rows) / len(jobs), f"{100 * found:.1f} % found")
    report = perception_report(file.found)
    if json:
        draw_reliability(report, json.with_suffix(".png"))
    say(perception_table(report))


def _parse(looks: str, entry: Any) -> tuple[tuple[int, int, str], SceneRow]:
    """A row of a file that an earlier evaluation left. Raises KeyError, TypeError or ValueError."""
    check_shape(entry, SCENE)
    objects = tuple(ObjectRow(**o) for o in entry["objects"])
    row = SceneRow(**{**entry, "objects": objects, "seconds": tuple(entry["seconds"])})
    return (row.seed, row.scene, looks), row
