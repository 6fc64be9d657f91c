"""new-domain writes a domain that keeps the contract, and over nothing."""

from pathlib import Path

import pytest

from resync_robot import cli
from resync_robot.sim_training.domains import find_domain


def test_what_it_writes_passes_check_domain(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(["new-domain", "drive-about"]) == 0
    assert "check-domain drive_about.py" in capsys.readouterr().out
    assert find_domain("drive_about.py").name == "drive-about"
    assert cli.main(["check-domain", "drive_about.py", "--worlds", "4"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert all(line.startswith("ok ") for line in lines)
    assert lines[-1].endswith("fails in 4 of 4, on c0")


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (("Drive About",), "use small letters"),
        (("mine", "--out", "kept.py"), "kept.py exists; it is left as it is"),
        (("mine", "--out", "mine.txt"), "let it end in .py"),
    ],
)
def test_what_it_refuses(
    args: tuple[str, ...],
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("kept.py").write_text("mine", encoding="utf-8")
    assert cli.main(["new-domain", *args]) == 2
    assert words in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["kept.py"] and Path("kept.py").read_text(encoding="utf-8") == "mine"
