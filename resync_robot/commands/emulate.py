"""A lab on loopback: the simulated robot behind the protocols of a real one, for `deploy --backend ur7e`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from resync_robot.core.errors import ConfigError
from resync_robot.given import Given, Several


@dataclass(frozen=True, kw_only=True)
class EmulateConfig:
    """Stand in for a UR7e with gripper and cameras, on loopback, until Ctrl-C."""

    rig: Given[Path] = None
    """Rig file of the emulated machine. Default: `emulated`, the one that comes with this package."""

    fault: Several[str] = ()
    """What goes wrong: NAME or NAME@SECONDS of running program (default 5), such as protective-stop@10."""

    seconds: Given[float] = None
    """End after so many seconds. Default: run until Ctrl-C."""


def emulate(config: EmulateConfig) -> int:
    """Serve the emulated lab.

    Raises:
        ResyncError: bad input, a port that is taken, or an address that is not loopback.
    """
    import time

    from resync_robot.console import say
    from resync_robot.core.files import EMULATED, packaged_rig
    from resync_robot.core.rig import load_rig
    from resync_robot.hardware.emulator.faults import FaultPlan, parse_fault
    from resync_robot.sim_training.emulated_lab.lab import Lab

    faults = FaultPlan([parse_fault(text) for text in config.fault])
    if config.seconds is not None and not config.seconds > 0:
        raise ConfigError(f"--seconds is {config.seconds}", "give a positive number")
    packaged = packaged_rig(EMULATED)
    path = config.rig or packaged or Path(EMULATED)
    rig = load_rig(path)
    with Lab(rig, path.resolve(), faults) as lab:
        say(f"A {rig.arm.model} with its gripper and {len(rig.cameras)} cameras stands at {lab.emulator.address}.")
        say(f"In another terminal:  resync-robot deploy --backend ur7e --rig {EMULATED if path == packaged else path}")
        begin = time.monotonic()
        shown = 0
        while config.seconds is None or time.monotonic() - begin < config.seconds:
            time.sleep(0.2)
            for when, name in faults.happened[shown:]:
                say(f"At {when:.1f} s: {name}.")
            shown = len(faults.happened)
    say(f"The emulated clock lost {lab.emulator.behind_s:.2f} s because this computer was too busy.")
    return 0
