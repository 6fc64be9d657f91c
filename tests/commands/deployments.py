"""Deployments of a test, and the recordings that they leave."""

from __future__ import annotations

from pathlib import Path

from resync_robot import cli

RIG = str(Path(__file__).parents[2] / "hardware" / "emulated.toml")


def episodes(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.mcap"))


def oracle(library: Path, out: Path, *more: str) -> int:
    """The exit code of a deployment to `out` that sees by the simulator's state."""
    return cli.main(["deploy", "--library", str(library), "--perception", "oracle", "--out", str(out), *more])
