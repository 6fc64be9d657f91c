"""The layout for Foxglove shows what a recording holds, and every panel of it has its place."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from resync_robot.core.rig import load_rig
from resync_robot.core.robot_description import JOINTS
from tests.core.test_ros_recording import read, record

LAYOUT = json.loads((Path(__file__).parents[1] / "docs" / "foxglove-layout.json").read_text(encoding="utf-8"))
PANELS: dict[str, Any] = LAYOUT["configById"]


def placed(part: Any) -> Iterator[str]:
    if isinstance(part, str):
        yield part
        return
    assert part["direction"] in ("row", "column") and 0 < part["splitPercentage"] < 100
    for side in ("first", "second"):
        yield from placed(part[side])


def test_every_panel_has_one_place() -> None:
    assert sorted(placed(LAYOUT["layout"])) == sorted(PANELS)
    assert {name.split("!")[0] for name in PANELS} == {"3D", "Image", "Plot", "RosOut", "RawMessages"}


def test_what_it_shows_is_recorded(tmp_path: Path) -> None:
    record(tmp_path / "e.mcap")
    bag = read(tmp_path / "e.mcap")
    scene = PANELS["3D!scene"]
    topics = [*scene["topics"], *(layer["topic"] for layer in scene["layers"].values() if "topic" in layer)]
    seen = {camera.name for camera in load_rig().cameras}
    for name in seen:
        topics += PANELS[f"Image!{name}"]["imageMode"].values()
    paths = [path["value"] for name in PANELS if name.startswith("Plot!") for path in PANELS[name]["paths"]]
    paths += [panel["topicPath"] for name, panel in PANELS.items() if name.startswith("RawMessages!")]
    topics += [PANELS["RosOut!log"]["topicToRender"], *(path.split(".")[0] for path in paths)]
    assert set(topics) <= bag.keys()
    for path in paths:
        topic, *steps = re.split(r"[.\[]", path)
        value = bag[topic][-1][1]
        for step in steps:
            value = value[int(step[:-1])] if step.endswith("]") else getattr(value, step)
        assert isinstance(value, float | str), path
    fingers = {path["value"] for path in PANELS["Plot!fingers"]["paths"]}
    assert {f"/joint_states.position[{JOINTS.index('left_finger_joint')}]"} < fingers


@pytest.mark.parametrize("name", ["grid", "robot"])
def test_layers_name_themselves(name: str) -> None:
    layer = PANELS["3D!scene"]["layers"][name]
    assert layer["instanceId"] == name and layer["layerId"] in ("foxglove.Grid", "foxglove.Urdf")
