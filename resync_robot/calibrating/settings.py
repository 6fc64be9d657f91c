"""What `resync-robot calibrate` may be told. Light: the command line reads it for --help."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from resync_robot.calibration.board import BoardSpec
from resync_robot.core.errors import ConfigError
from resync_robot.core.files import EMULATED, RIG, check_output, packaged_rig
from resync_robot.core.options import check_range, check_seed
from resync_robot.given import Given

MOST_POSES, MOST_THINGS = 100, 4
"""Of one run: pictures of a board; things in a row."""
NAME = re.compile(r"[A-Za-z0-9_-]+")
"""Of a thing, as a rig file has it under [hues]."""


@dataclass(frozen=True, kw_only=True)
class BoardConfig:
    """Draw a ChArUco board to scale, as PDF or PNG."""

    board: BoardSpec = field(default_factory=BoardSpec)
    """What is on it."""

    out: Path = Path("board.pdf")
    """The file to write: .pdf (for printing) or .png."""

    dpi: int = 600
    """Pixels an inch of a .png."""


@dataclass(frozen=True, kw_only=True)
class LookConfig:
    """What all that take pictures have in common."""

    backend: Literal["sim", "ur7e"] = "sim"
    """The robot and cameras to use; ur7e is the real or emulated one of --rig. Simulated cameras stand a little off the
    built-in rig, by --seed."""

    camera: str = "wrist"
    """Which camera of the rig. For one on the flange the board lies on the table, for others the hand holds it."""

    rig: Given[Path] = None
    """The facts of the machine, a TOML file. Default: the rig that the simulation assumes."""

    board: BoardSpec = field(default_factory=BoardSpec)
    """The printed board. Measure its squares."""

    board_at: tuple[float, float] = (0.48, 0.0)
    """Roughly where the middle of a board on the table is: x and y in the world, m."""

    poses: int = 24
    """How many good pictures to take."""

    most_tilt: float = 45.0
    """Largest angle at which the board is looked at, 10 to 60 degrees. Large tilts are what determines the pose."""

    views: Given[Path] = None
    """Use the pictures in this folder, of an earlier run, and move nothing."""

    out: Given[Path] = None
    """Folder of pictures and overlays. Default: runs/DATE-calibrate-CAMERA."""

    seed: int = 0
    """Of the proposed poses, and of the simulated machine's errors."""


@dataclass(frozen=True, kw_only=True)
class IntrinsicsConfig(LookConfig):
    """Compare the camera matrix in the rig file with what views of the board say."""

    write: Given[Path] = None
    """Write the camera matrix found into this rig file. Default: only report."""


@dataclass(frozen=True, kw_only=True)
class HandEyeConfig(LookConfig):
    """Find out where a camera is, and write it into a rig file."""

    write: Given[Path] = None
    """The rig file to write. Default: the file given by --rig, else rig.toml."""


@dataclass(frozen=True, kw_only=True)
class CheckConfig(LookConfig):
    """Judge the calibration in a rig file by fresh pictures, and write the verdict and date into it."""

    poses: int = 8
    """How many good pictures to take."""

    live: bool = False
    """No board: draw the simulated scene over the picture of every camera, as PNG and for Rerun."""


LEAST_POSES = {IntrinsicsConfig: 8, HandEyeConfig: 8, CheckConfig: 4}
"""Views with which each of them can do anything."""


@dataclass(frozen=True, kw_only=True)
class NoiseConfig:
    """Measure how noisy a camera is, over an empty table, so that simulation imitates it."""

    backend: Literal["sim", "ur7e"] = "sim"
    """The robot and cameras to use; ur7e is the real or emulated one of --rig."""

    camera: str = "wrist"
    """Which camera of the rig."""

    rig: Given[Path] = None
    """The facts of the machine, a TOML file. Default: the rig that the simulation assumes."""

    frames: int = 12
    """Pictures at each place; the camera and the scene stand still."""

    write: Given[Path] = None
    """Write the noise found into this rig file. Default: only report."""

    seed: int = 0
    """Of the simulated machine."""


@dataclass(frozen=True, kw_only=True)
class HuesConfig:
    """Learn the colours of the things that stand alone on the table, left to right as the robot sees them."""

    names: tuple[str, ...]
    """What they are called, from the robot's left to its right, such as b0 b1 b2."""

    backend: Literal["sim", "ur7e"] = "sim"
    """The robot and cameras to use; ur7e is the real or emulated one of --rig."""

    rig: Given[Path] = None
    """The facts of the machine, a TOML file. Default: the rig that the simulation assumes."""

    write: Given[Path] = None
    """Write the hues into this rig file, under [hues]. Default: only report."""

    seed: int = 0
    """Of the simulated machine, and of the colours of what stands before it."""


def check_target(target: Path, rig: Path | None) -> None:
    """Refuse to replace what is no rig file, or a rig file by one that was made from the built-in rig.

    Raises:
        ConfigError: it is one of these, or cannot be written.
        DiskError: there is no room for it.
    """
    packaged = packaged_rig(EMULATED)
    if packaged is not None and target.resolve() == packaged.resolve():
        raise ConfigError(f"{target} is the rig file that comes with this package", "give --write rig.toml")
    check_output(target, RIG, option="--rig" if target == rig else "--write")
    if rig is None and target.exists():
        raise ConfigError(
            f"{target} exists; it would be replaced by one that is made from the built-in rig",
            f"give --rig {target} to calibrate that one further, or --write another FILE.toml",
        )


def check_backend(backend: str, rig: Path | None) -> None:
    """Raises ConfigError where a real or emulated robot is meant and none is named."""
    if backend == "ur7e" and rig is None:
        raise ConfigError("--backend ur7e needs the rig file of the machine", "give --rig FILE.toml, or --rig emulated")


def check_noise(config: NoiseConfig) -> None:
    """Refuse before anything is loaded or moved. Raises ConfigError."""
    check_backend(config.backend, config.rig)
    check_range("--frames", config.frames, 5, 100, "12 is good")
    check_seed(config.seed)


def check_board(config: BoardConfig) -> None:
    """Refuse before anything is drawn. Raises ConfigError."""
    check_range("--dpi", config.dpi, 50, 2400, "600 is good")


def check_hues(config: HuesConfig) -> None:
    """Refuse before anything is loaded or moved. Raises ConfigError."""
    check_backend(config.backend, config.rig)
    if not 1 <= len(config.names) <= MOST_THINGS:
        raise ConfigError(f"{len(config.names)} names; allowed: 1 to {MOST_THINGS}", "give --names b0 b1 b2")
    for name in config.names:
        if not NAME.fullmatch(name):
            raise ConfigError(f"--names has {name!r}, which is no name for a thing", "use letters, digits, _ and -")
    if len(set(config.names)) != len(config.names):
        raise ConfigError(f"--names {' '.join(config.names)} has a name twice", "each thing needs a name of its own")
    check_seed(config.seed)


def check_look(config: LookConfig) -> None:
    """Refuse before anything is loaded or moved. Raises ConfigError."""
    check_backend(config.backend, config.rig)
    check_range("--poses", config.poses, LEAST_POSES[type(config)], MOST_POSES, "20 to 30 are good")
    # Views less tilted than that determine neither the pose nor the camera matrix.
    check_range("--most-tilt", config.most_tilt, 10.0, 60.0, "in degrees; 45 is good")
    check_seed(config.seed)
    if not all(abs(v) <= 2.0 for v in config.board_at):
        raise ConfigError(f"--board-at is {config.board_at[0]:g} {config.board_at[1]:g} m, out of reach", "in metres")
