"""What this machine can do, and the command that mends what is missing."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from functools import partial
from importlib import metadata
from pathlib import Path

from resync_robot.core.errors import ResyncError
from resync_robot.core.files import read_text
from resync_robot.core.findings import Finding
from resync_robot.given import Given

PROBE_LIMIT_S = 60.0
"""How long a probe may load a library in a process of its own; the slowest takes 10 s on a busy machine."""

SETUP = "make setup"
VULKAN = "bash scripts/install_vulkan.sh"
ONE_OPENCV = (
    "pip uninstall -y opencv-python opencv-contrib-python opencv-contrib-python-headless && "
    "pip install --force-reinstall --no-deps 'opencv-python-headless<5'"
)
"""Taking one of two out takes files of the other with it, so that one is laid down again."""
TRAIN = "resync-robot train-sim --domain cornered-insertion-s --preset quick"


@dataclass(frozen=True, kw_only=True)
class DoctorConfig:
    """Check what this machine can do, and say how to mend what it cannot."""

    json: bool = False
    """Print the findings as JSON."""

    rig: Given[Path] = None
    """Rig file to check. Default: the rig that the simulation assumes."""


def doctor(config: DoctorConfig) -> int:
    """Print what was found; the exit code is 2 where something essential fails, else 0."""
    from resync_robot.console import show_findings

    findings = list(examine(config.rig))
    healthy = not any(f.status == "fail" for f in findings)
    if config.json:
        sys.stdout.write(json.dumps({"healthy": healthy, "findings": [asdict(f) for f in findings]}, indent=2) + "\n")
    else:
        show_findings(findings)
    return 0 if healthy else 2


def examine(rig: Path | None = None, root: Path | None = None) -> Iterator[Finding]:
    """Look at one thing after the other. `root` is the checkout, where it is not that of this package."""
    root = root or Path(__file__).parents[2]
    probes: tuple[tuple[str, Callable[[], Finding]], ...] = (
        ("python", check_python),
        ("packages", partial(check_packages, root / "constraints.txt")),
        ("opencv", check_opencv),
        ("vulkan", check_vulkan),
        ("cuda", check_cuda),
        ("ffmpeg", check_ffmpeg),
        ("rig", partial(check_rig, rig)),
        ("library", partial(check_libraries, root / "resync_robot" / "shipped")),
        ("disk", check_disk),
        ("robot", check_hardware_packages),
    )
    for name, probe in probes:
        try:
            yield probe()
        # A doctor that dies of what it finds helps nobody: whatever a probe trips over is its finding.
        except Exception as error:
            yield Finding(name, "fail", f"{type(error).__name__}: {error}", SETUP)


def check_python(version: tuple[int, int] = sys.version_info[:2]) -> Finding:
    found = ".".join(map(str, version))
    if version < (3, 11):
        return Finding("python", "fail", f"{found}; 3.11 or newer is needed", "make setup PYTHON=python3.12")
    return Finding("python", "ok", found)


def check_packages(constraints: Path) -> Finding:
    """Every package that this one requires is there, in the version that constraints.txt pins."""
    if not constraints.is_file():
        return Finding("packages", "warn", f"no {constraints.name} beside this installation to compare with")
    pins = dict(re.findall(r"^([\w.-]+)==(\S+)", read_text(constraints), flags=re.MULTILINE))
    pins = {_normal(name): version for name, version in pins.items()}
    installed = {_normal(d.metadata["Name"]): d.version for d in metadata.distributions()}
    try:
        needs = [r for r in metadata.requires("resync-robot") or () if "extra" not in r]
    except metadata.PackageNotFoundError:
        return Finding("packages", "fail", "resync-robot itself is not installed", SETUP)
    required = {_normal(re.split(r"[^\w.-]", r)[0]) for r in needs}
    missing = sorted(required - set(installed))
    if missing:
        return Finding("packages", "fail", f"not installed: {', '.join(missing)}", SETUP)
    other = [f"{n} {v} instead of {pins[n]}" for n, v in sorted(installed.items()) if pins.get(n, v) != v]
    if other:
        more = f" and {len(other) - 3} more" if len(other) > 3 else ""
        return Finding("packages", "warn", f"not the tested versions: {', '.join(other[:3])}{more}", SETUP)
    return Finding("packages", "ok", f"{len(required)} required ones in the tested versions")


def check_opencv() -> Finding:
    """OpenCV loads, from one package: all of them own the same files, and 5.0 lacks hand-eye calibration."""
    found = {
        _normal(d.metadata["Name"]): d.version
        for d in metadata.distributions()
        if re.match(r"opencv-(contrib-)?python", _normal(d.metadata["Name"]))
    }
    described = ", ".join(f"{n} {v}" for n, v in sorted(found.items())) or "not installed"
    try:
        import cv2
    except ImportError as error:
        return Finding("opencv", "fail", f"{described}; does not load: {error}", ONE_OPENCV)
    if len(set(found.values())) > 1 or not cv2.__version__.startswith("4."):
        return Finding("opencv", "fail", f"{described}; {cv2.__version__} loads, one version 4 is needed", ONE_OPENCV)
    if len(found) > 1:
        return Finding("opencv", "warn", f"{described}; they own the same files, only headless is needed", ONE_OPENCV)
    return Finding("opencv", "ok", cv2.__version__)


def check_vulkan() -> Finding:
    """A renderer can be made. In a process of its own: a broken driver ends a process, not the examination."""
    code = "import sapien; sapien.render.RenderSystem(); print(sapien.render.get_device_summary())"
    outcome = run_probe([sys.executable, "-c", code])
    device = re.search(r"GPU:\s*(.+)", outcome.stdout)
    if outcome.returncode != 0 or device is None:
        return Finding("vulkan", "fail", f"nothing to render with: {_last_line(outcome.stderr)}", VULKAN)
    return Finding("vulkan", "ok", device[1].strip())


def check_cuda() -> Finding:
    """A GPU for training; optional, the quick preset needs none."""
    if shutil.which("nvidia-smi") is None:
        return Finding("cuda", "ok", "no GPU; optional, training runs on the CPU")
    code = "import torch; print(torch.cuda.get_device_name() if torch.cuda.is_available() else '')"
    outcome = run_probe([sys.executable, "-c", code])
    if outcome.returncode == 0 and outcome.stdout.strip():
        from resync_robot.sim_training.physics.gpu import gpu_physics_path

        library = "there" if gpu_physics_path().is_file() else "not there yet: downloaded by the first --device cuda"
        return Finding("cuda", "ok", f"{outcome.stdout.strip()}; GPU physics is {library}")
    reason = _last_line(outcome.stderr) or "torch sees no GPU"
    return Finding("cuda", "warn", f"there is an NVIDIA driver but {reason}", "nvidia-smi")


def check_ffmpeg() -> Finding:
    """A video encoder; a package brings one where the system has none."""
    system = shutil.which("ffmpeg")
    if system:
        return Finding("ffmpeg", "ok", system)
    try:
        import imageio_ffmpeg

        imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError):
        return Finding("ffmpeg", "warn", "none, so no videos can be written", "sudo apt-get install ffmpeg")
    return Finding("ffmpeg", "ok", f"the one that imageio-ffmpeg {metadata.version('imageio-ffmpeg')} brings")


def check_rig(path: Path | None) -> Finding:
    from resync_robot.core.rig import load_rig

    try:
        rig = load_rig(path)
    except ResyncError as error:
        return Finding("rig", "fail", error.what, error.fix or f"mend it, then: resync-robot doctor --rig {path}")
    cameras = ", ".join(c.name for c in rig.cameras)
    return Finding("rig", "ok", f"'{rig.name}' ({rig.arm.model}, {rig.gripper.model}, cameras {cameras}), {rig.hash}")


def check_libraries(shipped: Path) -> Finding:
    """Every shipped library loads, which checks the hash of each of its files."""
    from resync_robot.core.library import load_library

    folders = sorted(p.parent for p in shipped.glob("*/library.json"))
    if not folders:
        return Finding("library", "warn", "none is shipped with this version", TRAIN)
    try:
        loaded = [load_library(folder) for folder in folders]
    except ResyncError as error:
        return Finding("library", "fail", error.what, "git checkout -- resync_robot/shipped")
    return Finding("library", "ok", ", ".join(f"{x.domain} {x.content_hash[:12]}" for x in loaded))


def check_disk(free_bytes: int | None = None) -> Finding:
    free = (shutil.disk_usage(Path.cwd()).free if free_bytes is None else free_bytes) / 1e9
    if free < 1:
        return Finding("disk", "fail", f"{free:.1f} GB free here; recordings and training need some", "df -h .")
    if free < 10:
        return Finding("disk", "warn", f"{free:.1f} GB free here; demonstrations of a full training need 10", "df -h .")
    return Finding("disk", "ok", f"{free:.0f} GB free here")


def check_hardware_packages() -> Finding:
    """The drivers of the real arm and cameras; optional."""
    drivers = ("ur-rtde", "pyrealsense2")
    installed = {_normal(d.metadata["Name"]) for d in metadata.distributions()}
    missing = [name for name in drivers if name not in installed]
    if missing:
        command = "needed for --backend ur7e only: uv pip install -e '.[hardware]' -c constraints.txt"
        return Finding("robot", "ok", f"no {' and no '.join(missing)}; {command}")
    return Finding("robot", "ok", f"{' and '.join(drivers)} are installed")


def run_probe(command: list[str], limit_s: float = PROBE_LIMIT_S) -> subprocess.CompletedProcess[str]:
    """Run a probe in a process of its own; one that takes too long counts as failed."""
    try:
        return subprocess.run(
            command, capture_output=True, encoding="utf-8", errors="replace", timeout=limit_s, check=False
        )
    except subprocess.TimeoutExpired:
        return subprocess.CompletedProcess(command, 124, "", f"no answer within {limit_s:.0f} s")


def _normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def _last_line(text: str) -> str:
    lines = text.strip().splitlines()
    return lines[-1] if lines else ""
