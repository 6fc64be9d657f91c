"""Run folders as training leaves them, made in seconds, and every way in which a file of one gets damaged."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch
from safetensors.numpy import save_file

from resync_robot.core.files import write_json
from resync_robot.core.library import load_library
from resync_robot.core.rig import load_rig
from resync_robot.core.trajectory import Trajectory, Transition, write_trajectories
from resync_robot.core.vocabulary import BLOCK, BOX, ROBOT
from resync_robot.curriculum.run_folder import RunFolder
from resync_robot.curriculum.run_settings import RunSettings
from resync_robot.curriculum.stage_files import Mined
from resync_robot.curriculum.stages import CHUNK, PRESETS
from resync_robot.learning.failures import Culprit
from resync_robot.learning.recovery_policy import OBSERVATION_SIZE, ActorCritic
from resync_robot.library_models import shipped_library
from resync_robot.sim_training import ppo
from resync_robot.sim_training.domains import find_domain, world_task
from tests.libraries import DOMAIN, gaussians_of

POINTER = "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a2146\nsize 12345\n"


def make_run(path: Path) -> RunFolder:
    """The folder of a smoke run with --skills state that was cut off while it learned concepts."""
    domain, library = find_domain(DOMAIN), load_library(shipped_library(DOMAIN))
    folder = RunFolder(path)
    settings = RunSettings(preset="smoke", skills="state")
    write_json(path / "config.json", {**asdict(settings), "rig": load_rig().hash, "git": "unknown"})
    task = world_task(domain, "s0", 0, 0)
    robot, block = (next(o for o in task.objects if o.type == kind) for kind in (ROBOT, BLOCK))
    tried = Transition(task.initial, "Pick", (robot, block), task.initial, succeeded=False)
    attempts = [Trajectory((tried,), task.goal, False, source) for source in ("attempt", "before@base")]
    gaussians = gaussians_of(library)
    box = next(o for o in task.objects if o.type == BOX)
    mined = Mined(Culprit("Pick", box, 1), block, gaussians["before"], (1000, 1001), "s0")
    write_trajectories(folder.stages / "mining.jsonl", attempts)
    write_json(folder.stages / "failures.json", mined.to_json())
    net = ActorCritic()
    optimiser = torch.optim.Adam(net.parameters())
    (net.act(torch.zeros(1, OBSERVATION_SIZE)).sum() + net.value(torch.zeros(1, OBSERVATION_SIZE)).sum()).backward()
    optimiser.step()
    curve = {name: [64.0, 128.0] for name in ("steps", "success", "return", "seconds")}
    ppo._save(folder.stages / "ppo.safetensors", net, optimiser, curve)
    record = library.skills[domain.recovery]
    tensors = {k: np.ascontiguousarray(v) for k, v in record.tensors.items()}
    save_file(tensors, folder.stages / "recovery.safetensors")
    write_json(folder.stages / "recovery.json", {**record.meta, "after": gaussians["after"].to_json()})
    preset = PRESETS["smoke"]
    for i in range(-(-(preset.dreams + preset.attempts) // CHUNK)):
        write_trajectories(folder.stages / f"dreams-{i:03d}.jsonl", attempts)
    for stage, figures in {
        "mine": {"tasks": 10, "failed": 9, "resampled": 16, "kept": 16, "seconds": 1.5},
        "recovery": {"curve": curve, "steps": 128.0},
        "check": {"worlds": 4, "picked": 3, "beta": 2},
    }.items():
        folder.record(stage, figures)
    return folder


def _cut(path: Path) -> None:
    data = path.read_bytes()
    path.write_bytes(data[: 2 * len(data) // 5])


def _lose_last_line(path: Path) -> None:
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join(lines[:-1]))


def _make_folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


DAMAGES: dict[str, Callable[[Path], object]] = {
    "cut in the middle": _cut,
    "last line gone": _lose_last_line,
    "garbage at the end": lambda p: p.write_bytes(p.read_bytes() + b"\x00\xffgarbage"),
    "no bytes": lambda p: p.write_bytes(b""),
    "zeros": lambda p: p.write_bytes(bytes(p.stat().st_size)),
    "an empty object": lambda p: p.write_text("{}\n"),
    "an empty list": lambda p: p.write_text("[]\n"),
    "null": lambda p: p.write_text("null\n"),
    "a list of nulls": lambda p: p.write_text("[null]\n"),
    "another object": lambda p: p.write_text(json.dumps({"mine": 3, "version": 99, "trajectories": 1})),
    "a Git LFS pointer": lambda p: p.write_text(POINTER),
    "a folder in its place": _make_folder,
    "unreadable": lambda p: p.chmod(0),
}


def files_of(folder: Path) -> list[Path]:
    """Every file of the run, as paths in it."""
    return sorted(p.relative_to(folder) for p in folder.rglob("*") if p.is_file())


def copy_of(run: Path, to: Path) -> Path:
    """A copy to be spoiled."""
    shutil.copytree(run, to)
    return to
