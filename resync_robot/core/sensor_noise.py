"""How bad a depth camera is: what a rig file says of it, and what simulation then does to rendered pictures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from resync_robot.core.errors import ConfigError
from resync_robot.core.ranges import RANGES, read_number
from resync_robot.core.tables import check_names


@dataclass(frozen=True, kw_only=True)
class SensorNoise:
    """The `[cameras.noise]` table; every field may be left out. Disparities in pixels of the rig's picture.

    The defaults are those of a D435i as published; `resync-robot calibrate noise` measures one's own.
    """

    focal_at_848_px: float = 447.0
    """Focal length of the depth camera at a width of 848 pixels; it scales with the width."""
    baseline: float = 0.050
    """Distance between the two eyes, m."""
    disparity_sigma_px: float = 0.08
    disparity_step_px: float = 1 / 32
    """Quantisation of the matcher."""
    ripple_px: float = 0.03
    """Amplitude of the error that repeats with every pixel of disparity."""
    least_depth_at_848: float = 0.2
    """m; nearer surfaces have no match. Scales with the width, as the search range is fixed in pixels."""
    edge_step: float = 0.012
    """Depth steps above this within one pixel's neighbourhood count as an edge, m."""
    flying_share: float = 0.35
    """Share of edge pixels whose depth lies somewhere between the two surfaces."""
    edge_hole_share: float = 0.25
    hole_share: float = 0.004
    """Share of the picture in random small holes."""
    exposure_sigma: float = 0.06
    white_balance_sigma: float = 0.015
    exposure_time: float = 0.0156
    """s that the shutter of the colour picture is open; while the camera moves, this blurs.

    Both times are the D435i's own defaults for when auto exposure is off, 156 and 8500 (librealsense issue 9954), in
    steps of 100 us for colour (issue 8243) and of 1 us for depth (issue 6384). Auto exposure follows the light, so
    what holds in a laboratory is read off its own pictures.
    """
    depth_exposure_time: float = 0.0085
    colour_sigma: float = 2.5
    """Noise of a colour value, of 255."""


def read_noise(table: Any, where: str) -> SensorNoise:
    """The table as it stands in a rig file. Raises ConfigError on an extra, mistyped or implausible field."""
    check_names(table, SensorNoise, where, whole=False)
    numbers = {n: read_number(v, RANGES[f"cameras.noise.{n}"], f"{where}: {n}") for n, v in table.items()}
    noise = SensorNoise(**numbers)
    if noise.flying_share + noise.edge_hole_share > 1:
        raise ConfigError(f"{where}: flying_share and edge_hole_share are parts of the same pixels; together at most 1")
    return noise
