"""Where runs lie, and which code they are of."""

from __future__ import annotations

import subprocess
from datetime import date
from pathlib import Path

from resync_robot.core.errors import ConfigError


def default_folder(name: str) -> Path:
    """runs/<date>-<name>, numbered where that exists."""
    base = Path("runs") / f"{date.today().isoformat()}-{name}"
    path, n = base, 2
    while path.exists():
        path, n = base.with_name(f"{base.name}-{n}"), n + 1
    return path


def latest_folder(name: str) -> Path:
    """The newest run of that name. Raises ConfigError where there is none."""
    found = sorted(Path("runs").glob(f"*-{name}*/config.json"), key=lambda p: p.stat().st_mtime)
    if not found:
        raise ConfigError(f"there is no run of '{name}' under runs/ to resume", "start one without --resume")
    return found[-1].parent


def git_hash() -> str:
    """The commit of the code that runs, '+' where it has changes; 'unknown' outside a checkout."""

    def git(*words: str) -> subprocess.CompletedProcess[str]:
        here = Path(__file__).parent
        return subprocess.run(
            ["git", *words], cwd=here, capture_output=True, encoding="utf-8", errors="replace", timeout=5
        )

    try:
        head, dirty = git("rev-parse", "--short=12", "HEAD"), git("status", "--porcelain", "-uno")
    except (OSError, subprocess.TimeoutExpired):
        return "unknown"
    return head.stdout.strip() + ("+" if dirty.stdout.strip() else "") if head.returncode == 0 else "unknown"
