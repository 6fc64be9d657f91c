"""Episodes of an evaluation that nobody ran."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from typing import Any

from resync_robot.commands.evaluated_episode import Job
from resync_robot.evaluation.report import EpisodeRow


def pretended(run: object, jobs: Sequence[Job], context: object, workers: int) -> Iterator[EpisodeRow]:
    """Rows of episodes that nobody ran; each says by its reason when it was made."""
    for number, job in enumerate(jobs):
        yield EpisodeRow(
            **vars(job), success=job.episode % 2 == 0, end="goal" if job.episode % 2 == 0 else "stuck",
            reason=f"the {number}th", skills=1, planning_s=0.1, seconds=1.0, skills_run=("Pick(r, b0)",),
        )  # fmt: skip


def interrupted_after(count: int) -> Callable[..., Iterator[EpisodeRow]]:
    def run(*args: Any) -> Iterator[EpisodeRow]:
        yield from islice(pretended(*args), count)
        raise KeyboardInterrupt

    return run
