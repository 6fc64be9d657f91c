"""The camera policy on disk and in training: as stock LeRobot reads it, and what is refused."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from resync_robot.core.errors import PolicyError, TrainingError
from resync_robot.core.rig import CameraRig, load_rig
from resync_robot.curriculum.distil import PLANS
from resync_robot.learning.camera_view import BLOCK_MEAN, BLOCK_SPREAD, GAPS, PICTURE, STATE_NAMES, VIEWS
from resync_robot.learning.demonstrations import Demonstrations
from resync_robot.policies import diffusion, trunk
from resync_robot.policies.diffusion import IMAGES, SIZES, DiffusionSettings, DiffusionStudent, load_student
from resync_robot.policies.training import DistilSettings, Trainer, chunks_of, has_bf16, statistics_of

RIG = load_rig()
SMALL = DiffusionSettings(keypoints=8, down_dims=(16, 32), inference_steps=2)


def demonstrations(n: int = 40, seed: int = 0) -> Demonstrations:
    """Four segments whose action can be read off the state."""
    rng = np.random.default_rng(seed)
    state = rng.normal(size=(n, len(STATE_NAMES))).astype(np.float32)
    return Demonstrations(
        pictures=rng.integers(0, 255, (n, len(VIEWS), PICTURE, PICTURE, 3)).astype(np.uint8),
        state=state,
        action=(0.02 * np.tanh(state[:, :3])).astype(np.float32),
        recovered=state[:, 3] > 0,
        free=state[:, 3] > -0.1,
        block=state[:, 4:11] / 20,
        acts=np.ones(n, dtype=bool),
        segment=np.arange(n) // (n // 4),
        ends=np.arange(n) // (n // 4) % 2 == 0,
    )


@pytest.fixture(scope="module")
def student() -> DiffusionStudent:
    torch.manual_seed(0)
    return DiffusionStudent.create(SMALL, statistics_of(demonstrations()), "cpu").eval()


@pytest.fixture(scope="module")
def saved(student: DiffusionStudent, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("policy") / "Recover"
    student.save(folder, RIG)
    return folder


def seen(n: int = 2) -> tuple[np.ndarray, np.ndarray]:
    d = demonstrations()
    return d.pictures[:n], d.state[:n]


def test_a_saved_policy_gives_the_same_answers(student: DiffusionStudent, saved: Path) -> None:
    before, after = student(*seen()), load_student(saved, RIG)(*seen())
    for name in ("steps", "done", "free", "block"):
        np.testing.assert_allclose(getattr(after, name), getattr(before, name), atol=1e-6, err_msg=name)
    assert before.steps.shape == (2, SMALL.horizon, 3)


def test_a_policy_from_before_asks_for_room_on_both_sides(
    student: DiffusionStudent, saved: Path, tmp_path: Path
) -> None:
    """Of version 3, which had no head that says whether its block is free."""
    from safetensors.torch import load_file, save_file

    older = tmp_path / "Recover"
    shutil.copytree(saved, older)
    heads = {name: values for name, values in load_file(older / "heads.safetensors").items() if "free" not in name}
    save_file({**heads, "view.0.0.weight": torch.zeros(32, 16)}, older / "heads.safetensors")
    stamp = json.loads((older / "resync.json").read_text(encoding="utf-8"))
    (older / "resync.json").write_text(json.dumps({**stamp, "version": 3}), encoding="utf-8")
    loaded = load_student(older, RIG)
    np.testing.assert_allclose(loaded(*seen()).steps, student(*seen()).steps, atol=1e-6)
    block = (
        np.array([[0.0] * 3 + gaps + [0.0] * 2 for gaps in ([0.05, 0.05], [0.05, 0.02])]) - BLOCK_MEAN
    ) / BLOCK_SPREAD
    free = torch.sigmoid(loaded.heads.free(torch.as_tensor(block, dtype=torch.float32)))[:, 0]
    assert free[0] > 0.9 and free[1] < 0.1


def test_a_policy_that_was_not_told_how_far_its_block_was_carried_does_without(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = demonstrations()
    narrower = statistics_of(replace(told, state=told.state[:, :-2]))
    with monkeypatch.context() as earlier:
        earlier.setattr(diffusion, "STATE_NAMES", STATE_NAMES[:-2])
        DiffusionStudent.create(SMALL, narrower, "cpu").save(tmp_path / "Recover", RIG)
    older = load_student(tmp_path / "Recover", RIG)
    pictures, state = seen()
    assert older.states == len(STATE_NAMES) - 2
    carried = state + np.array([0.0] * older.states + [0.05, 0.05], dtype=np.float32)
    np.testing.assert_array_equal(older(pictures, state).steps, older(pictures, carried).steps)


def test_plans_demonstrate_in_the_size_that_their_policy_wants() -> None:
    assert all(SIZES[plan.size].picture == plan.picture for plan in PLANS.values())


def test_a_large_policy_has_larger_pictures_and_a_resnet() -> None:
    large = replace(SIZES["large"], down_dims=SMALL.down_dims, inference_steps=1)
    student = DiffusionStudent.create(large, statistics_of(demonstrations()), "cpu").eval()
    assert student.picture == 128
    pictures = np.zeros((1, len(VIEWS), 128, 128, 3), dtype=np.uint8)
    assert student(pictures, seen(1)[1]).steps.shape == (1, large.horizon, 3)


def test_stock_lerobot_loads_it_and_acts_alike(student: DiffusionStudent, saved: Path) -> None:
    from lerobot.policies.diffusion.modeling_diffusion import DiffusionPolicy
    from lerobot.policies.factory import make_pre_post_processors

    policy = DiffusionPolicy.from_pretrained(saved)
    pre, post = make_pre_post_processors(policy.config, pretrained_path=str(saved))
    pictures, state = seen(1)
    frame = {key: torch.from_numpy(pictures[0, i]).permute(2, 0, 1).float() / 255 for i, key in enumerate(IMAGES)}
    frame["observation.state"] = torch.from_numpy(state[0])
    noise = torch.zeros(1, SMALL.horizon, 3)
    policy.reset()
    batch = pre(frame)
    stock = [post(policy.select_action(dict(batch), noise=noise)).numpy()[0] for _ in range(SMALL.horizon)]
    np.testing.assert_allclose(stock, student(pictures, state).steps[0], atol=1e-6)


def test_the_trunk_is_known_to_torchvision_by_a_name_that_lerobot_takes() -> None:
    import torchvision

    made = getattr(torchvision.models, trunk.NAME)(weights=None)
    assert trunk.NAME.startswith("resnet")
    features = torch.nn.Sequential(*list(made.children())[:-2])(torch.zeros(1, 3, 64, 64))
    assert features.shape == (1, 96, 8, 8)
    assert made(torch.zeros(1, 3, 64, 64)).shape == (1, 1)


def damage_version(folder: Path) -> None:
    stamp = json.loads((folder / "resync.json").read_text())
    (folder / "resync.json").write_text(json.dumps({**stamp, "version": 99}))


def damage_weights(folder: Path) -> None:
    path = folder / "model.safetensors"
    path.write_bytes(path.read_bytes()[:1000])


def damage_statistics(folder: Path) -> None:
    for path in folder.glob("policy_preprocessor*.safetensors"):
        path.unlink()
    path = folder / "policy_preprocessor.json"
    data = json.loads(path.read_text())
    for step in data["steps"]:
        step.pop("state_file", None)
    path.write_text(json.dumps(data))


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (damage_version, "of version 99"),
        (damage_weights, "cannot be read"),
        (damage_statistics, "no normalisation statistics"),
        (lambda folder: (folder / "heads.safetensors").unlink(), "cannot be read"),
        (lambda folder: (folder / "resync.json").unlink(), "no camera policy"),
        (lambda folder: (folder / "config.json").write_text("{"), "cannot be read"),
        (lambda folder: (folder / "resync.json").write_text("[]"), "of version None"),
    ],
)
def test_a_broken_policy_is_one_clear_error(
    saved: Path, tmp_path: Path, damage: Callable[[Path], object], words: str
) -> None:
    folder = tmp_path / "Recover"
    shutil.copytree(saved, folder)
    damage(folder)
    with pytest.raises(PolicyError, match=words) as caught:
        load_student(folder, RIG)
    assert "train" in caught.value.fix


def moved(camera: CameraRig, metres: float) -> CameraRig:
    pose = camera.pose.copy()
    pose[0, 3] += metres
    return replace(camera, pose=pose)


def test_a_policy_of_another_rig_is_refused_and_one_that_was_calibrated_again_is_not(saved: Path) -> None:
    again = replace(RIG, cameras=tuple(moved(c, 0.004) for c in RIG.cameras), hash="calibrated")
    load_student(saved, again)
    other = replace(RIG, cameras=tuple(moved(c, 0.2) if c.name == "side" else c for c in RIG.cameras))
    with pytest.raises(PolicyError, match=r"another rig: there 'side'.*200 mm"):
        load_student(saved, other)


@pytest.mark.parametrize("missing", ["action", "observation.state", IMAGES[1]])
def test_missing_statistics_are_never_taken_for_the_identity(missing: str) -> None:
    statistics = statistics_of(demonstrations())
    statistics.pop(missing)
    with pytest.raises(PolicyError, match=missing):
        DiffusionStudent.create(SMALL, statistics, "cpu")


# -- training ---------------------------------------------------------------------------------------------------------


def test_chunks_stay_in_their_segment_and_rest_after_its_end() -> None:
    d = demonstrations(16)
    chunks, valid = chunks_of(d, 6)
    np.testing.assert_array_equal(chunks[1, :3], d.action[1:4])
    # Segment 0 ends with the recovery: rest is known. Segment 1 is cut off: what follows is not.
    assert valid[1].all() and not chunks[1, 3:].any()
    assert valid[5].tolist() == [True, True, True, False, False, False]
    assert valid[15].tolist() == [True] + [False] * 5


def test_moments_without_motion_teach_no_motion() -> None:
    d = replace(demonstrations(16), acts=np.arange(16) < 8, ends=np.ones(16, dtype=bool))
    _, valid = chunks_of(d, 6)
    assert valid[:8].all() and not valid[8:].any()


def trainer(student: DiffusionStudent | None = None, bf16: bool = False) -> Trainer:
    torch.manual_seed(1)
    made = student or DiffusionStudent.create(SMALL, statistics_of(demonstrations()), "cpu")
    t = Trainer(made, DistilSettings(batch=8, bf16=bf16), steps=60, seed=4)
    t.use(demonstrations())
    return t


def weights(t: Trainer) -> np.ndarray:
    return np.concatenate([p.detach().numpy().ravel() for p in t.student.parameters()])


@pytest.mark.parametrize(
    ("answers", "expected"),
    [
        ({"avx512_bf16": False, "amx_tile": False}, False),
        ({"avx512_bf16": True, "amx_tile": False}, True),
        ({"avx512_bf16": False, "amx_tile": True}, True),
        ({}, False),
    ],
)
def test_bfloat16_is_for_cpus_that_have_it(
    monkeypatch: pytest.MonkeyPatch, answers: dict[str, bool], expected: bool
) -> None:
    for name in ("avx512_bf16", "amx_tile"):
        monkeypatch.delattr(torch.cpu, f"_is_{name}_supported", raising=False)
        if name in answers:
            monkeypatch.setattr(torch.cpu, f"_is_{name}_supported", lambda a=answers[name]: a, raising=False)
    assert has_bf16("cpu") is expected and has_bf16("cuda")


def test_a_resumed_training_goes_on_as_if_nothing_had_happened(tmp_path: Path) -> None:
    straight, halted, resumed = trainer(), trainer(), trainer()
    straight.run(6, lambda *_: None)
    halted.run(3, lambda *_: None)
    halted.save(tmp_path / "distil.safetensors")
    resumed.load(tmp_path / "distil.safetensors")
    resumed.run(6, lambda *_: None)
    np.testing.assert_allclose(weights(resumed), weights(straight), atol=1e-7)
    with straight.averaged(), resumed.averaged():
        np.testing.assert_allclose(weights(resumed), weights(straight), atol=1e-7)


def test_the_average_is_put_in_and_taken_out_again() -> None:
    t = trainer()
    t.run(4, lambda *_: None)
    raw = weights(t)
    with t.averaged():
        assert np.abs(weights(t) - raw).max() > 0
    np.testing.assert_array_equal(weights(t), raw)


@pytest.mark.parametrize("bf16", [False, True])
def test_it_learns_what_can_be_read_off_the_observation(bf16: bool) -> None:
    t, losses = trainer(bf16=bf16), []
    t.run(60, lambda step, found: losses.append(found))
    assert losses[-1]["action"] < 0.8 * losses[0]["action"]
    assert set(losses[0]) == {"action", "done", "free", "block"}


def test_what_free_means_is_learned_from_where_blocks_truly_were() -> None:
    """Of whichever kind it is: here one gap of the two is enough, as for a hand whose fingers fit along one axis."""
    frames = demonstrations(400)
    gaps = np.random.default_rng(1).uniform(0.0, 0.06, (400, 2))
    frames.block[:, GAPS] = gaps
    made = DiffusionStudent.create(SMALL, statistics_of(frames), "cpu")
    t = Trainer(made, DistilSettings(batch=16, learning_rate=1e-2), steps=100, seed=4)
    t.use(replace(frames, free=gaps.max(1) > 0.03))
    t.run(100, lambda *_: None)
    with torch.no_grad():
        seen_so = torch.as_tensor((frames.block - BLOCK_MEAN) / BLOCK_SPREAD, dtype=torch.float32)
        free = t.student.heads.free(seen_so)[:, 0].numpy() > 0
    assert np.mean(free == (gaps.max(1) > 0.03)) > 0.85


@pytest.mark.parametrize("damage", [lambda p: p.write_bytes(p.read_bytes()[:500]), lambda p: p.write_bytes(b"")])
def test_a_broken_checkpoint_is_named(tmp_path: Path, damage: Callable[[Path], object]) -> None:
    t = trainer()
    path = tmp_path / "distil.safetensors"
    t.save(path)
    damage(path)
    with pytest.raises(TrainingError, match=r"distil\.safetensors"):
        t.load(path)
