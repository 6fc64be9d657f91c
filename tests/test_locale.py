"""What a file says, and what a rig is called by, is the same in every locale and from every editor."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.resources import files
from pathlib import Path

import pytest

from resync_robot.core.rig import load_rig

TEXT = "# Prüfstand Süd, 20 °C\n" + files("resync_robot.core").joinpath("simulated_rig.toml").read_text("utf-8")
PLAIN = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
"""A locale whose encoding is ASCII, and no help from Python."""


@pytest.mark.parametrize(
    "data",
    [TEXT.encode(), b"\xef\xbb\xbf" + TEXT.encode(), TEXT.replace("\n", "\r\n").encode()],
    ids=["plain", "with a mark", "line ends of Windows"],
)
def test_a_rig_is_the_same_in_every_locale_and_from_every_editor(data: bytes, tmp_path: Path) -> None:
    (tmp_path / "plain.toml").write_bytes(TEXT.encode())
    path = tmp_path / "rig.toml"
    path.write_bytes(data)
    assert load_rig(path).hash == load_rig(tmp_path / "plain.toml").hash
    code = (
        "import sys; from pathlib import Path; from resync_robot.core.rig import load_rig\n"
        "print(load_rig(Path(sys.argv[1])).hash)"
    )
    done = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, env=os.environ | PLAIN)
    assert done.returncode == 0, done.stderr
    assert done.stdout.decode().strip() == load_rig(path).hash


def test_a_rig_that_is_not_utf8_is_one_message(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_bytes(TEXT.encode("iso-8859-1"))
    command = [sys.executable, "-m", "resync_robot", "doctor", "--rig", str(path)]
    done = subprocess.run(command, capture_output=True, env=os.environ | PLAIN | {"PYTHONIOENCODING": "ascii"})
    assert done.returncode == 2 and b"Traceback" not in done.stdout + done.stderr
    assert b"cannot read the rig file" in done.stdout and b"UTF-8" in done.stdout
