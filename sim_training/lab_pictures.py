"""The process that renders an emulated lab's cameras: lines of JSON in, a line of JSON and bytes out."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from sapien import Pose

from resync_robot.core import spatial
from resync_robot.core.errors import ResyncError
from resync_robot.core.rig import Rig, load_rig
from sim_training.domains import find_domain, world_task
from sim_training.sensor import NoisySensor
from sim_training.world import SimWorld

_AXES = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]])


class Pictures:
    """Renders one scene after the other, each camera a little off where the rig has it, as a calibrated one is."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._world: SimWorld | None = None

    def answer(self, request: dict[str, Any]) -> tuple[dict[str, Any], bytes]:
        if "scene" in request:
            s = request["scene"]
            task = world_task(find_domain(s["domain"]), s["scenario"], s["seed"], s["episode"])
            self._world = SimWorld(task, self._rig, rendered=True)
            self._rng = np.random.default_rng(task.seed)
            self._sensors = {c.name: NoisySensor(task.seed * 10 + i, c) for i, c in enumerate(self._rig.cameras)}
            self._moved: set[str] = set()
            return {}, b""
        return self._picture(request)

    def _picture(self, request: dict[str, Any]) -> tuple[dict[str, Any], bytes]:
        world = self._world
        if world is None:
            raise ResyncError("no scene has been laid out yet")
        world.built.set_configuration(np.array(request["q"]), float(request["opening"]))
        for obj, body in world.built.rigid.items():
            if body is not None and obj.name in request["objects"]:
                features = np.array(request["objects"][obj.name])
                body.entity.set_pose(Pose(features[:3], features[3:7]))
        name = str(request["camera"])
        self._misplace(name, world)
        frame = self._sensors[name].apply(world.render(name))
        height, width = frame.depth.shape
        body_ = frame.colour.tobytes() + frame.depth.astype("<u2").tobytes()
        return {"height": height, "width": width}, body_

    def _misplace(self, name: str, world: SimWorld) -> None:
        """Move the camera off its calibrated pose: one on the flange anew with every view, another once."""
        rig = self._rig.camera(name)
        if rig.mount == "world" and name in self._moved:
            return
        self._moved.add(name)
        error = spatial.transform(
            spatial.rotation_from_vector(self._rng.normal(0.0, rig.rotation_sigma, 3)),
            self._rng.normal(0.0, rig.position_sigma, 3),
        )
        camera = world.built.cameras[name]
        if rig.mount == "flange":
            camera.local_pose = Pose(rig.pose @ error @ _AXES)
        else:
            camera.entity.set_pose(Pose(rig.pose @ error @ _AXES))


def main() -> None:
    pictures = Pictures(load_rig(Path(sys.argv[1])))
    output = sys.stdout.buffer
    # Whatever a library prints must not get between the bytes.
    sys.stdout = sys.stderr
    for line in sys.stdin:
        try:
            head, body = pictures.answer(json.loads(line))
        except (ResyncError, KeyError, ValueError) as error:
            head, body = {"error": getattr(error, "what", str(error))}, b""
        output.write(json.dumps(head | {"bytes": len(body)}).encode() + b"\n" + body)
        output.flush()


if __name__ == "__main__":
    main()
