"""Training: what it refuses at once, and (slow) that a kill loses nothing and a seed decides everything."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from resync_robot import cli
from resync_robot.commands import train_sim
from resync_robot.commands.train_sim import TrainConfig
from resync_robot.core.errors import ConfigError, TrainingError
from resync_robot.core.library import load_library
from resync_robot.core.lock import LOCK, sole_writer
from resync_robot.core.rig import load_rig
from resync_robot.curriculum.learn_stages import STEPS
from resync_robot.curriculum.run_folder import RunFolder
from resync_robot.curriculum.run_settings import SHAPING, RunSettings
from resync_robot.library_models import learned_model, shipped_library
from resync_robot.sim_training.domains import find_domain
from resync_robot.sim_training.physics import gpu
from tests.libraries import DOMAIN


@pytest.mark.parametrize(
    ("args", "word"),
    [
        (("--domain", "kitchen"), "unknown domain 'kitchen'"),
        (("--seed", "-1"), "--seed is -1"),
        (("--workers", "0"), "--workers is 0"),
        (("--workers", "-2"), "--workers is -2"),
        (("--out", "/dev/null/run"), "cannot write to /dev/null/run"),
        (("--resume",), "no run of 'cornered-insertion-s'"),
        (("--resume", "--out", "nowhere"), "nowhere holds no run to resume"),
        (("--resume", "--out", "strange"), "is not the config of a run"),
        (("--resume", "--out", "torn"), "no valid JSON"),
        (("--out", "taken"), "taken already holds a run"),
        (("--out", "thesis"), "thesis holds other files, such as library"),
    ],
)
def test_bad_input_is_one_error_with_code_2_and_changes_nothing(
    args: tuple[str, ...],
    word: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(train_sim, "_run", lambda *_: pytest.fail("training began"))
    for name, text in (("taken", "{}"), ("strange", "[1]"), ("torn", '{"seed": ')):
        (tmp_path / name).mkdir()
        (tmp_path / name / "config.json").write_text(text)
    (tmp_path / "thesis" / "library").mkdir(parents=True)
    before = sorted(tmp_path.rglob("*"))
    assert cli.main(["train-sim", *args]) == 2
    shown = capsys.readouterr()
    assert shown.err.startswith("error: ") and word in shown.err
    assert "Traceback" not in shown.err
    assert sorted(tmp_path.rglob("*")) == before


def test_cuda_without_a_device_is_an_error_that_says_what_to_use(monkeypatch: pytest.MonkeyPatch) -> None:
    import torch

    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(ConfigError, match="no CUDA device") as caught:
        train_sim.train(TrainConfig(device="cuda"))
    assert "--device cpu" in caught.value.fix


def test_gpu_physics_is_missed_before_anything_is_mined(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    import torch

    def missed() -> None:
        raise TrainingError("no GPU physics")

    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(gpu, "require_gpu_physics", missed)
    with pytest.raises(TrainingError, match="no GPU physics"):
        train_sim.train(TrainConfig(device="cuda", skills="state", out=tmp_path / "run"))
    assert not list((tmp_path / "run" / "stages").iterdir())


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_run_that_somebody_ends_says_how_to_go_on(
    number: signal.Signals, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(train_sim, "_run", lambda *_: os.kill(os.getpid(), number))
    out = tmp_path / "run"
    assert cli.main(["train-sim", "--skills", "state", "--out", str(out)]) == 128 + number
    assert f"Go on with:  resync-robot train-sim --resume --out {out}" in capsys.readouterr().out


@pytest.fixture
def ran(monkeypatch: pytest.MonkeyPatch) -> list[tuple[RunSettings, int]]:
    """Settings and workers of every training that would have begun."""
    begun: list[tuple[RunSettings, int]] = []
    monkeypatch.setattr(train_sim, "_run", lambda settings, workers, domain, folder: begun.append((settings, workers)))
    return begun


def test_a_run_keeps_its_settings_when_it_is_resumed(tmp_path: Path, ran: list[tuple[RunSettings, int]]) -> None:
    begun = TrainConfig(preset="smoke", seed=7, concepts="paper", out=tmp_path / "run")
    train_sim.train(begun)
    train_sim.train(TrainConfig(workers=1, out=tmp_path / "run", resume=True))
    assert [settings for settings, _ in ran] == [RunSettings(preset="smoke", seed=7, concepts="paper")] * 2
    assert [workers for _, workers in ran] == [2, 1]
    assert json.loads((tmp_path / "run" / "config.json").read_text())["seed"] == 7


@pytest.mark.parametrize(
    "error", [OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)), RuntimeError("No space left on device (os error 28)")]
)
def test_a_full_disk_is_one_message_that_says_how_to_go_on(
    error: Exception, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: object) -> None:
        raise error

    monkeypatch.setattr(train_sim, "_run", full)
    out = tmp_path / "run"
    assert cli.main(["train-sim", "--skills", "state", "--out", str(out)]) == 3
    shown = capsys.readouterr()
    assert shown.err.startswith("error: cannot write ") and "No space left on device" in shown.err
    assert f"train-sim --resume --out {out}" in shown.err


def test_resume_without_a_folder_takes_the_latest_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ran: list[tuple[RunSettings, int]]
) -> None:
    monkeypatch.chdir(tmp_path)
    train_sim.train(TrainConfig(preset="smoke", seed=3))
    train_sim.train(TrainConfig(resume=True))
    assert [settings.seed for settings, _ in ran] == [3, 3]
    (folder,) = (tmp_path / "runs").iterdir()
    assert folder.name.endswith(DOMAIN)


def test_the_saved_config_names_all_that_decides_the_outcome(
    tmp_path: Path, ran: list[tuple[RunSettings, int]]
) -> None:
    train_sim.train(TrainConfig(preset="smoke", seed=4, out=tmp_path / "run"))
    saved = json.loads((tmp_path / "run" / "config.json").read_text())
    assert set(saved) == {*SHAPING, "rig", "git"}
    assert (saved["seed"], saved["rig"]) == (4, load_rig().hash)


def test_a_library_names_no_files_of_the_machine_it_was_learned_on(tmp_path: Path) -> None:
    settings = RunSettings(domain=str(tmp_path / "own.py"), library=str(tmp_path / "library"))
    folder, built_on = RunFolder(tmp_path / "run"), load_library(shipped_library(DOMAIN))
    origin = train_sim._origin(settings, folder, find_domain(DOMAIN), built_on)
    assert str(tmp_path) not in json.dumps(origin)
    assert (origin["domain"], origin["library"]) == (DOMAIN, f"{DOMAIN} {built_on.content_hash}")
    assert train_sim._origin(settings, folder, find_domain(DOMAIN), None)["library"] == ""


def test_a_folder_has_one_run_at_a_time_and_a_refused_one_changes_nothing(
    tmp_path: Path, ran: list[tuple[RunSettings, int]], capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    train_sim.train(TrainConfig(preset="smoke", out=out))
    ran.clear()
    with sole_writer(out / LOCK, out, ""):
        before = sorted(tmp_path.rglob("*"))
        for how in ((), ("--resume",)):
            assert cli.main(["train-sim", *how, "--out", str(out)]) == 2
            assert f"{out} is being written by process {os.getpid()}" in capsys.readouterr().err
        assert sorted(tmp_path.rglob("*")) == before
    assert ran == []
    assert cli.main(["train-sim", "--resume", "--out", str(out)]) == 0
    assert len(ran) == 1


# -- whole runs -------------------------------------------------------------------------------------------------------

STAGE = "1-Recover"
SMOKE = (sys.executable, "-m", "resync_robot", "train-sim", "--preset", "smoke", "--seed", "0")


def run_smoke(out: Path, *more: str, kill_when: str | None = None, after: float = 0.0) -> int:
    """Run the smoke preset; with `kill_when`, kill -9 it `after` seconds from when that file of the run appears."""
    run = subprocess.Popen([*SMOKE, "--out", str(out), *more], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        if kill_when:
            while run.poll() is None and not list(out.glob(kill_when)):
                time.sleep(0.05)
            assert run.poll() is None, f"the run ended before {kill_when}"
            time.sleep(after)
            with pytest.raises(ConfigError, match=f"process {run.pid} "), sole_writer(out / LOCK, out, ""):
                pass
            run.kill()
            run.wait()
            # At once, though its workers may take a moment longer to notice.
            with sole_writer(out / LOCK, out, ""):
                pass
        return run.wait(timeout=1800)
    finally:
        run.kill()


def whole(out: Path) -> str:
    """The content hash of a library that loads and becomes a model."""
    library = load_library(out / "library")
    domain = find_domain(DOMAIN)
    model = learned_model(domain, load_rig(), library)
    assert domain.recovery in {o.name for o in model.operators}
    assert (out / "stages" / STAGE / "recovery.png").stat().st_size > 1000
    figures = json.loads((out / "metrics.json").read_text(encoding="utf-8"))
    assert {f"{STAGE}/{step}" for step in (*STEPS, "distil")} <= set(figures)
    return library.content_hash


@pytest.mark.slow
def test_the_same_seed_gives_the_same_library(tmp_path: Path) -> None:
    for name in ("a", "b"):
        assert run_smoke(tmp_path / name) == 0
    assert whole(tmp_path / "a") == whole(tmp_path / "b")


@pytest.mark.slow
def test_a_run_killed_in_every_phase_is_resumed_to_a_whole_library(tmp_path: Path) -> None:
    out = tmp_path / "run"
    moments = [
        ("config.json", 4.0),  # mining
        (f"stages/{STAGE}/failures.json", 6.0),  # recovery, before its first checkpoint
        (f"stages/{STAGE}/ppo.safetensors", 2.0),  # recovery, after it
        (f"stages/{STAGE}/attempts.safetensors", 3.0),  # between policy and record
        (f"stages/{STAGE}/recovery.json", 1.0),  # the check
        (f"stages/{STAGE}/recovered.json", 0.5),  # dreaming
        (f"stages/{STAGE}/dreams-000.jsonl", 3.0),  # concepts
        (f"stages/{STAGE}/demonstrations/turn-0-0000", 0.5),  # between demonstrations and training
        (f"stages/{STAGE}/distil.safetensors", 0.2),  # while the student is tried
        (f"stages/{STAGE}/demonstrations/turn-1-0000.part", 1.0),  # in the midst of a shard
    ]
    for i, (file, after) in enumerate(moments):
        code = run_smoke(out, *(["--resume"] if i else []), kill_when=file, after=after)
        assert code == -9
        assert not os.path.exists(out / "library")  # noqa: PTH110 - a torn one would count too
    assert run_smoke(out, "--resume") == 0
    whole(out)
    assert not list(out.rglob("*.part"))
