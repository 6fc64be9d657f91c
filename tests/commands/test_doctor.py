"""The doctor: what is whole is called ok, what is broken is called by its name, with the command that mends it."""

import json
import sys
from importlib.resources import files
from pathlib import Path

import pytest

from resync_robot import cli
from resync_robot.commands import doctor
from resync_robot.commands.doctor import Finding
from resync_robot.console import show_findings
from resync_robot.core.library import Library, save_library

HEALTHY = Finding("vulkan", "ok", "a renderer")


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the probes that load libraries in other processes."""
    monkeypatch.setattr(doctor, "check_vulkan", lambda: HEALTHY)
    monkeypatch.setattr(doctor, "check_cuda", lambda: Finding("cuda", "ok", "none"))


def test_json_has_every_finding(quick: None, capsys: pytest.CaptureFixture[str]) -> None:
    code = cli.main(["doctor", "--json"])
    report = json.loads(capsys.readouterr().out)
    names = [f["name"] for f in report["findings"]]
    assert names == ["python", "packages", "opencv", "vulkan", "cuda", "ffmpeg", "rig", "library", "disk", "robot"]
    for finding in report["findings"]:
        assert set(finding) == {"name", "status", "detail", "fix"}
        assert finding["status"] in ("ok", "warn", "fail")
        assert finding["status"] == "ok" or finding["fix"]
    assert report["healthy"] == (code == 0)


def test_what_fails_shows_its_mending_command_and_code_2(
    quick: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text(files("resync_robot.core").joinpath("simulated_rig.toml").read_text() + "\ntilt = 1\n")
    assert cli.main(["doctor", "--rig", str(rig)]) == 2
    shown = capsys.readouterr().out
    assert "fail rig" in shown
    assert "unknown field tilt" in shown
    assert "-> its fields are" in shown


def test_a_rig_in_the_wrong_unit_fails_with_the_likely_one(tmp_path: Path) -> None:
    rig, text = tmp_path / "rig.toml", files("resync_robot.core").joinpath("simulated_rig.toml").read_text()
    rig.write_text(text.replace("max_opening = 0.14 ", "max_opening = 140"))
    finding = doctor.check_rig(rig)
    assert finding.status == "fail" and "max_opening is 140 m; allowed: 0.01 to 0.2 m" in finding.detail
    assert finding.fix == "140 looks like mm: 0.14 m"
    rig.write_text(text.replace('"sim-side"', '"sim-front"'))
    assert doctor.check_rig(rig).status == "fail"
    rig.write_text(text.replace('"sim-side"', '""').replace("max_force = 40.0", "max_force = 126"))
    assert str(rig) in doctor.check_rig(rig).fix, "what has no likely unit has a next command all the same"


def test_brackets_in_a_finding_are_shown_as_they_are(capsys: pytest.CaptureFixture[str]) -> None:
    show_findings([Finding("robot", "warn", "[arm] is missing", "install '.[hardware]'")])
    shown = capsys.readouterr().out
    assert "[arm] is missing" in shown
    assert "'.[hardware]'" in shown


def test_a_probe_that_dies_is_a_finding(quick: None, monkeypatch: pytest.MonkeyPatch) -> None:
    def die() -> Finding:
        raise OSError("no such disk")

    monkeypatch.setattr(doctor, "check_disk", die)
    finding = next(f for f in doctor.examine() if f.name == "disk")
    assert (finding.status, finding.detail) == ("fail", "OSError: no such disk")


def test_python() -> None:
    assert doctor.check_python().status == "ok"
    assert doctor.check_python((3, 10)).status == "fail"


def test_packages_are_compared_with_the_pins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor.metadata, "requires", lambda name: ["pyperplan", "tyro>=1"])
    pins = tmp_path / "constraints.txt"
    pins.write_text("# a comment\nPyPerPlan==0.0.1  # old\nnot-installed==1.0\n")
    finding = doctor.check_packages(pins)
    assert finding.status == "warn"
    assert "instead of 0.0.1" in finding.detail
    assert "not-installed" not in finding.detail
    assert doctor.check_packages(tmp_path / "absent.txt").status == "warn"


def test_an_installation_that_is_none_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(name: str) -> list[str]:
        raise doctor.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(doctor.metadata, "requires", absent)
    (tmp_path / "constraints.txt").write_text("")
    finding = doctor.check_packages(tmp_path / "constraints.txt")
    assert (finding.status, finding.fix) == ("fail", "make setup")


def test_a_missing_requirement_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    needs = ["numpy>=2", "warp-drive<9", "pytest; extra == 'dev'", "coffee; extra == 'dev'"]
    monkeypatch.setattr(doctor.metadata, "requires", lambda name: needs)
    (tmp_path / "constraints.txt").write_text("")
    finding = doctor.check_packages(tmp_path / "constraints.txt")
    assert (finding.status, finding.detail) == ("fail", "not installed: warp-drive")


def test_opencv_loads() -> None:
    finding = doctor.check_opencv()
    assert finding.status == "ok"
    assert finding.detail.startswith("4.")


@pytest.mark.parametrize(
    ("name", "version", "status"),
    [
        ("opencv-python", "5.0.0", "fail"),
        ("opencv-python", "4.11.0.86", "warn"),
        ("opencv_contrib_python_headless", "4.11.0.86", "warn"),
    ],
)
def test_two_packages_of_opencv_are_found_and_mended(
    name: str, version: str, status: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Package:
        def __init__(self, name: str, version: str) -> None:
            self.metadata, self.version = {"Name": name}, version

    both = [Package(name, version), Package("opencv_python_headless", "4.11.0.86")]
    monkeypatch.setattr(doctor.metadata, "distributions", lambda: both)
    finding = doctor.check_opencv()
    assert finding.status == status
    assert f"{name.replace('_', '-')} {version}" in finding.detail
    assert "pip uninstall -y opencv-python" in finding.fix


@pytest.mark.parametrize(
    ("code", "status", "detail"),
    [
        ("print('GPU: lavapipe')", "ok", "lavapipe"),
        ("raise SystemExit('failed to find a rendering device')", "fail", "failed to find a rendering device"),
        ("import os; os.abort()", "fail", "nothing to render with"),
        ("pass", "fail", "nothing to render with"),
        ("import time; time.sleep(60)", "fail", "no answer within"),
    ],
)
def test_vulkan(code: str, status: str, detail: str, monkeypatch: pytest.MonkeyPatch) -> None:
    probe = doctor.run_probe
    limit = 0.5 if "sleep" in code else 30.0
    monkeypatch.setattr(doctor, "run_probe", lambda command: probe([sys.executable, "-c", code], limit))
    finding = doctor.check_vulkan()
    assert finding.status == status
    assert detail in finding.detail
    assert (finding.fix == "") == (status == "ok")


def test_no_gpu_is_said_and_is_ok(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor.shutil, "which", lambda name: None)
    finding = doctor.check_cuda()
    assert finding.status == "ok"
    assert "no GPU; optional" in finding.detail


@pytest.mark.parametrize(("answer", "status"), [("print('H200')", "ok"), ("print('')", "warn"), ("1 / 0", "warn")])
def test_a_gpu_that_torch_cannot_use_is_a_warning(answer: str, status: str, monkeypatch: pytest.MonkeyPatch) -> None:
    probe = doctor.run_probe
    monkeypatch.setattr(doctor.shutil, "which", lambda name: f"/usr/bin/{name}")
    monkeypatch.setattr(doctor, "run_probe", lambda command: probe([sys.executable, "-c", answer]))
    assert doctor.check_cuda().status == status


def test_libraries(tmp_path: Path) -> None:
    assert doctor.check_libraries(tmp_path).status == "warn"
    folder = tmp_path / "test-domain"
    save_library(Library("test-domain", "abc", "(define)", {}, {}, (), {}), folder)
    finding = doctor.check_libraries(tmp_path)
    assert finding.status == "ok"
    assert "test-domain" in finding.detail
    (folder / "domain.pddl").write_text("(other)")
    finding = doctor.check_libraries(tmp_path)
    assert finding.status == "fail"
    assert "domain.pddl" in finding.detail


@pytest.mark.parametrize(("free", "status"), [(5e8, "fail"), (5e9, "warn"), (5e10, "ok")])
def test_disk(free: float, status: str) -> None:
    assert doctor.check_disk(int(free)).status == status
