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
from resync_robot.curriculum.dream import CHUNK
from resync_robot.curriculum.mine import FAILURES, task_of
from resync_robot.curriculum.presets import ARM_PRESETS
from resync_robot.curriculum.run_folder import RunFolder
from resync_robot.curriculum.run_settings import RunSettings
from resync_robot.curriculum.stage_folder import StageFolder
from resync_robot.learning.recovery_policy import OBSERVATION_SIZE, ActorCritic
from resync_robot.learning.success_model import SuccessModel
from resync_robot.library_models import shipped_library
from resync_robot.sim_training import ppo
from resync_robot.sim_training.domains import find_domain
from resync_robot.sim_training.dreaming import WANDERED
from resync_robot.sim_training.learn_recovery import EVIDENCE, _Evidence
from tests.libraries import DOMAIN
from tests.scenes import B0, R

POINTER = "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a2146\nsize 12345\n"


def make_run(path: Path) -> RunFolder:
    """The folder of a smoke run with --skills state that was cut off while it learned concepts."""
    domain, library = find_domain(DOMAIN), load_library(shipped_library(DOMAIN))
    run, stage = RunFolder(path), domain.stages[0]
    folder = StageFolder(run, 1, stage.recovery)
    settings = RunSettings(preset="smoke", skills="state")
    write_json(path / "config.json", {**asdict(settings), "rig": load_rig().hash, "git": "unknown"})
    tasks = {seed: task_of(domain, stage, seed) for seed in range(1000, 1006)}
    states = {seed: task.initial.to_json() for seed, task in tasks.items()}
    mined = [{"seed": seed, "before": state, "failed": state} for seed, state in states.items()]
    about = {"skill": "Pick", "objects": ["r", "b0"], "relevant": "b0", "causes": ["box"]}
    write_json(folder.path / FAILURES, {**about, "states": mined, "likewise": []})
    net = ActorCritic()
    optimiser = torch.optim.Adam(net.parameters())
    (net.act(torch.zeros(1, OBSERVATION_SIZE)).sum() + net.value(torch.zeros(1, OBSERVATION_SIZE)).sum()).backward()
    optimiser.step()
    curve = {name: [64.0, 128.0] for name in ("steps", "success", "return", "seconds")}
    ppo._save(folder.path / "ppo.safetensors", net, optimiser, curve)
    _Evidence(folder.path / EVIDENCE, SuccessModel(OBSERVATION_SIZE, 0), OBSERVATION_SIZE).write(128)
    record = library.skills[domain.recovery]
    save_file({k: np.ascontiguousarray(v) for k, v in record.tensors.items()}, folder.path / "recovery.safetensors")
    write_json(
        folder.path / "recovery.json", {**record.meta, "sees": 3, "arguments": [0, 1], "horizon": 80, "sure": 0.5}
    )
    write_json(folder.path / "recovered.json", {"begun": list(states.values()), "states": list(states.values())})
    tried = Transition(tasks[1000].initial, "Pick", (R, B0), tasks[1000].initial, succeeded=False)
    budgets = ARM_PRESETS["smoke"]
    dreamed = budgets.dreams + budgets.attempts + round(WANDERED * budgets.attempts)
    for i in range(-(-dreamed // CHUNK)):
        attempt = Trajectory((tried,), tasks[1000].goal, False, "attempt")
        write_trajectories(folder.path / f"dreams-{i:03d}.jsonl", [attempt])
    for step, figures in {
        "mine": {"tasks": 10, "failed": 9, "kept": 6, "seconds": 1.5},
        "recover": {"curve": curve, "steps": 128.0},
        "check": {"worlds": 8, "done": 6, "mended": 6},
    }.items():
        folder.record(step, figures)
    return run


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
