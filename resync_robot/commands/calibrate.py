"""Calibration from the command line: print a board, look at it, find out where the cameras are, check it later."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro

from resync_robot.calibrating.settings import (
    BoardConfig,
    CheckConfig,
    HandEyeConfig,
    HuesConfig,
    IntrinsicsConfig,
    NoiseConfig,
    check_board,
    check_hues,
    check_look,
    check_noise,
)


@dataclass(frozen=True, kw_only=True)
class CalibrateConfig:
    """Calibrate the cameras of a rig: board, intrinsics, hand-eye, check, noise, hues."""

    # By no name, --help calls options what they are and not "what options".
    what: Annotated[
        Annotated[BoardConfig, tyro.conf.subcommand("board")]
        | Annotated[IntrinsicsConfig, tyro.conf.subcommand("intrinsics")]
        | Annotated[HandEyeConfig, tyro.conf.subcommand("hand-eye")]
        | Annotated[CheckConfig, tyro.conf.subcommand("check")]
        | Annotated[NoiseConfig, tyro.conf.subcommand("noise")]
        | Annotated[HuesConfig, tyro.conf.subcommand("hues")],
        tyro.conf.arg(name=""),
    ]
    """What to do. Each has a --help of its own."""


def calibrate(config: CalibrateConfig) -> int:
    """Run one of the six.

    Returns:
        0, or 3 where a check finds the calibration worse than the rig's limits.

    Raises:
        ResyncError: bad input, or pictures from which nothing follows.
    """
    what = config.what
    if isinstance(what, BoardConfig):
        from resync_robot.calibration.board import write_board
        from resync_robot.console import say

        check_board(what)
        write_board(what.board, what.out, what.dpi)
        say(f"{what.out}: print at 100 %, glue it flat, measure the squares and give --board.square if they differ.")
        return 0
    if isinstance(what, NoiseConfig):
        check_noise(what)
        from resync_robot.calibrating.noise import measure_noise

        return measure_noise(what)
    if isinstance(what, HuesConfig):
        check_hues(what)
        from resync_robot.calibrating.hues import measure_hues

        return measure_hues(what)
    check_look(what)
    from resync_robot.calibrating import cameras

    if isinstance(what, IntrinsicsConfig):
        return cameras.intrinsics(what)
    if isinstance(what, HandEyeConfig):
        return cameras.hand_eye(what)
    if what.live:
        from resync_robot.calibrating.live_overlay import live
        from resync_robot.deployment.rerun_view.drawing import save_pictures

        return live(what, save_pictures)
    return cameras.check(what)
