"""Every number of a rig file has a range: another unit leaves it, and is named; what a lab may write is read."""

import math
import re
import tomllib
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import asdict, fields
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from resync_robot.core.calibration_record import CalibrationLimits, CalibrationRecord
from resync_robot.core.errors import ConfigError
from resync_robot.core.machines import ARMS, GRIPPERS
from resync_robot.core.ranges import RANGES, Range, read_number, require
from resync_robot.core.rig import ArmRig, CameraRig, ControllerRig, GripperRig, Rig, load_rig
from resync_robot.core.sensor_noise import SensorNoise
from tests.emulators import RIG_FILE, sister, sister_text

Place = tuple[str | int, ...]


def whole_file() -> dict[str, Any]:
    """A rig that states everything that a file may state."""
    data = tomllib.loads(RIG_FILE.read_text())
    data["cameras"][0]["noise"] = asdict(SensorNoise())
    data["cameras"][0]["calibration"] = {
        "calibrated": "2026-01-01", "checked": "2026-03-01", "method": "eye-in-hand", "views": 20, "left_out": 2,
        "held_out_mm": 0.5, "held_out_deg": 0.2, "held_out_px": 0.6,
    }  # fmt: skip
    data["calibration_limits"] = asdict(CalibrationLimits())
    data["hues"] = {"b0": 0.05, "b1": 0.6}
    return data


WHOLE = whole_file()


def written(data: dict[str, Any], title: str = "") -> str:
    """TOML of nested tables, their own values first."""
    own, below = [], []
    for name, value in data.items():
        path = f"{title}.{name}" if title else name
        if isinstance(value, dict):
            below.append(f"[{path}]\n{written(value, path)}")
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            below += [f"[[{path}]]\n{written(entry, path)}" for entry in value]
        else:
            shown = str(value).lower() if isinstance(value, bool) else repr(value).replace("'", '"')
            own.append(f"{name} = {shown}")
    return "\n".join([*own, *below])


def numbers(value: Any, place: Place = ()) -> Iterator[Place]:
    if isinstance(value, dict):
        for name, below in value.items():
            yield from numbers(below, (*place, name))
    elif isinstance(value, list):
        for i, below in enumerate(value):
            yield from numbers(below, (*place, i))
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield place


def at(data: Any, place: Place) -> Any:
    for step in place:
        data = data[step]
    return data


def put(data: Any, place: Place, value: Any) -> None:
    at(data, place[:-1])[place[-1]] = value


def read(data: dict[str, Any]) -> Rig:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "rig.toml"
        path.write_text(written(data), encoding="utf-8")
        return load_rig(path)


def field(place: Place) -> str:
    names = [step for step in place if isinstance(step, str)]
    return "hues" if names[0] == "hues" else ".".join(names)


def refused(place: Place, value: Any, data: dict[str, Any] = WHOLE) -> str:
    changed = deepcopy(data)
    put(changed, place, value)
    with pytest.raises(ConfigError) as error:
        read(changed)
    return str(error.value)


POSE = ("world_T_base", "pose")


def is_turn(place: Place) -> bool:
    """Whether the number belongs to a quaternion."""
    return len(place) > 1 and place[-2] in POSE and int(place[-1]) > 2


def leaves(place: Place, factor: float) -> bool:
    """Whether the number, multiplied, is outside of what its field may be."""
    if place[:2] == ("controller", "gripper_table") and place[-1] == 0:
        return at(WHOLE, place) * factor > 255
    allowed = RANGES[field(place)]
    value = at(WHOLE, place)
    return value != 0 and not allowed.low <= value * factor <= allowed.high


PLACES = [place for place in numbers(WHOLE) if not is_turn(place)]


def test_every_number_of_a_file_has_a_range() -> None:
    """A field that is added without one is text, and refuses its number; here it is named."""
    kinds = {"arm": ArmRig, "controller": ControllerRig, "gripper": GripperRig, "cameras": CameraRig}
    numeric = {
        f"{table}.{f.name}" for table, kind in kinds.items() for f in fields(kind)
        if f.type in ("float", "int", "np.ndarray")
    }  # fmt: skip
    numeric |= {f"cameras.noise.{f.name}" for f in fields(SensorNoise)}
    numeric |= {f"calibration_limits.{f.name}" for f in fields(CalibrationLimits)}
    numeric |= {f"cameras.calibration.{f.name}" for f in fields(CalibrationRecord) if f.type in ("float", "int")}
    assert numeric | {"hues"} == set(RANGES)


@pytest.mark.parametrize("factor", [1000.0, 180 / math.pi], ids=["thousand", "degrees"])
def test_a_number_in_another_unit_is_refused_by_name(factor: float) -> None:
    outside = [place for place in PLACES if leaves(place, factor)]
    for place in outside:
        value = at(WHOLE, place) * factor
        message = refused(place, round(value) if isinstance(at(WHOLE, place), int) else value)
        name = next(step for step in reversed(place) if isinstance(step, str))
        assert name in message and str(place[0]) in message
    met = {field(place) for place in outside}
    if factor == 1000.0:
        # What is left over is a count, a share that happens to be small, or 0 here.
        assert {f for f in RANGES if f not in met} <= {
            "arm.world_T_base", "controller.force_limit", "cameras.calibration.views", "cameras.calibration.left_out",
            "cameras.noise.disparity_step_px",
        } | {f for f in RANGES if f.startswith("cameras.noise.")}  # fmt: skip
    else:
        assert met >= {f"arm.{name}" for name in ("home", "velocity_limit", "acceleration_limit", "jerk_limit")}
        assert "cameras.rotation_sigma" in met


@pytest.mark.parametrize(
    ("place", "value", "expected"),
    [
        (("arm", "velocity_limit"), [180.0] * 6, r"velocity_limit.*180 rad/s; allowed.*\n.*looks like degrees/s: 3.14"),
        (("arm", "acceleration_limit"), [687.0] * 6, r"acceleration_limit.*687 rad/s\^2.*\n.*degrees/s\^2: 12 rad"),
        (("arm", "home"), [-17.2, -97.9, 90.4, -82.5, -90.0, -107.2], r"home.*-17.2 rad.*\n.*degrees: -0.3 rad"),
        (("controller", "workspace_low"), [-200.0, -700.0, -20.0], r"workspace_low.*-200 m.*\n.*looks like mm: -0.2 m"),
        (("controller", "workspace_high"), [900.0, 700.0, 900.0], r"workspace_high.*900 m.*\n.*looks like mm: 0.9 m"),
        (("controller", "payload_centre"), [0, 0, 60.0], r"payload_centre, number 3 of 3, is 60 m.*\n.*mm: 0.06 m"),
        (("controller", "gripper_table"), [[3, 140.0], [230, 0.0]], r"gripper_table.*140 m.*\n.*mm: 0.14 m"),
        (("gripper", "max_opening"), 140, r"max_opening is 140 m; allowed: 0.01 to 0.2 m\n.*140 looks like mm: 0.14 m"),
        (("arm", "world_T_base", 0), 800.0, r"world_T_base.*800 m; allowed: -5 to 5 m\n.*looks like mm: 0.8 m"),
        (("controller", "payload"), 1200.0, r"payload is 1200 kg.*\n.*looks like g: 1.2 kg"),
        (("controller", "payload"), 9.0, r"payload of a UR7e is 9 kg; allowed: 0 to 7.5 kg$"),
        (("controller", "gripper_force"), 20.0, r"gripper_force is 20; allowed: 0 to 1\n.*looks like percent: 0.2"),
        (("controller", "freshness"), 50.0, r"freshness is 50 s.*\n.*looks like ms: 0.05 s"),
        (("arm", "velocity_limit", 1), 3.2, r"velocity_limit of the UR7e's shoulder_lift_joint is 3.2 .* 3.142 rad/s$"),
        (("arm", "home", 2), 3.3, r"home of the UR7e's elbow_joint is 3.3 rad; allowed: -3.142 to 3.142 rad$"),
        (("gripper", "max_force"), 200.0, r"max_force of a 2F-140 is 200 N; allowed: 1 to 125 N$"),
        (("gripper", "max_opening"), 0.19, r"max_opening of a 2F-140 is 0.19 m; allowed: 0.01 to 0.154 m$"),
        (("arm", "model"), "ur5", r"\[arm\] model is 'ur5'\n.*allowed: .*ur7e"),
        (("gripper", "model"), "hand-e", r"\[gripper\] model is 'hand-e'\n.*allowed: .*2f-140"),
        (("cameras", 1, "name"), "wrist", "name 'wrist' is given twice"),
        (("cameras", 2, "serial"), "emulated-front", "serial 'emulated-front' is given twice"),
        (("cameras", 0, "name"), "", r"cameras.0\] name is empty"),
        (("cameras", 0, "cx"), 500.0, "cx of a picture 424 px wide is 500 px; allowed: 0 to 424 px"),
        (("cameras", 0, "cy"), 300.0, "cy of a picture 240 px high is 300 px; allowed: 0 to 240 px"),
        (("cameras", 0, "pose", 0), 0.9, r"pose on the flange, number 1 of 3, is 0.9 m; allowed: -0.5 to 0.5 m$"),
        (("controller", "workspace_low", 1), 0.8, "workspace_low is 0.8 m along y, and workspace_high 0.7 m"),
        (("controller", "workspace_high", 2), 0.05, r"at \[arm\] home the tip is at .* outside of"),
        (("hues", "b0"), 120.0, r"b0 is 120 turns.*\n.*looks like degrees: 0.333"),
    ],
)  # fmt: skip
def test_what_labs_write_by_mistake(place: Place, value: Any, expected: str) -> None:
    assert re.search(expected, refused(place, value)), refused(place, value)


def test_a_real_camera_needs_its_serial_number() -> None:
    changed = deepcopy(WHOLE)
    changed["cameras"][1]["serial"] = changed["cameras"][2]["serial"] = ""
    assert read(changed).camera("front").serial == "", "an emulated one is not looked up by it"
    changed["controller"]["emulated"] = False
    with pytest.raises(ConfigError, match="serial of 'front' is empty"):
        read(changed)


@pytest.mark.parametrize("model", ARMS)
def test_a_file_of_a_sister_arm_is_read_and_keeps_its_own_limits(model: str) -> None:
    rig, data = sister(model), tomllib.loads(sister_text(model))
    assert rig.arm.facts is ARMS[model] and rig.gripper.facts is GRIPPERS["2f-85"]
    for place, value, named in (
        (("controller", "payload"), ARMS[model].payload + 0.1, "payload of a "),
        (("arm", "velocity_limit", 0), ARMS[model].speed[0] + 0.1, "velocity_limit of the "),
        (("arm", "home", 2), np.pi + 0.1, "home of the "),
    ):
        assert f"{named}{ARMS[model].title}" in refused(place, float(value), data)
    assert "max_opening of a 2F-85" in refused(("gripper", "max_opening"), 0.14, data)
    assert "gripper_table of a 2F-85" in refused(("controller", "gripper_table"), [[3, 0.14], [230, 0.0]], data)


@given(st.data())
def test_what_a_lab_may_write_is_read(data: st.DataObject) -> None:
    """Every number a tenth smaller or larger, where the machine bears that."""
    changed = deepcopy(WHOLE)
    for place in PLACES:
        value = at(WHOLE, place)
        if isinstance(value, int) or place[:2] in (("arm", "home"), ("arm", "world_T_base")):
            continue
        most = 1.0 if place[1] in ("velocity_limit", "freshness") else 1.1
        put(changed, place, value * data.draw(st.floats(0.9, most)))
    assert read(changed).arm.model == "ur7e"


@pytest.mark.parametrize("path", [RIG_FILE, files("resync_robot.core").joinpath("simulated_rig.toml")])
def test_the_shipped_files_are_read(path: Path) -> None:
    assert load_rig(path).arm.model == "ur7e"


@given(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6), st.floats(-1e7, 1e7), st.sampled_from(["m", "rad", "share", ""]))
def test_a_number_is_read_if_and_only_if_it_is_within(one: float, other: float, value: float, unit: str) -> None:
    allowed = Range(min(one, other), max(one, other), unit)
    if allowed.low <= value <= allowed.high:
        assert read_number(value, allowed, "here") == value
    else:
        with pytest.raises(ConfigError, match=r"here is .*; allowed: "):
            read_number(value, allowed, "here")


def test_another_unit_is_suggested_only_where_it_explains_the_number() -> None:
    for value in (0.55, 0.9, 600.0, np.nan):
        with pytest.raises(ConfigError) as error:
            require(value, Range(-0.5, 0.5, "m"), "here")
        assert error.value.fix == ""
    with pytest.raises(ConfigError, match=r"60 looks like mm: 0.06 m"):
        require(60.0, Range(-0.5, 0.5, "m"), "here")
