"""What a recovery policy sees and does: relational, and canonical under the symmetry of the box.

The projection proj(x) keeps the robot, the failure object (the box) and the relevant object (the block). Positions are
taken in the box's frame and mirrored so that the nearest corner is always at (+, +): one corner teaches all four.
Everything is batched torch, so that thousands of simulated robots and one real one run the same lines.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from resync_robot.core.errors import LibraryError
from resync_robot.core.library import RETRAIN, Record
from resync_robot.core.state import State
from resync_robot.core.symbols import Object

TIP, COMMANDED, BLOCK, BOX = slice(0, 3), slice(3, 6), slice(6, 16), slice(16, 27)
"""Columns of a projected state: tip position, commanded tip position (world, m), features of block and box."""
PROJECTED_SIZE = 27

OBSERVATION_SIZE = 19
ACTION_SIZE = 3
STEP = 0.02
"""m of commanded tip motion per control step at action 1."""
LEASH = 0.015
"""m that the commanded tip may lead the measured one: bounds the force of a press."""
LAG = 0.9
"""Most control steps that an arm may be behind its commands: streaming within jerk limits costs 30 to 90 ms."""
STUD = 0.012
LOWEST_TIP = 0.02
"""m above the box floor below which the tip is never sent."""


@dataclass(frozen=True, kw_only=True)
class PressVariety:
    """What training draws for each run."""

    lag: float = LAG
    """Most control steps that an arm is behind its commands."""
    height: tuple[float, float] = (0.002, 0.07)
    """m over the stud at which the policy takes over, up to a little more than the skill's own approach leaves."""
    aside: float = 0.012
    """Most m beside the block's middle, along each axis, at which it does: an approach relies on a scan that errs."""


def project(state: State, robot: Object, block: Object, box: Object, commanded: np.ndarray) -> Tensor:
    """(1, 27) projected state from one full state; `commanded` is the (3,) tip position last sent."""
    row = np.concatenate([state.get(robot, "x", "y", "z"), commanded, state[block], state[box]])
    return torch.as_tensor(row, dtype=torch.float32)[None]


def box_axes(x: Tensor) -> tuple[Tensor, Tensor]:
    """(n, 2) unit x and y axes of the box in the world's horizontal plane."""
    w, z = x[:, BOX][:, 3], x[:, BOX][:, 6]
    yaw = 2 * torch.atan2(z, w)
    c, s = torch.cos(yaw), torch.sin(yaw)
    return torch.stack([c, s], -1), torch.stack([-s, c], -1)


def _in_box(x: Tensor, vector: Tensor) -> Tensor:
    """(n, 2) components of horizontal world vectors (n, 2) along the box's axes."""
    along_x, along_y = box_axes(x)
    return torch.stack([(vector * along_x).sum(-1), (vector * along_y).sum(-1)], -1)


def mirror(x: Tensor) -> Tensor:
    """(n, 2) signs that bring the corner nearest to the block to (+, +)."""
    block = _in_box(x, x[:, BLOCK][:, :2] - x[:, BOX][:, :2])
    return torch.where(block < 0, -1.0, 1.0)


def wall_gaps(x: Tensor) -> Tensor:
    """(n, 2) free distance in m between the block's footprint and the nearest wall along each axis of the box."""
    block = _in_box(x, x[:, BLOCK][:, :2] - x[:, BOX][:, :2])
    yaw = block_yaw(x)
    half = x[:, BLOCK][:, 7] / 2 * (torch.cos(yaw).abs() + torch.sin(yaw).abs())
    return x[:, BOX][:, 7:9] / 2 - block.abs() - half[:, None]


def block_yaw(x: Tensor) -> Tensor:
    """(n,) heading of the block relative to the box, rad."""
    along_x, along_y = box_axes(x)
    w, i, j, k = x[:, BLOCK][:, 3:7].unbind(-1)
    heading = torch.stack([1 - 2 * (j * j + k * k), 2 * (i * j + w * k)], -1)
    return torch.atan2((heading * along_y).sum(-1), (heading * along_x).sum(-1))


def up_axis(x: Tensor) -> Tensor:
    """(n, 3) the block's z axis in the world."""
    w, i, j, k = x[:, BLOCK][:, 3:7].unbind(-1)
    return torch.stack([2 * (i * k + w * j), 2 * (j * k - w * i), 1 - 2 * (i * i + j * j)], -1)


def tip_above_stud(x: Tensor) -> Tensor:
    """(n,) height in m of the tip over the top of the block's stud."""
    return x[:, 2] - (x[:, BLOCK][:, 2] + x[:, BLOCK][:, 9] / 2 + STUD)


def observe(x: Tensor) -> Tensor:
    """(n, 19) what the policy sees of (n, 27) projected states, lengths in decimetres."""
    sign = mirror(x)
    tip = _in_box(x, x[:, TIP][:, :2] - x[:, BLOCK][:, :2]) * sign
    lead = _in_box(x, x[:, COMMANDED][:, :2] - x[:, TIP][:, :2]) * sign
    tip_in_box = _in_box(x, x[:, TIP][:, :2] - x[:, BOX][:, :2]) * sign
    yaw = 4 * block_yaw(x)
    up = up_axis(x)
    lean = _in_box(x, up[:, :2]) * sign
    columns = [
        10 * wall_gaps(x),
        10 * tip,
        10 * tip_above_stud(x)[:, None],
        10 * (x[:, BOX][:, 7:9] / 2 - tip_in_box),
        100 * lead,
        100 * (x[:, COMMANDED][:, 2] - x[:, TIP][:, 2])[:, None],
        torch.cos(yaw)[:, None],
        (torch.sin(yaw) * sign[:, 0] * sign[:, 1])[:, None],
        5 * lean,
        up[:, 2:],
        10 * x[:, BLOCK][:, 7:8],
        10 * x[:, BLOCK][:, 9:10],
        10 * (x[:, 2] - x[:, BOX][:, 2] - x[:, BOX][:, 9])[:, None],
        10 * (x[:, BLOCK][:, 2] - x[:, BOX][:, 2] - x[:, BLOCK][:, 9] / 2)[:, None],
    ]
    return torch.cat(columns, -1)


def commanded_tip(x: Tensor, action: Tensor) -> Tensor:
    """(n, 3) where the tip is sent: the last command moved by `action` in [-1, 1]^3, on a leash to the tip."""
    sign = mirror(x)
    along_x, along_y = box_axes(x)
    step = STEP * action.clamp(-1, 1)
    planar = step[:, :2] * sign
    world = planar[:, :1] * along_x + planar[:, 1:] * along_y
    return within_reach(x, x[:, COMMANDED] + torch.cat([world, step[:, 2:]], -1))


def within_reach(x: Tensor, wanted: Tensor) -> Tensor:
    """(n, 3) where a tip that is wanted at (n, 3) is sent: on a leash to where it is, and over the box's interior."""
    along_x, along_y = box_axes(x)
    tip = x[:, TIP]
    leashed = tip + (wanted - tip).clamp(-LEASH - STEP, LEASH + STEP)
    # Keep the tip over the interior: nothing of this skill happens on the walls.
    centre = x[:, BOX][:, :2]
    local = _in_box(x, leashed[:, :2] - centre)
    limit = x[:, BOX][:, 7:9] / 2 - 0.02
    local = torch.maximum(torch.minimum(local, limit), -limit)
    planar = centre + local[:, :1] * along_x + local[:, 1:] * along_y
    lowest = x[:, BOX][:, 2] + LOWEST_TIP
    return torch.cat([planar, leashed[:, 2:].clamp(max=0.30).maximum(lowest[:, None])], -1)


class ActorCritic(nn.Module):
    """Gaussian policy and value, 4 x 256 tanh each, as in the paper, with the observation normaliser inside."""

    def __init__(
        self, width: int = 256, depth: int = 4, observations: int = OBSERVATION_SIZE, actions: int = ACTION_SIZE
    ) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(observations))
        self.register_buffer("scale", torch.ones(observations))
        self.actor = _mlp(observations, width, depth, actions, 0.01)
        self.critic = _mlp(observations, width, depth, 1, 1.0)
        self.shape = {"width": width, "depth": depth, "observations": observations, "actions": actions}

    def begin_anew(self, seed: int) -> None:
        """Other weights, as if nothing had been learned yet; the normaliser stays."""
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            fresh = ActorCritic(**self.shape)
        self.actor.load_state_dict(fresh.actor.state_dict())
        self.critic.load_state_dict(fresh.critic.state_dict())

    def normalise(self, observation: Tensor) -> Tensor:
        return ((observation - self.mean) / self.scale).clamp(-8, 8)

    def act(self, observation: Tensor) -> Tensor:
        """(n, 3) the mean action."""
        return self.actor(self.normalise(observation))

    def value(self, observation: Tensor) -> Tensor:
        return self.critic(self.normalise(observation)).squeeze(-1)

    def to_tensors(self) -> dict[str, np.ndarray]:
        """Weights of the actor and the normaliser, for a library record."""
        return {k: v.numpy().copy() for k, v in self.state_dict().items() if not k.startswith("critic")}

    @staticmethod
    def from_record(record: Record) -> ActorCritic:
        """The saved actor. Raises LibraryError where weights or the normaliser are missing or misshaped."""
        try:
            sizes = {name: int(record.meta[name]) for name in ("observations", "actions") if name in record.meta}
            net = ActorCritic(int(record.meta["width"]), int(record.meta["depth"]), **sizes)
        except (KeyError, TypeError, ValueError):
            raise LibraryError(f"the recovery policy's record has no width and depth: {record.meta}", RETRAIN) from None
        weights: Mapping[str, np.ndarray] = record.tensors
        for name, parameter in net.state_dict().items():
            if name.startswith("critic"):
                continue
            if name not in weights or weights[name].shape != tuple(parameter.shape):
                raise LibraryError(f"the recovery policy's record has no fitting '{name}'", RETRAIN)
        net.load_state_dict({k: torch.from_numpy(np.array(v)) for k, v in weights.items()}, strict=False)
        return net.eval()


def _mlp(inputs: int, width: int, depth: int, outputs: int, last_gain: float) -> nn.Sequential:
    layers: list[nn.Module] = []
    for i in range(depth):
        layer = nn.Linear(inputs if i == 0 else width, width)
        nn.init.orthogonal_(layer.weight, np.sqrt(2))
        nn.init.zeros_(layer.bias)
        layers += [layer, nn.Tanh()]
    last = nn.Linear(width, outputs)
    nn.init.orthogonal_(last.weight, last_gain)
    nn.init.zeros_(last.bias)
    return nn.Sequential(*layers, last)
