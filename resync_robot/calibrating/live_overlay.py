"""What `resync-robot calibrate check --live` does: the simulated scene over what every camera sees."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from resync_robot.calibrating.machine import open_machine, picture_folder
from resync_robot.calibrating.settings import CheckConfig
from resync_robot.calibration.overlay import SEARCH_PX, compare_outline, draw_scene, save_picture
from resync_robot.console import say
from resync_robot.core.rig import load_rig
from resync_robot.sim_training.scenes.calibration import Bench, CalibrationWorld, empty_task


def live(config: CheckConfig, save_pictures: Callable[[Mapping[str, np.ndarray], Path], None]) -> int:
    """Draw the scene as the rig file has it over what every camera sees, and measure the robot's outline.

    Args:
        save_pictures: writes pictures by name as one file for Rerun.

    Returns:
        0 where the outline of every camera that sees the robot is within the rig's limit, rounded up to 2 px, else 3.
    """
    rig = load_rig(config.rig)
    folder = picture_folder(config)
    limit = max(2.0, rig.calibration_limits.max_px)
    pictures, bad = {}, False
    belief = CalibrationWorld(empty_task(rig, config.seed), rig, None)
    bench = Bench(config.seed)
    with open_machine(config.backend, rig, load_rig(None), bench, rig.cameras, config.seed * 10) as machine:
        measured = machine.robot.state()
        seen = {name: camera.capture().colour for name, camera in machine.cameras.items()}
    belief.built.set_configuration(measured.q, measured.opening)
    for camera in rig.cameras:
        colour = seen[camera.name]
        simulated = belief.render(camera.name).colour
        mask = belief.robot_mask(camera.name)
        outline = compare_outline(colour, mask)
        if outline is None:
            text = "the robot is not in the picture"
        else:
            wrong = outline.error_px > limit
            bad |= wrong
            dx, dy = outline.shift_px
            text = f"robot off by {dx:+.0f}, {dy:+.0f} px, outline within {outline.misfit_px:.1f} px"
            if outline.at_the_limit:
                text = f"robot off by {SEARCH_PX} px or more"
            text += f"; allowed: {limit:g} px" if wrong else ""
        say(f"Camera '{camera.name}': {text}.")
        pictures[camera.name] = draw_scene(colour, simulated, mask, f"{camera.name}: {text}")
        save_picture(folder / f"live-{camera.name}.png", pictures[camera.name])
    save_pictures(pictures, folder / "live.rrd")
    say(f"Left the camera, right the simulation over it: {folder}/live-*.png, and in Rerun: rerun {folder}/live.rrd")
    if bad:
        say("Where it is off the camera was moved: resync-robot calibrate hand-eye --camera NAME.")
    return 3 if bad else 0
