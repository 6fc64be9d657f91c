"""Evaluation of perception alone: random scenes, scanned and compared with what is there."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from resync_robot import __version__
from resync_robot.core.ranges import MOST_EPISODES, MOST_WORKERS, check_range, check_seeds
from resync_robot.core.rig import load_rig
from resync_robot.perception_report import draw_reliability, perception_report, perception_table
from resync_robot.perception_trial import SceneRow, run_scene
from resync_robot.progress import Stages, say
from resync_robot.run_folder import check_writable, git_hash, write_json
from sim_training.parallel import parallel_map


def evaluate_perception(
    scenes: int, seeds: Sequence[int], workers: int, json: Path | None, rig_file: Path | None = None
) -> None:
    """Scan `scenes` scenes of each seed, write a JSON file and a picture beside it where one is named, print the table.

    The file holds `summary`, one entry for each condition (`condition`, `n`, `found`, `found_ci95`; `median`, `p95` and
    `max` of `position_mm`, `yaw_deg`, `width_mm`, `height_mm`; `place_coverage` and `yaw_coverage`, level -> share of
    truths within that ellipse); `scenes`, `false_objects`, `views_median`, `seconds` (computing); `rows`, the fields of
    `perception_trial.SceneRow`; and `provenance`.

    Raises:
        ResyncError: bad input, or no device can render.
    """
    check_range("--scenes", scenes, 1, MOST_EPISODES)
    check_seeds(seeds)
    check_range("--workers", workers, 1, MOST_WORKERS)
    rig = load_rig(rig_file)
    if json:
        check_writable(json)
    jobs = [(seed, scene) for seed in seeds for scene in range(scenes)]
    done: list[SceneRow] = []
    with Stages(("scan",)) as bars, bars.stage("scan") as progress:
        for row in parallel_map(run_scene, jobs, partial(load_rig, rig_file), workers):
            done.append(row)
            found = sum(o.found for r in done for o in r.objects) / sum(len(r.objects) for r in done)
            progress(len(done) / len(jobs), f"{100 * found:.1f} % found")
    report = perception_report(done)
    if json:
        provenance = {
            "version": __version__,
            "git": git_hash(),
            "rig": rig.hash,
            "seeds": list(seeds),
            "scenes": scenes,
        }
        write_json(json, {"provenance": provenance, **report})
        draw_reliability(report, json.with_suffix(".png"))
    say(perception_table(report))
