"""A camera policy: LeRobot's DiffusionPolicy, and beside it heads that say whether it is done and what it sees.

On disk it is a folder that stock LeRobot opens (config, weights, both processors), and two files of our own:

    config.json model.safetensors policy_preprocessor.json policy_postprocessor.json *.safetensors   LeRobot's
    heads.safetensors      done, where the block is
    resync.json            version, horizon, the cameras that it was trained for

LeRobot's import takes 20 s, so this module is imported only where a camera policy is trained or run.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from contextlib import redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, UInt8
from safetensors import SafetensorError
from safetensors.torch import load_file
from safetensors.torch import save as to_bytes
from torch import Tensor, nn

from resync_robot.core import spatial
from resync_robot.core.errors import PolicyError
from resync_robot.core.files import read_text, write_bytes, write_text
from resync_robot.core.rig import CameraRig, Rig
from resync_robot.learning.camera_view import (
    ACTION_NAMES,
    BLOCK_MEAN,
    BLOCK_NAMES,
    BLOCK_SPREAD,
    GAPS,
    PICTURE,
    STATE_NAMES,
    VIEWS,
    Prediction,
)
from resync_robot.policies import trunk

os.environ.setdefault("HF_HUB_OFFLINE", "1")

from lerobot.configs.types import FeatureType, NormalizationMode, PolicyFeature
from lerobot.policies.diffusion.configuration_diffusion import DiffusionConfig
from lerobot.policies.diffusion.modeling_diffusion import DiffusionPolicy
from lerobot.policies.factory import make_pre_post_processors

VERSION, READ = 5, (3, 4, 5)
"""What is written, and what is read: 3 had no `free`, and neither 3 nor 4 was told how far a block was carried."""
RETRAIN = "train a new one: resync-robot train-sim"
IMAGES = tuple(f"observation.images.{view}" for view in VIEWS)
STATE, ACTION = "observation.state", "action"
MOVED, TURNED, ZOOMED = 0.015, np.radians(2.0), 0.05
"""How far a camera may stand from where it stood in training, in m, rad, and as a share of its view."""
STATISTICS = ("mean", "std", "min", "max")


@dataclass(frozen=True, kw_only=True)
class DiffusionSettings:
    """The size of a policy."""

    backbone: str = trunk.NAME
    picture: int = PICTURE
    crop: int = 62
    """Pixels of a side that the network sees; training moves this window about."""
    keypoints: int = 32
    down_dims: tuple[int, ...] = (64, 128)
    horizon: int = 8
    """Control steps of a chunk."""
    inference_steps: int = 8


SIZES = {
    "small": DiffusionSettings(),
    "large": DiffusionSettings(backbone="resnet18", picture=128, crop=120, down_dims=(256, 512, 1024)),
}
"""By the names that plans of training use: what a CPU trains in minutes, and what wants a GPU."""


def make_config(s: DiffusionSettings, device: str) -> DiffusionConfig:
    """LeRobot's description of the policy. One observation; the network predicts the clean chunk, not the noise."""
    picture = PolicyFeature(type=FeatureType.VISUAL, shape=(3, s.picture, s.picture))
    return DiffusionConfig(
        n_obs_steps=1,
        horizon=s.horizon,
        n_action_steps=s.horizon,
        input_features={
            **dict.fromkeys(IMAGES, picture),
            STATE: PolicyFeature(type=FeatureType.STATE, shape=(len(STATE_NAMES),)),
        },
        output_features={ACTION: PolicyFeature(type=FeatureType.ACTION, shape=(len(ACTION_NAMES),))},
        normalization_mapping={
            "VISUAL": NormalizationMode.MEAN_STD,
            "STATE": NormalizationMode.MEAN_STD,
            "ACTION": NormalizationMode.MIN_MAX,
        },
        vision_backbone=s.backbone,
        pretrained_backbone_weights=None,
        crop_shape=(s.crop, s.crop),
        crop_is_random=False,
        use_group_norm=True,
        use_separate_rgb_encoder_per_camera=True,
        spatial_softmax_num_keypoints=s.keypoints,
        down_dims=s.down_dims,
        kernel_size=3,
        noise_scheduler_type="DDIM",
        num_inference_steps=s.inference_steps,
        prediction_type="sample",
        push_to_hub=False,
        device=device,
    )


class Heads(nn.Module):
    """What else can be read from the features that the diffusion is conditioned on; `free` is of where the block is,
    in the units of `BLOCK_MEAN` and `BLOCK_SPREAD`, and of nothing else."""

    def __init__(self, features: int) -> None:
        super().__init__()
        self.done = nn.Sequential(nn.Linear(features, 64), nn.ReLU(), nn.Linear(64, 1))
        self.block = nn.Sequential(nn.Linear(features, 64), nn.ReLU(), nn.Linear(64, len(BLOCK_NAMES)))
        self.free: nn.Module = nn.Sequential(nn.Linear(len(BLOCK_NAMES), 32), nn.ReLU(), nn.Linear(32, 1))


class FarFromWalls(nn.Module):
    """`Heads.free` of a policy from before that: what taught it went on until a block was 40 mm from both walls."""

    FREE = 0.03

    def forward(self, block: Tensor) -> Tensor:
        gaps = torch.as_tensor(BLOCK_MEAN)[GAPS] + torch.as_tensor(BLOCK_SPREAD)[GAPS] * block.cpu()[:, GAPS].double()
        return (gaps.min(1).values[:, None] - self.FREE) / 0.001


class DiffusionStudent(nn.Module):
    """`learning.camera_view.CameraPolicy`, trainable.

    Args:
        policy: LeRobot's.
        pre, post: its processors, with the statistics of the demonstrations.
        heads: ours.
    """

    def __init__(self, policy: DiffusionPolicy, pre: Any, post: Any, heads: Heads) -> None:
        super().__init__()
        self.policy, self.heads = policy, heads
        self.pre, self.post = pre, post
        # A CPU convolves pictures that hold their channels together in three quarters of the time.
        policy.diffusion.rgb_encoder.to(memory_format=torch.channels_last)

    @staticmethod
    def create(
        s: DiffusionSettings, statistics: Mapping[str, Mapping[str, np.ndarray]], device: str
    ) -> DiffusionStudent:
        """A policy with random weights.

        Args:
            statistics: for pictures, state and action LeRobot's mean, std, min and max.

        Raises:
            PolicyError: a statistic is missing. LeRobot would take it for the identity without a word.
        """
        for name in (*IMAGES, STATE, ACTION):
            missing = [k for k in STATISTICS if k not in statistics.get(name, {})]
            if missing:
                raise PolicyError(f"the demonstrations have no {', '.join(missing)} of '{name}'", RETRAIN)
        config = make_config(s, device)
        tensors = {k: {n: torch.as_tensor(v, dtype=torch.float32) for n, v in d.items()} for k, d in statistics.items()}
        pre, post = make_pre_post_processors(config, dataset_stats=tensors)
        policy = DiffusionPolicy(config)
        return DiffusionStudent(policy, pre, post, Heads(_features(policy))).to(device)

    @property
    def picture(self) -> int:
        return int(self.policy.config.input_features[IMAGES[0]].shape[-1])

    @property
    def states(self) -> int:
        """How many of `STATE_NAMES` it is told, from the first on."""
        return _states(self.policy)

    @property
    def horizon(self) -> int:
        return int(self.policy.config.horizon)

    @property
    def device(self) -> torch.device:
        return next(self.parameters()).device

    def features(self, pictures: Tensor, state: Tensor) -> Tensor:
        """(n, f) what the diffusion is conditioned on.

        Args:
            pictures: (n, views, 3, p, p) in [0, 1].
            state: (n, s), as measured: as many as this policy was trained with.
        """
        batch = {key: pictures[:, i] for i, key in enumerate(IMAGES)} | {STATE: state}
        batch = self.pre(batch)
        images = torch.stack([batch[key] for key in IMAGES], dim=1)
        # LeRobot has no public way to its features, and the heads and the diffusion shall share one pass.
        return self.policy.diffusion._prepare_global_conditioning(
            {STATE: batch[STATE][:, None], "observation.images": images[:, None]}
        )

    @torch.no_grad()
    def __call__(self, pictures: UInt8[np.ndarray, "n v p p 3"], state: Float[np.ndarray, "n s"]) -> Prediction:
        """The most likely chunk: the diffusion starts from no noise, so the same picture gives the same motion."""
        seen = torch.from_numpy(np.ascontiguousarray(pictures)).to(self.device)
        seen = seen.permute(0, 1, 4, 2, 3).float() / 255
        known = torch.as_tensor(state[:, : self.states], dtype=torch.float32, device=self.device)
        features = self.features(seen, known)
        noise = torch.zeros(len(seen), self.horizon, len(ACTION_NAMES), device=self.device)
        chunk = self.policy.diffusion.conditional_sample(len(seen), global_cond=features, noise=noise)
        steps, block = self.post(chunk), self.heads.block(features)
        return Prediction(
            steps.cpu().numpy().astype(np.float64),
            torch.sigmoid(self.heads.done(features))[:, 0].cpu().numpy(),
            torch.sigmoid(self.heads.free(block))[:, 0].cpu().numpy(),
            BLOCK_MEAN + BLOCK_SPREAD * block.cpu().numpy(),
        )

    def save(self, folder: Path, rig: Rig) -> None:
        """Write everything under `folder`, which is made. `rig` is the one whose cameras it was trained for."""
        folder.mkdir(parents=True, exist_ok=True)
        self.policy.save_pretrained(folder)
        self.pre.save_pretrained(folder)
        self.post.save_pretrained(folder)
        heads = {k: v.contiguous() for k, v in self.heads.state_dict().items()}
        write_bytes(folder / "heads.safetensors", to_bytes(heads))
        stamp = {"version": VERSION, "horizon": self.horizon, "cameras": {v: _geometry(rig.camera(v)) for v in VIEWS}}
        write_text(folder / "resync.json", json.dumps(stamp, indent=2, sort_keys=True) + "\n")


def load_student(folder: Path, rig: Rig | None = None, device: str = "cpu") -> DiffusionStudent:
    """A saved policy.

    Args:
        rig: refuse a policy that was trained for cameras that stand elsewhere; None takes any.

    Raises:
        PolicyError: missing, truncated, of another version or rig, or without statistics.
    """
    try:
        stamp = json.loads(read_text(folder / "resync.json"))
    except (OSError, ValueError) as error:
        raise PolicyError(f"there is no camera policy in {folder}: {error}", RETRAIN) from None
    found = stamp.get("version") if isinstance(stamp, dict) else None
    if found not in READ or set(stamp.get("cameras", {})) != set(VIEWS):
        raise PolicyError(
            f"the camera policy in {folder} is of version {found}; this program reads versions {READ[0]} to {VERSION}, "
            f"with the cameras {', '.join(VIEWS)}",
            RETRAIN,
        )
    if rig is not None:
        for view in VIEWS:
            _check_camera(view, stamp["cameras"][view], rig.camera(view))
    try:
        with redirect_stdout(StringIO()):  # LeRobot announces that it loads weights
            policy = DiffusionPolicy.from_pretrained(folder)
        policy.config.device = device
        overrides = {"device_processor": {"device": device}}
        pre, post = make_pre_post_processors(
            policy.config, pretrained_path=str(folder), preprocessor_overrides=overrides
        )
        _check_statistics(folder, pre)
        heads = Heads(_features(policy))
        if found == READ[0]:
            heads.free = FarFromWalls()
        # Some have a head more, which told cameras apart; geometry does so now.
        stored = load_file(folder / "heads.safetensors").items()
        heads.load_state_dict({name: values for name, values in stored if not name.startswith("view.")})
    except PolicyError:
        raise
    except (OSError, ValueError, KeyError, RuntimeError, SafetensorError, TypeError, AttributeError) as error:
        raise PolicyError(f"the camera policy in {folder} cannot be read: {error}", RETRAIN) from error
    return DiffusionStudent(policy, pre, post, heads).to(device).eval()


def _geometry(camera: CameraRig) -> dict[str, Any]:
    """What a policy gets used to of a camera: where it is mounted, and how much it shows."""
    view = {"width": camera.width / camera.fx, "height": camera.height / camera.fy}
    return {"mount": camera.mount, "pose": camera.pose.tolist(), "view": view}


def _check_camera(name: str, trained: Mapping[str, Any], camera: CameraRig) -> None:
    """Raises PolicyError where the camera's place or view is another one than in training."""
    change = spatial.inverse(np.asarray(trained["pose"])) @ camera.pose
    moved = float(np.linalg.norm(change[:3, 3]))
    turned = float(np.arccos(np.clip((np.trace(change[:3, :3]) - 1) / 2, -1, 1)))
    zoomed = max(abs(_geometry(camera)["view"][k] / v - 1) for k, v in trained["view"].items())
    if trained["mount"] == camera.mount and moved <= MOVED and turned <= TURNED and zoomed <= ZOOMED:
        return
    raise PolicyError(
        f"the camera policy was trained for another rig: there '{name}' was mounted on the {trained['mount']}, "
        f"{1000 * moved:.0f} mm and {np.degrees(turned):.1f} degrees from here, with a view {100 * zoomed:.0f} % "
        f"different; allowed: {1000 * MOVED:.0f} mm, {np.degrees(TURNED):.0f} degrees, {100 * ZOOMED:.0f} %",
        "train one for this rig, or use --skills state",
    )


def _check_statistics(folder: Path, pre: Any) -> None:
    known = [set(getattr(step, "stats", None) or {}) for step in pre.steps]
    missing = [name for name in (*IMAGES, STATE, ACTION) if not any(name in names for names in known)]
    if missing:
        raise PolicyError(f"the camera policy in {folder} has no normalisation statistics of {missing[0]}", RETRAIN)


def _features(policy: DiffusionPolicy) -> int:
    return _states(policy) + int(policy.diffusion.rgb_encoder[0].feature_dim) * len(VIEWS)


def _states(policy: DiffusionPolicy) -> int:
    return int(policy.config.input_features[STATE].shape[0])
