"""A simulated D435i: turns a perfect rendered picture into what such a camera, calibrated so well and no better, gives.

Depth of a stereo camera is f B / disparity, so an error in disparity grows with the square of the distance. The same
geometry explains the blind band at the left of the picture and the shadow beside every near edge: the second eye does
not see those points.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from resync_robot.core import spatial
from resync_robot.core.rig import CameraRig
from resync_robot.core.sensor_noise import SensorNoise
from resync_robot.core.world import CameraFrame
from resync_robot.sim_training.physics.motion_blur import Motion, flow_of, smear_colour, smear_depth

SCREEN = 2.2
"""Gamma of rendered pictures."""
DRIFT_S = 120.0
"""s in which exposure and white balance of a camera forget what they were."""
KNOT_S = 10.0


@dataclass(frozen=True, kw_only=True)
class Tone:
    """How a camera is set, in a world's light; by default it leaves rendered pictures as they are.

    Attributes:
        gamma: 1 gives values as light falls in, 2.2 as screens expect them.
        white_balance: (3,) factors on red, green and blue light.
    """

    gamma: float = SCREEN
    white_balance: tuple[float, float, float] = (1.0, 1.0, 1.0)

    @staticmethod
    def of(physics: Mapping[str, Any]) -> Tone:
        """As a world has it."""
        return Tone(**physics.get("camera", {}))

    @cached_property
    def _table(self) -> UInt8[np.ndarray, "256 1 3"]:
        light = (np.arange(256)[:, None] / 255) ** SCREEN * np.array(self.white_balance)
        return np.round(255 * np.clip(light, 0, 1) ** (1 / self.gamma)).astype(np.uint8)[:, None]

    def apply(self, colour: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 3"]:
        """The picture as the camera gives it."""
        return cv2.LUT(np.ascontiguousarray(colour), self._table)


class Drift:
    """Exposure and white balance beside what the light asks for: drawn once, and wandering slowly (an
    Ornstein-Uhlenbeck process at every KNOT_S, straight lines between). A function of time and seed, whoever asks when.
    """

    def __init__(self, noise: SensorNoise, rng: np.random.Generator) -> None:
        self._noise, self._rng = noise, rng
        self._logs = [draw_logs(noise, rng)]

    def gains(self, time: float) -> Float[np.ndarray, "3"]:
        """Factors on red, green and blue at that moment, s."""
        knots = max(0.0, time) / KNOT_S
        before = int(knots)
        while len(self._logs) < before + 2:
            keep = float(np.exp(-KNOT_S / DRIFT_S))
            self._logs.append(keep * self._logs[-1] + np.sqrt(1.0 - keep**2) * draw_logs(self._noise, self._rng))
        share = knots - before
        return np.exp((1.0 - share) * self._logs[before] + share * self._logs[before + 1])


def draw_logs(noise: SensorNoise, rng: np.random.Generator) -> Float[np.ndarray, "3"]:
    """Logarithms of the factors on red, green and blue that a camera may be set to."""
    return rng.normal(0.0, noise.exposure_sigma) + rng.normal(0.0, noise.white_balance_sigma, 3)


class NoisySensor:
    """Adds a D435i's faults to rendered frames.

    A camera on the flange gets a new pose error with every frame (a view of its own: hand-eye calibration and arm),
    one that stands in the world keeps a single error, as a wrong calibration would.

    Args:
        seed: same seed, same frames, same result.
        camera_rig: gives the sigmas of the pose error, a normal error of each of the three axes.
        settings: how bad the camera is; by default as the rig says.
        tone: how it is set.
        steady: exposure and white balance are drawn once and wander slowly, as those of a camera that watches one
            scene. Else they are drawn for each picture: for whoever learns or measures from pictures taken at random.
    """

    def __init__(
        self,
        seed: int,
        camera_rig: CameraRig,
        settings: SensorNoise | None = None,
        tone: Tone | None = None,
        steady: bool = False,
    ) -> None:
        self._tone = tone or Tone()
        self._rng = np.random.default_rng(seed)
        self._rig = camera_rig
        self.settings = settings or camera_rig.noise
        # Of streams of their own: how often a film looks changes no picture that is asked for.
        self._drift = Drift(self.settings, np.random.default_rng([seed, 83])) if steady else None
        self._film_rng = np.random.default_rng([seed, 89])
        self._fixed_error = None if camera_rig.mount == "flange" else self._draw_pose_error()

    def apply(self, frame: CameraFrame, motion: Motion | None = None) -> CameraFrame:
        """The frame as the camera would deliver it; `world_T_cam` becomes what the robot believes, not the truth.

        Args:
            motion: of the camera at that moment; None where it rests.
        """
        error = self.pose_error()
        colour, z = frame.colour, frame.depth.astype(np.float32) * np.float32(CameraFrame.DEPTH_UNIT_M)
        if motion is not None:
            flow = flow_of(motion, z, frame.intrinsics, self._rig.pose)
            colour = smear_colour(colour, flow * np.float32(self.settings.exposure_time))
            z = smear_depth(z, flow * np.float32(self.settings.depth_exposure_time))
        return replace(
            frame, colour=self.colour(colour, frame.time), depth=self._depth(z), world_T_cam=frame.world_T_cam @ error
        )

    def pose_error(self) -> Float[np.ndarray, "4 4"]:
        """camera_T_believed: for a camera on the flange another one each time it is asked."""
        return self._fixed_error if self._fixed_error is not None else self._draw_pose_error()

    def _draw_pose_error(self) -> Float[np.ndarray, "4 4"]:
        turn = self._rng.normal(0.0, self._rig.rotation_sigma, 3)
        shift = self._rng.normal(0.0, self._rig.position_sigma, 3)
        return spatial.transform(spatial.rotation_from_vector(turn), shift)

    def colour(self, colour: UInt8[np.ndarray, "h w 3"], time: float = 0.0) -> UInt8[np.ndarray, "h w 3"]:
        """A picture of that moment (s), or a part of one, with the camera's exposure, white balance and noise."""
        return self._expose(colour, time, self._rng)

    def glimpse(self, colour: UInt8[np.ndarray, "h w 3"], time: float = 0.0) -> UInt8[np.ndarray, "h w 3"]:
        """The same for a film: no other picture changes by it."""
        return self._expose(colour, time, self._film_rng)

    def _expose(self, colour: np.ndarray, time: float, rng: np.random.Generator) -> UInt8[np.ndarray, "h w 3"]:
        s = self.settings
        gain = np.exp(draw_logs(s, rng)) if self._drift is None else self._drift.gains(time)
        noise = rng.standard_normal(colour.shape, dtype=np.float32) * np.float32(s.colour_sigma)
        return np.clip(self._tone.apply(colour) * gain.astype(np.float32) + noise + 0.5, 0, 255).astype(np.uint8)

    def _depth(self, z: np.ndarray) -> np.ndarray:
        s, rng = self.settings, self._rng
        height, width = z.shape
        focal_baseline = np.float32(s.focal_at_848_px * width / 848 * s.baseline)
        z = self._flying(z)
        valid = z > max(s.least_depth_at_848 * width / 848, 1e-3)
        disparity = focal_baseline / np.where(valid, z, 1.0)

        # The second eye sees column x at x - disparity: outside its picture, or behind something, there is no match.
        column_there = np.arange(width, dtype=np.float32) - disparity
        column_there[~valid] = np.inf
        nearest_right = np.minimum.accumulate(column_there[:, ::-1], axis=1)[:, ::-1]
        shadow = np.zeros_like(valid)
        shadow[:, :-1] = nearest_right[:, 1:] < column_there[:, :-1] - 1.0
        valid &= (column_there >= 0) & ~shadow

        ripple = np.float32(s.ripple_px) * np.sin(np.float32(2 * np.pi) * disparity)
        noise = rng.standard_normal(z.shape, dtype=np.float32) * np.float32(s.disparity_sigma_px)
        step = np.float32(s.disparity_step_px)
        measured = np.round((disparity + ripple + noise) / step) * step
        valid &= measured > 0
        valid &= ~self._holes(height, width)
        z = focal_baseline / np.where(valid, measured, 1.0)
        return np.where(valid, np.clip(z / CameraFrame.DEPTH_UNIT_M + 0.5, 0, 65535), 0).astype(np.uint16)

    def _flying(self, z: np.ndarray) -> np.ndarray:
        """Depth with some of its edge pixels between the two surfaces, and some lost (0)."""
        s = self.settings
        kernel = np.ones((3, 3), np.uint8)
        near, far = cv2.erode(z, kernel), cv2.dilate(z, kernel)
        rows, columns = np.nonzero(far - near > s.edge_step)
        draw = self._rng.random((2, len(rows)), dtype=np.float32)
        low, high = near[rows, columns], far[rows, columns]
        flies = draw[0] < s.flying_share
        lost = draw[0] > 1.0 - s.edge_hole_share
        result = z.copy()
        result[rows[flies], columns[flies]] = (low + draw[1] * (high - low))[flies]
        result[rows[lost], columns[lost]] = 0.0
        return result

    def _holes(self, height: int, width: int) -> np.ndarray:
        """Small random patches without a match: (H, W) bool."""
        seeds = self._rng.random((height // 3 + 1, width // 3 + 1), dtype=np.float32) < self.settings.hole_share
        return cv2.resize(seeds.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST).astype(bool)
