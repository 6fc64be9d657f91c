"""What `resync-robot calibrate noise` does: pictures of an empty table, and what they say about the camera."""

from __future__ import annotations

from dataclasses import asdict

from resync_robot.calibrating.machine import open_machine
from resync_robot.calibrating.settings import NoiseConfig, check_target
from resync_robot.calibration.depth_noise import fit_noise
from resync_robot.calibration.rig_file import update_rig
from resync_robot.console import say
from resync_robot.core.rig import load_rig
from resync_robot.core.world import CameraFrame
from resync_robot.hardware.joint_moves import travel
from resync_robot.hardware.stream import Stream
from resync_robot.perception.scan import Scan
from resync_robot.sim_training.scenes.calibration import Bench

PLACES = ((0.42, -0.12), (0.42, 0.12), (0.55, 0.0))
"""(x, y) on the table, m, that a camera on the flange looks at."""
CLEAR = "Clear the table where the camera looks."


def measure_noise(config: NoiseConfig) -> int:
    """Take pictures of the empty table, fit, and write `[cameras.noise]` where a file is named.

    Raises:
        ResyncError: bad input, or pictures that tell nothing.
    """
    rig = load_rig(config.rig)
    camera = rig.camera(config.camera)
    if config.write is not None:
        check_target(config.write, config.rig)
    # In simulation this very camera: what the simulation imitates of it is what should be found again.
    with open_machine(config.backend, rig, rig, Bench(config.seed), [camera], config.seed, 0.0, CLEAR) as machine:
        device = machine.cameras[camera.name]
        stills: list[list[CameraFrame]] = []
        if camera.mount == "world":
            stills.append([device.capture() for _ in range(config.frames)])
        else:
            stream = Stream(machine.robot, rig)
            scan = Scan(rig, camera=camera.name)
            for place in PLACES:
                for q in scan.towards(place, count=1):
                    travel(stream, q)
                    stills.append([device.capture() for _ in range(config.frames)])
    found = fit_noise(camera, stills)
    before = asdict(camera.noise)
    for name, value in asdict(found.noise).items():
        note = "" if value != before[name] else "   (not told by a plane)"
        say(f"  {name:22s} rig {before[name]:8.4f}   found {value:8.4f}{note}")
    say(
        f"Camera '{camera.name}': {len(stills)} places, {config.frames} pictures each; the table fills "
        f"{100 * found.flat:.0f} % of them and spans {found.span_px:.1f} px of disparity."
    )
    if config.write is not None:
        update_rig(config.rig, config.write, camera.name, {}, noise=found.noise)
        say(f"Written: {config.write}. Simulation imitates this camera from now on (--rig {config.write}).")
    return 0
