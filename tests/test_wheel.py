"""The installed package: one name in site-packages, whole without a checkout, and at home in any folder."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = ("hardware", "perception", "policies", "calibration", "sim_training")


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that holds nothing but what the wheel brings; its dependencies are those of this interpreter."""
    wheels, site = tmp_path_factory.mktemp("wheel"), tmp_path_factory.mktemp("site")
    source = tmp_path_factory.mktemp("source") / "resync-robot"
    # Built from a copy: a build leaves its own folders beside the sources.
    names = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True)
    if names.returncode:
        pytest.skip("no checkout")
    for name in names.stdout.rstrip("\0").split("\0"):
        if not name.startswith(("tests/", "docs/")) and (ROOT / name).exists():
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            copied = (ROOT / name).readlink() if (ROOT / name).is_symlink() else None
            if copied is not None:
                (source / name).symlink_to(copied)
            else:
                (source / name).write_bytes((ROOT / name).read_bytes())
    pip = [sys.executable, "-m", "uv", "pip", "install", "--quiet", "--no-deps", "--target", str(site)]
    build = [
        sys.executable,
        "-m",
        "uv",
        "build",
        "--quiet",
        "--wheel",
        "--no-build-isolation",
        "--out-dir",
        str(wheels),
    ]
    subprocess.run([*build, "--python", sys.executable, str(source)], check=True, timeout=120)
    subprocess.run([*pip, "--python", sys.executable, *map(str, wheels.glob("*.whl"))], check=True, timeout=120)
    return site


@pytest.fixture
def elsewhere(tmp_path: Path) -> Path:
    """A folder of somebody else's project, with packages of the names that our rooms have."""
    for room in ROOMS:
        (tmp_path / room).mkdir()
        (tmp_path / room / "__init__.py").write_text(f"raise RuntimeError('another project has {room}')\n")
    return tmp_path


def run(site: Path, folder: Path, *args: str) -> subprocess.CompletedProcess[str]:
    """`resync-robot` of the wheel, started in that folder, which comes first on the path as with `python -m`."""
    return subprocess.run(
        [sys.executable, "-m", "resync_robot", *args],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(site)},
        capture_output=True,
        text=True,
        timeout=300,
    )


def test_it_brings_one_package(installed: Path) -> None:
    brought = {p.name for p in installed.iterdir() if p.name not in ("bin", ".lock") and p.suffix != ".dist-info"}
    assert brought == {"resync_robot"}


def test_deploy_reaches_a_goal_beside_other_packages_of_these_names(installed: Path, elsewhere: Path) -> None:
    done = run(installed, elsewhere, "deploy", "--scenario", "s1", "--perception", "oracle", "--skills", "state")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "goal reached" in done.stdout
    assert list(elsewhere.rglob("*.mcap"))


def test_the_emulated_rig_comes_with_it(installed: Path, elsewhere: Path) -> None:
    done = run(installed, elsewhere, "doctor", "--rig", "emulated")
    assert "ok   rig       'emulated'" in done.stdout, done.stdout + done.stderr
    refused = run(installed, elsewhere, "calibrate", "hand-eye", "--camera", "wrist", "--rig", "emulated")
    assert refused.returncode == 2
    assert "comes with this package" in refused.stderr and "--write rig.toml" in refused.stderr
