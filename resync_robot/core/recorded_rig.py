"""What a drawing needs to know of the machine that a recording was made with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from resync_robot.core.episode import Episode
from resync_robot.core.errors import EpisodeError
from resync_robot.core.machines import ARMS, ArmModel


@dataclass(frozen=True)
class RecordedRig:
    """The few facts of the recorded rig that a drawing needs, SI units.

    Attributes:
        hues: colours of the lab's own blocks by name; empty where they are those of the catalogue.
    """

    arm: ArmModel
    world_T_base: np.ndarray
    tip_offset: float
    finger_thickness: float
    finger_width: float
    hues: Mapping[str, float]

    @staticmethod
    def of(episode: Episode) -> RecordedRig:
        """Raises EpisodeError where the recording's rig cannot be used."""
        try:
            arm, gripper = episode.meta.rig["arm"], episode.meta.rig["gripper"]
            pose = np.array(arm["world_T_base"], dtype=np.float64).reshape(4, 4)
            tip, thick, wide = (float(gripper[n]) for n in ("tip_offset", "finger_thickness", "finger_width"))
            hues = {str(name): float(hue) for name, hue in episode.meta.rig.get("hues", {}).items()}
            return RecordedRig(ARMS[arm["model"]], pose, tip, thick, wide, hues)
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise EpisodeError(f"{episode.path}: the rig in /meta cannot be used: {error}") from None

    def frames(self, q: Float[np.ndarray, "6"]) -> Float[np.ndarray, "7 4 4"]:
        """Poses in the world of the base and of the six DH frames, the last of which is the flange's."""
        return np.concatenate([self.world_T_base[None], self.world_T_base @ self.arm.kinematics.link_frames(q)])
