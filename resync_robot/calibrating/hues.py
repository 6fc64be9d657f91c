"""What `resync-robot calibrate hues` does: a scan of things that stand in a row, and the colours that they have."""

from __future__ import annotations

from resync_robot.calibrating.machine import open_machine
from resync_robot.calibrating.settings import HuesConfig, check_target
from resync_robot.calibration.rig_file import update_hues
from resync_robot.console import say
from resync_robot.core.rig import load_rig
from resync_robot.hardware.joint_moves import travel
from resync_robot.hardware.stream import Stream
from resync_robot.perception.hues import find_hues, name_hues
from resync_robot.perception.objects import catalogue_of, check_colours
from resync_robot.perception.scan import Scan
from resync_robot.sim_training.scenes.calibration import Bench

WRIST = "wrist"
"""The camera that scans."""


def measure_hues(config: HuesConfig) -> int:
    """Scan, read off the hues, and write `[hues]` where a file is named.

    Raises:
        ResyncError: bad input, or things whose colours cannot be told.
    """
    rig = load_rig(config.rig)
    if config.write is not None:
        check_target(config.write, config.rig)
    scan, catalogue = Scan(rig, camera=WRIST), catalogue_of(rig)
    # A deployment must be able to use the names; their colours, that are measured now, all differ here.
    check_colours(rig, {name: (i + 0.5) / len(config.names) for i, name in enumerate(config.names)})
    bench, words = (
        Bench(config.seed, config.names),
        f"Stand these, left to right, on the bare table: {', '.join(config.names)}.",
    )
    with open_machine(config.backend, rig, rig, bench, [rig.camera(WRIST)], config.seed, 0.0, words) as machine:
        stream = Stream(machine.robot, rig)
        frames = scan(lambda q: travel(stream, q), machine.cameras[WRIST].capture)
    found = find_hues(frames, rig, catalogue)
    hues = name_hues(config.names, found, catalogue)
    for name, seen in zip(config.names, found, strict=True):
        x, y = seen.place
        known = f"   rig {rig.hues[name]:.3f}" if name in rig.hues else ""
        say(f"  {name:12s} hue {hues[name]:.3f}, within {seen.spread:.3f}, at ({x:.2f}, {y:.2f}) m{known}")
    if config.write is not None:
        update_hues(config.rig, config.write, hues)
        say(f"Written: {config.write}. Deployments know these things by their colours now (--rig {config.write}).")
    return 0
