"""The noise of a camera is found again in what the simulated camera makes of a plane."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from resync_robot.calibration.depth_noise import fit_noise
from resync_robot.core.errors import CalibrationError
from resync_robot.core.rig import load_rig
from resync_robot.core.sensor_noise import SensorNoise
from resync_robot.core.world import CameraFrame
from resync_robot.sim_training.physics.camera_noise import NoisySensor

WRIST = load_rig().camera("wrist")


def plane(slant: float, near: float = 0.45) -> CameraFrame:
    """A table seen from a slant (1/m of inverse depth over the picture's height), with something standing on it."""
    rows = np.linspace(-0.5, 0.5, WRIST.height)[:, None]
    columns = np.linspace(-0.5, 0.5, WRIST.width)[None, :]
    z = 1.0 / (1.0 / near + slant * rows + 0.1 * slant * columns)
    z[20:70, 300:380] -= 0.08
    colour = np.tile(np.array([150, 130, 110], np.uint8), (WRIST.height, WRIST.width, 1))
    return CameraFrame("wrist", colour, np.round(z / 1e-4).astype(np.uint16), WRIST.intrinsics, np.eye(4), 0.0)


def stills(noise: SensorNoise, count: int = 12, slants: tuple[float, ...] = (0.5, 0.8)) -> list[list[CameraFrame]]:
    sensor = NoisySensor(3, WRIST, noise)
    return [[sensor.apply(plane(s, 0.42 + 0.05 * i)) for _ in range(count)] for i, s in enumerate(slants)]


@pytest.mark.parametrize(
    "noise",
    [
        SensorNoise(),
        SensorNoise(disparity_sigma_px=0.15, ripple_px=0.01, hole_share=0.03, colour_sigma=5.0, exposure_sigma=0.02),
    ],
    ids=["as published", "another camera"],
)
def test_what_was_put_in_is_found_again(noise: SensorNoise) -> None:
    fit = fit_noise(WRIST, stills(noise))
    found = fit.noise
    assert found.disparity_sigma_px == pytest.approx(noise.disparity_sigma_px, rel=0.08)
    assert found.ripple_px == pytest.approx(noise.ripple_px, abs=0.004)
    assert found.hole_share == pytest.approx(noise.hole_share, rel=0.25)
    assert found.colour_sigma == pytest.approx(noise.colour_sigma, rel=0.1)
    assert found.exposure_sigma == pytest.approx(noise.exposure_sigma, rel=0.5)
    assert found.white_balance_sigma == pytest.approx(noise.white_balance_sigma, rel=0.5)
    assert found.flying_share == WRIST.noise.flying_share, "a plane tells nothing about edges"
    assert fit.flat > 0.6


def test_pictures_that_tell_nothing_are_refused() -> None:
    usual = stills(SensorNoise())
    with pytest.raises(CalibrationError, match=r"3 pictures of one place(.|\n)*--frames"):
        fit_noise(WRIST, [usual[0][:3]])
    with pytest.raises(CalibrationError, match=r"424 x 240 px; the rig says that 'wrist' has 848 x 480(.|\n)*--rig"):
        fit_noise(replace(WRIST, width=848, height=480), usual)
    with pytest.raises(CalibrationError, match="0 pictures"):
        fit_noise(WRIST, [])
    with pytest.raises(CalibrationError, match="slant"):
        fit_noise(WRIST, stills(SensorNoise(), slants=(0.0,)))
    rough = [
        replace(f, depth=np.random.default_rng(0).integers(3000, 9000, f.depth.shape).astype(np.uint16))
        for f in usual[0]
    ]
    with pytest.raises(CalibrationError, match="one flat surface"):
        fit_noise(WRIST, [rough])
    blind = [replace(f, depth=np.zeros_like(f.depth)) for f in usual[0]]
    with pytest.raises(CalibrationError, match="one flat surface"):
        fit_noise(WRIST, [blind])
    dark = [replace(f, colour=np.zeros_like(f.colour)) for f in usual[0]]
    with pytest.raises(CalibrationError, match="too dark"):
        fit_noise(WRIST, [dark])
