"""What has no meaning for a domain with a robot of its own is refused, by every command in the same words."""

from __future__ import annotations

from pathlib import Path

import pytest

from resync_robot import cli
from tests.domains import PUCK_FILE

RIG = ("--rig", "hardware/emulated.toml")


@pytest.mark.parametrize(
    ("command", "args"),
    [
        ("deploy", ("--backend", "ur7e")),
        ("deploy", ("--backend", "replay")),
        ("deploy", RIG),
        ("deploy", ("--perception", "camera")),
        ("deploy", ("--skills", "camera")),
        ("deploy", ("--segmenter", "sam3")),
        ("evaluate", RIG),
        ("evaluate", ("--perception", "camera")),
        ("evaluate", ("--skills", "camera")),
        ("evaluate", ("--worlds", "hard")),
        ("evaluate", ("--physics", "reference")),
        ("train-sim", RIG),
        ("train-sim", ("--device", "cuda")),
        ("train-sim", ("--skills", "camera")),
    ],
)
def test_options_of_the_arm_are_refused(
    command: str,
    args: tuple[str, ...],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main([command, "--domain", str(PUCK_FILE), *args]) == 2
    option = args[0] if args == RIG else " ".join(args)
    told = capsys.readouterr().err
    assert told.startswith(f"error: {option} is for domains of the arm, and this one has a robot of its own\n"), told
    assert "leave it out" in told and not any(tmp_path.iterdir())


@pytest.mark.parametrize("command", ["deploy", "evaluate"])
def test_it_needs_a_library_of_its_own(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    scenario = ["--scenario" if command == "deploy" else "--scenarios", "open"]
    assert cli.main([command, "--domain", str(PUCK_FILE), *scenario]) == 2
    told = capsys.readouterr().err
    assert (
        "no library folder comes with the program for 'puck-behind-a-door'" in told
        and "give one with --library" in told
    )
    assert not any(tmp_path.iterdir())
