"""The emulated lab from the command line."""

from __future__ import annotations

from pathlib import Path

import pytest

from resync_robot import cli
from tests.emulators import RIG_FILE


@pytest.mark.parametrize(
    ("args", "word"),
    [
        (("--rig", "/nowhere.toml"), "/nowhere.toml"),
        (("--rig", str(RIG_FILE), "--fault", "fire"), "unknown fault 'fire'"),
        (("--rig", str(RIG_FILE), "--fault", "freeze@soon"), "freeze@10"),
        (("--rig", str(RIG_FILE), "--seconds", "-1"), "--seconds is -1"),
    ],
)
def test_bad_input_is_one_error_with_code_2(
    args: tuple[str, ...], word: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["emulate", *args]) == 2
    shown = capsys.readouterr()
    assert shown.err.startswith("error: ") and word in shown.err
    assert shown.out == ""


def test_a_rig_that_is_not_emulated_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    real = tmp_path / "rig.toml"
    real.write_text(RIG_FILE.read_text().replace("emulated = true", "emulated = false"))
    assert cli.main(["emulate", "--rig", str(real)]) == 2
    assert "not an emulated one" in capsys.readouterr().err


@pytest.mark.parametrize("where", ["192.0.2.1", "0.0.0.0"])
def test_an_address_beyond_this_machine_is_refused(
    tmp_path: Path, where: str, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text(RIG_FILE.read_text().replace('"127.0.0.1"', f'"{where}"'))
    assert cli.main(["emulate", "--rig", str(rig)]) == 2
    assert "loopback" in capsys.readouterr().err
