"""The process that renders an emulated lab's cameras: lines of JSON in, a line of JSON and bytes out."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from resync_robot.core import spatial
from resync_robot.core.errors import ResyncError
from resync_robot.core.rig import Rig, load_rig
from resync_robot.core.task import Task
from resync_robot.core.world import Window
from resync_robot.sim_training.domains import find_domain, world_task
from resync_robot.sim_training.physics.camera_noise import NoisySensor, Tone
from resync_robot.sim_training.physics.motion_blur import camera_motion
from resync_robot.sim_training.physics.scene import place_camera
from resync_robot.sim_training.physics.world import SimWorld
from resync_robot.sim_training.scenes.calibration import Bench, CalibrationWorld, displaced

MAX_WINDOW_PX = 1024


class Pictures:
    """Renders one scene after the other, each camera a little off where the rig has it, as a calibrated one is."""

    def __init__(self, rig: Rig) -> None:
        self._rig, self._real, self._calibrated = rig, rig, True
        self._world: SimWorld | None = None

    def answer(self, request: dict[str, Any]) -> tuple[dict[str, Any], bytes]:
        if "scene" in request:
            task, self._world = self._lay_out(request["scene"])
            self._rng = np.random.default_rng(task.seed)
            tone = Tone.of(task.physics)
            # Of a bench, a calibration measures how pictures differ, and asks for no film.
            steady = self._calibrated
            self._sensors = {
                c.name: NoisySensor(task.seed * 10 + i, c, tone=tone, steady=steady)
                for i, c in enumerate(self._rig.cameras)
            }
            self._errors: dict[str, np.ndarray] = {}
            # The first picture of a process takes half a minute where the processor draws: no robot shall wait for it.
            self._world.render(self._rig.cameras[0].name)
            return {}, b""
        return self._picture(request)

    def _lay_out(self, scene: dict[str, Any]) -> tuple[Task, SimWorld]:
        if "bench" in scene:
            bench = Bench.from_json(scene["bench"])
            # What a calibration is to find out, instead of what one leaves.
            self._real, self._calibrated = displaced(self._rig, bench.seed), False
            task = bench.task(self._real)
            return task, CalibrationWorld(task, self._real, bench.poster)
        self._real, self._calibrated = self._rig, True
        task = world_task(find_domain(scene["domain"]), scene["scenario"], scene["seed"], scene["episode"])
        return task, SimWorld(task, self._rig, rendered=True)

    def _picture(self, request: dict[str, Any]) -> tuple[dict[str, Any], bytes]:
        """A whole picture, the colours of a window of one, or those of a whole one for a film."""
        world = self._world
        if world is None:
            raise ResyncError("no scene has been laid out yet")
        world.built.set_configuration(np.array(request["q"]), float(request["opening"]))
        for obj in world.movable:
            if obj.name in request["objects"]:
                world.place(obj, np.array(request["objects"][obj.name]))
        name, time = str(request["camera"]), float(request.get("time", 0.0))
        if request.get("film"):
            colour = self._sensors[name].glimpse(world.render_colour(name).colour, time)
            return {"height": colour.shape[0], "width": colour.shape[1]}, colour.tobytes()
        error, sensor = self._error(name), self._sensors[name]
        if "window" in request:
            window, size = Window(*map(float, request["window"])), int(request["size"])
            if not 1 <= size <= MAX_WINDOW_PX:
                raise ResyncError(f"a window of {size} pixels; allowed: 1 to {MAX_WINDOW_PX}")
            colour = sensor.colour(world.render_window(name, window, size, error).colour, time)
            return {"height": size, "width": size}, colour.tobytes()
        rig = self._real.camera(name)
        place_camera(world.built.cameras[name], rig, rig.pose @ error)
        motion = camera_motion(self._rig, name, np.array(request["q"]), np.array(request.get("qd", np.zeros(6))))
        frame = sensor.apply(replace(world.render(name), time=time), motion)
        height, width = frame.depth.shape
        body_ = frame.colour.tobytes() + frame.depth.astype("<u2").tobytes()
        return {"height": height, "width": width}, body_

    def _error(self, name: str) -> np.ndarray:
        """Where a camera stands beside its calibrated pose: on the flange anew with every view, else once."""
        if not self._calibrated:
            return np.eye(4)
        rig = self._rig.camera(name)
        if rig.mount == "flange" or name not in self._errors:
            self._errors[name] = spatial.transform(
                spatial.rotation_from_vector(self._rng.normal(0.0, rig.rotation_sigma, 3)),
                self._rng.normal(0.0, rig.position_sigma, 3),
            )
        return self._errors[name]


def main() -> None:
    pictures = Pictures(load_rig(Path(sys.argv[1])))
    output = sys.stdout.buffer
    # Whatever a library prints must not get between the bytes.
    sys.stdout = sys.stderr
    for line in sys.stdin:
        try:
            head, body = pictures.answer(json.loads(line))
        except (ResyncError, KeyError, ValueError, TypeError) as error:
            head, body = {"error": getattr(error, "what", str(error))}, b""
        output.write(json.dumps(head | {"bytes": len(body)}).encode() + b"\n" + body)
        output.flush()


if __name__ == "__main__":
    main()
