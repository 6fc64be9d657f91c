"""Training a camera policy on demonstrations: one loop, resumable, that keeps an average of the weights.

LeRobot has a trainer of its own, which parses the command line, reads frames from video as it goes (on a CPU three
times slower than training itself) and keeps no average of the weights; hence this one, on LeRobot's policy.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from safetensors import safe_open
from safetensors.torch import save_file
from torch import Tensor

from resync_robot.core.damage import reading
from resync_robot.core.files import whole
from resync_robot.learning.camera_view import BLOCK_MEAN, BLOCK_SPREAD, STATE_NAMES
from resync_robot.learning.demonstrations import Demonstrations
from resync_robot.policies.diffusion import ACTION, IMAGES, STATE, DiffusionStudent


@dataclass(frozen=True, kw_only=True)
class DistilSettings:
    """How a policy is trained."""

    batch: int = 64
    learning_rate: float = 1e-3
    weight_decay: float = 1e-4
    warm_up: int = 50
    average: float = 0.995
    """Share of the average that stays, each step."""
    jitter: float = 0.25
    """Most change of brightness and of each colour."""
    noise: float = 0.02
    """Noise of a pixel, of 1, on top of the camera's own."""
    done_weight: float = 0.1
    block_weight: float = 0.3
    bf16: bool = False
    """Compute in bfloat16 where that loses nothing: half the time, on machines that have it (`has_bf16`)."""


def has_bf16(device: str) -> bool:
    """Does the device compute in bfloat16 faster than in single precision? A CPU without it emulates it slowly.

    Machines that differ in this train policies that differ in their last digits, as other processors do anyway.
    """
    if device != "cpu":
        return True
    # torch has no public way to ask; other versions may call it otherwise.
    asked = (getattr(torch.cpu, f"_is_{name}_supported", None) for name in ("avx512_bf16", "amx_tile"))
    return any(bool(ask()) for ask in asked if ask is not None)


def statistics_of(frames: Demonstrations) -> dict[str, dict[str, np.ndarray]]:
    """Mean, std, min and max of everything that a policy sees and does, as LeRobot names them."""

    def of(values: np.ndarray, least_std: float) -> dict[str, np.ndarray]:
        std = np.maximum(values.std(0), least_std)
        return {"mean": values.mean(0), "std": std, "min": values.min(0), "max": values.max(0)}

    found = {STATE: of(frames.state, 1e-3), ACTION: of(frames.action, 1e-4)}
    for i, key in enumerate(IMAGES):
        some = frames.pictures[:: max(1, len(frames) // 1000), i].reshape(-1, 3) / 255
        found[key] = {k: v.reshape(3, 1, 1) for k, v in of(some, 1e-2).items()}
    return found


class Trainer:
    """A student, its optimiser, and the average of its weights.

    Args:
        steps: of the whole training: the learning rate falls to nothing over them.
        seed: of every draw.
    """

    def __init__(self, student: DiffusionStudent, settings: DistilSettings, steps: int, seed: int) -> None:
        self.student, self.settings, self.steps, self.step = student, settings, steps, 0
        parameters = list(student.parameters())
        self._optimiser = torch.optim.AdamW(
            parameters, settings.learning_rate, weight_decay=settings.weight_decay, fused=True
        )
        self._average = [p.detach().clone() for p in parameters]
        self._parameters = parameters
        self._rng = np.random.default_rng([seed, 61])
        self._torch_rng = torch.Generator(student.device).manual_seed(seed)
        self._frames: Demonstrations | None = None
        # Pixel noise is drawn once and read from a new place each time: drawing it is a tenth of a step's cost.
        self._noise = settings.noise * torch.randn(1 << 22, generator=self._torch_rng, device=student.device)

    def use(self, frames: Demonstrations) -> None:
        """Train on these demonstrations from now on."""
        self._frames = frames
        self._chunks, self._valid = chunks_of(frames, self.student.horizon)

    def run(self, until: int, report: Callable[[int, dict[str, float]], None]) -> None:
        """Take steps up to number `until`; `report` hears of the losses now and then."""
        self.student.train()
        sums: dict[str, float] = {}
        count = 0
        while self.step < until:
            losses = self._one_step()
            count += 1
            for name, value in losses.items():
                sums[name] = sums.get(name, 0.0) + value
            if self.step % 25 == 0 or self.step == until:
                report(self.step, {k: v / count for k, v in sums.items()})
                sums, count = {}, 0
        self.student.eval()

    def averaged(self) -> Averaged:
        """`with trainer.averaged():` the student has the average of its weights."""
        return Averaged(self._parameters, self._average)

    def _one_step(self) -> dict[str, float]:
        for group in self._optimiser.param_groups:
            group["lr"] = self.settings.learning_rate * self._rate()
        batch = self._draw()
        with torch.autocast(self.student.device.type, torch.bfloat16, enabled=self.settings.bf16):
            losses = self._losses(batch)
        self._optimiser.zero_grad(set_to_none=True)
        sum(losses.values()).backward()  # type: ignore[union-attr]
        torch.nn.utils.clip_grad_norm_(self._parameters, 1.0)
        self._optimiser.step()
        self.step += 1
        # A fast average at first: the random weights of the beginning are not worth keeping.
        keep = min(self.settings.average, (1 + self.step) / (10 + self.step))
        torch._foreach_lerp_(self._average, [p.detach() for p in self._parameters], 1 - keep)
        return {k: float(v.detach()) for k, v in losses.items()}

    def _rate(self) -> float:
        warm = min(1.0, (self.step + 1) / self.settings.warm_up)
        return warm * 0.5 * (1 + float(np.cos(np.pi * min(1.0, self.step / self.steps))))

    def _draw(self) -> dict[str, Tensor]:
        if self._frames is None:
            raise RuntimeError("use() comes before run()")
        f, device = self._frames, self.student.device
        rows = self._rng.integers(len(f), size=self.settings.batch)
        return {
            "pictures": self._augment(f.pictures[rows]),
            "state": torch.from_numpy(f.state[rows]).to(device),
            "chunk": torch.from_numpy(self._chunks[rows]).to(device),
            "valid": torch.from_numpy(self._valid[rows]).to(device),
            "done": torch.from_numpy(f.recovered[rows].astype(np.float32)).to(device),
            "free": torch.from_numpy(f.free[rows].astype(np.float32)).to(device),
            "block": torch.from_numpy(((f.block[rows] - BLOCK_MEAN) / BLOCK_SPREAD).astype(np.float32)).to(device),
        }

    def _augment(self, pictures: np.ndarray) -> Tensor:
        """(n, v, 3, crop, crop) floats: every picture cut and coloured by draws of its own."""
        s, crop = self.settings, int(self.student.policy.config.crop_shape[0])
        n, v, p = pictures.shape[:3]
        room = p - crop
        corner = self._rng.integers(room + 1, size=(n, v, 2)) if room else np.zeros((n, v, 2), dtype=int)
        across = np.arange(crop)
        rows = (corner[..., 0, None] + across)[:, :, :, None]
        columns = (corner[..., 1, None] + across)[:, :, None, :]
        cut = pictures[np.arange(n)[:, None, None, None], np.arange(v)[None, :, None, None], rows, columns]
        x = torch.from_numpy(np.ascontiguousarray(cut)).to(self.student.device).permute(0, 1, 4, 2, 3)
        x = x.float().mul_(1 / 255)
        size = (n, v, 1, 1, 1)

        def draw(*shape: int) -> Tensor:
            return 2 * torch.rand(*shape, generator=self._torch_rng, device=x.device) - 1

        gain = 1 + s.jitter * draw(*size) + 0.3 * s.jitter * draw(n, v, 3, 1, 1)
        contrast = 1 + 0.5 * s.jitter * draw(*size)
        middle = x.mean((2, 3, 4), keepdim=True)
        return x.mul_(contrast).add_(middle * (gain - contrast)).add_(self._pixel_noise(x.shape)).clamp_(0, 1)

    def _pixel_noise(self, shape: torch.Size) -> Tensor:
        count = shape.numel()
        begin = int(self._rng.integers(max(1, len(self._noise) - count)))
        noise = self._noise[begin : begin + count]
        return (noise if len(noise) == count else noise.repeat(-(-count // len(noise)))[:count]).view(shape)

    def _losses(self, batch: Mapping[str, Tensor]) -> dict[str, Tensor]:
        s, diffusion = self.settings, self.student.policy.diffusion
        features = self.student.features(batch["pictures"], batch["state"])
        clean = self._normalised(batch["chunk"])
        noise = torch.randn(clean.shape, generator=self._torch_rng, device=clean.device)
        scheduler = diffusion.noise_scheduler
        level = torch.randint(
            scheduler.config.num_train_timesteps, (len(clean),), generator=self._torch_rng, device=clean.device
        )
        predicted = diffusion.unet(scheduler.add_noise(clean, noise, level), level, global_cond=features)
        valid = batch["valid"][..., None].expand_as(clean)
        heads = self.student.heads
        return {
            "action": ((predicted - clean) ** 2 * valid).sum() / valid.sum().clamp(min=1),
            "done": s.done_weight * F.binary_cross_entropy_with_logits(heads.done(features)[:, 0], batch["done"]),
            "block": s.block_weight * F.mse_loss(heads.block(features), batch["block"]),
            # By where the block is, and not where it is seen: else blurred eyes would blur the line as well.
            "free": s.done_weight * F.binary_cross_entropy_with_logits(heads.free(batch["block"])[:, 0], batch["free"]),
        }

    def _normalised(self, chunk: Tensor) -> Tensor:
        return self.student.pre({ACTION: chunk, STATE: torch.zeros(len(chunk), len(STATE_NAMES), device=chunk.device)})[
            ACTION
        ]

    # -- resuming -----------------------------------------------------------------------------------------------------

    def save(self, path: Path) -> None:
        """Everything that a resumed training needs, in one safetensors file; whole or not at all."""
        tensors = {f"student.{k}": v for k, v in self.student.state_dict().items()}
        tensors |= {f"average.{i}": v for i, v in enumerate(self._average)}
        for i, state in self._optimiser.state_dict()["state"].items():
            tensors |= {f"optimiser.{i}.{k}": v for k, v in state.items()}
        tensors["torch_rng"] = self._torch_rng.get_state()
        meta = {"step": str(self.step), "rng": json.dumps(self._rng.bit_generator.state)}
        with whole(path) as beside:
            save_file({k: v.detach().cpu().contiguous().clone() for k, v in tensors.items()}, beside, meta)

    def load(self, path: Path) -> None:
        """Go on where `save` left off. Raises TrainingError where the file is broken or of another policy."""
        with reading(path):
            with safe_open(path, "pt", str(self.student.device)) as file:
                meta = file.metadata()
                tensors = {k: file.get_tensor(k) for k in file.keys()}  # noqa: SIM118 - it is no mapping
            self.student.load_state_dict(_part(tensors, "student."))
            for i, mine in enumerate(self._average):
                mine.copy_(tensors[f"average.{i}"])
            state = self._optimiser.state_dict()
            state["state"] = {
                i: {k: _laid_out_as(p, v) for k, v in _part(tensors, f"optimiser.{i}.").items()}
                for i, p in enumerate(self._parameters)
            }
            self._optimiser.load_state_dict(state)
            self._torch_rng.set_state(tensors["torch_rng"].cpu())
            self._rng.bit_generator.state = json.loads(meta["rng"])
            self.step = int(meta["step"])


def step_of(path: Path) -> int:
    """After how many steps `Trainer.save` wrote this file. Raises TrainingError where it is damaged."""
    with reading(path), safe_open(path, "pt") as file:
        return int(file.metadata()["step"])


def _laid_out_as(parameter: Tensor, value: Tensor) -> Tensor:
    """The same values in the parameter's layout in memory: fused steps go through both side by side."""
    if value.shape != parameter.shape:
        return value
    return torch.empty_like(parameter, dtype=value.dtype).copy_(value)


def _part(tensors: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {k.removeprefix(prefix): v for k, v in tensors.items() if k.startswith(prefix)}


class Averaged:
    """Puts the averaged weights in while it is entered."""

    def __init__(self, parameters: list[torch.nn.Parameter], average: list[Tensor]) -> None:
        self._parameters, self._average = parameters, average
        self._kept: list[Tensor] = []

    def __enter__(self) -> None:
        self._kept = [p.detach().clone() for p in self._parameters]
        self._set(self._average)

    def __exit__(self, *_: object) -> None:
        self._set(self._kept)

    def _set(self, values: list[Tensor]) -> None:
        with torch.no_grad():
            for parameter, value in zip(self._parameters, values, strict=True):
                parameter.copy_(value)


def chunks_of(frames: Demonstrations, horizon: int) -> tuple[Float[np.ndarray, "n h 3"], Bool[np.ndarray, "n h"]]:
    """For every frame the actions from there on, and which of them are known.

    After a recovery the hand rests, so what follows the end is known; after a burst it is not.
    """
    n = len(frames)
    later = np.arange(n)[:, None] + np.arange(horizon)
    inside = np.minimum(later, n - 1)
    same = (later < n) & (frames.segment[inside] == frames.segment[:, None]) & frames.acts[inside]
    chunks = np.where(same[..., None], frames.action[inside], 0.0).astype(np.float32)
    return chunks, same | (frames.ends & frames.acts)[:, None]
