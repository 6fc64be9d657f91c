"""The built-in rig loads; every field that is missing, unknown or of the wrong kind is refused by name."""

import tomllib
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from resync_robot.core import spatial
from resync_robot.core.errors import ConfigError, UnknownNameError
from resync_robot.core.rig import load_rig
from resync_robot.core.sensor_noise import SensorNoise
from tests.emulators import RIG_FILE

LONG = "0x1" + "0" * 5000
"""An integer that no float holds, and that Python refuses to write out in tens."""
BUILT_IN = files("resync_robot.core").joinpath("simulated_rig.toml").read_text()
CONNECTED = RIG_FILE.read_text()


def places() -> list[tuple[str, str]]:
    """(section, field) of everything that a rig with a controller states; of the cameras the second."""
    data = tomllib.loads(CONNECTED)
    top = [("", name) for name, value in data.items() if isinstance(value, str)]
    tables = [(section, name) for section in ("arm", "gripper", "controller") for name in data[section]]
    return [*top, *tables, *(("cameras", name) for name in data["cameras"][1])]


def edit(section: str, name: str, replacement: str | None) -> str:
    """A rig with a controller, one line of it replaced, or left out."""
    header = {"": "", "cameras": "[[cameras]]"}.get(section, f"[{section}]")
    lines, seen, wanted = CONNECTED.splitlines(), 0, 2 if section == "cameras" else 1
    current, done = "", False
    seen = 1 if header == "" else 0
    for i, line in enumerate(lines):
        if line.startswith("["):
            current = line.strip()
            seen += current == header
        elif current == header and seen == wanted and line.split("=")[0].strip() == name:
            lines[i], done = "" if replacement is None else f"{name} = {replacement}", True
    assert done, f"no line for {section} {name}"
    return "\n".join(lines)


def refused(text: str, tmp_path: Path) -> str:
    path = tmp_path / "rig.toml"
    path.write_text(text)
    with pytest.raises(ConfigError) as error:
        load_rig(path)
    assert str(path) in str(error.value)
    return str(error.value)


@pytest.mark.parametrize(("section", "name"), places())
def test_a_missing_field_is_named(section: str, name: str, tmp_path: Path) -> None:
    message = refused(edit(section, name, None), tmp_path)
    assert f"no field {name}" in message
    assert section in message


@pytest.mark.parametrize(("section", "name"), places())
@pytest.mark.parametrize("value", ["true", "[1.0, 2.0]", "{ a = 1 }", "nan", "inf", LONG])
def test_a_mistyped_field_is_named(section: str, name: str, value: str, tmp_path: Path) -> None:
    if value == "true" and name in ("emulated", "full_speed"):
        return
    message = refused(edit(section, name, value), tmp_path)
    assert f"{name} must be" in message
    assert section in message


@pytest.mark.parametrize("section", ["", "[arm]", "[gripper]", "[[cameras]]"])
def test_an_unknown_field_is_named_with_the_valid_ones(section: str, tmp_path: Path) -> None:
    text = f"colour = 1\n{BUILT_IN}" if not section else BUILT_IN.replace(section, f"{section}\ncolour = 1", 1)
    message = refused(text, tmp_path)
    assert "unknown field colour" in message
    assert "its fields are" in message


@pytest.mark.parametrize(
    ("section", "name", "value", "expected"),
    [
        ("cameras", "mount", '"ceiling"', "allowed: flange, world"),
        ("cameras", "pose", "[0, 0, 0, 1, 1, 0, 0]", "quaternion has norm 1.414"),
        ("arm", "home", '[0, 0, 0, 0, 0, "0"]', "home must be 6 numbers"),
        ("arm", "home", "[0, 0, 0, 0, 0]", "home must be 6 numbers"),
        (
            "arm",
            "velocity_limit",
            "[1, 1, 1, 1, 1, 0]",
            "velocity_limit, number 6 of 6, is 0 rad/s; allowed: 0.01 to 6.283 rad/s",
        ),
        ("gripper", "max_force", "-1.0", "max_force is -1 N; allowed: 1 to 300 N"),
        ("cameras", "width", "0", "width is 0 px; allowed: 16 to 8192 px"),
        ("cameras", "height", "240.5", "height must be a whole number"),
        ("controller", "gripper_table", "[[3, 0.0], [230, 0.14]]", "openings in m that fall"),
        ("controller", "gripper_table", "[[3, 0.14], [300, 0.0]]", "255 at most"),
        ("controller", "gripper_force", "1.5", "gripper_force is 1.5; allowed: 0 to 1"),
        ("controller", "freshness", "2.0", "allowed: 0.02 to 0.5"),
        ("controller", "address", '"robot"', "give an IPv4 address"),
    ],
)
def test_a_value_outside_its_range_is_refused(
    section: str, name: str, value: str, expected: str, tmp_path: Path
) -> None:
    assert expected in refused(edit(section, name, value), tmp_path)


@pytest.mark.parametrize("section", ["arm", "gripper", "cameras"])
def test_a_missing_section_is_named(section: str, tmp_path: Path) -> None:
    kept = BUILT_IN.split("[arm]")[0]
    for part, following in (("arm", "gripper"), ("gripper", "cameras")):
        body = BUILT_IN.split(f"[{part}]")[1].split("[" + following if following != "cameras" else "[[cameras]]")[0]
        kept += f"[{part}]{body}" if part != section else ""
    kept += "" if section == "cameras" else BUILT_IN[BUILT_IN.index("[[cameras]]") :]
    assert section in refused(kept, tmp_path)


def test_noise_and_hues_are_read_where_they_are_given(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(f"{BUILT_IN}[cameras.noise]\ndisparity_sigma_px = 0.12\n[hues]\nb0 = 0.05\nb9 = 0.7\n")
    rig = load_rig(path)
    assert rig.camera("side").noise == SensorNoise(disparity_sigma_px=0.12)
    assert rig.camera("wrist").noise == SensorNoise()
    assert rig.hues == {"b0": 0.05, "b9": 0.7}
    assert load_rig().hues == {}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[cameras.noise]\nsharpness = 1.0", "unknown field sharpness"),
        ("[cameras.noise]\nripple_px = true", "ripple_px must be a number"),
        ("[cameras.noise]\nhole_share = 1.5", "hole_share is 1.5; allowed: 0 to 1"),
        ("[cameras.noise]\nbaseline = 0.0", "baseline is 0 m; allowed: 0.005 to 0.5 m"),
        ("[cameras.noise]\nflying_share = 0.8", "together at most 1"),
        ("[hues]\nb0 = 1.0", "a hue is from 0 up to"),
        ('[hues]\nb0 = "red"', "b0 must be a number"),
        ('[sam3]\ncheckpoint = "a"\nvocabulary = "b"', "[sam3.prompts] must name what to ask for"),
        ('[sam3]\ncheckpoint = 1\nvocabulary = "b"\nprompts = { b0 = "red block" }', "checkpoint must be text"),
        ('[sam3]\nvocabulary = "b"\nprompts = { b0 = "red block" }', "no field checkpoint"),
        ("[[hues]]\nb0 = 0.1", "[hues] must be a table"),
    ],
)
def test_bad_noise_and_hues_are_refused(text: str, expected: str, tmp_path: Path) -> None:
    assert expected in refused(BUILT_IN + text, tmp_path)


SCRAPS = (
    "[",
    "]",
    "=",
    '"',
    "nan",
    "-1",
    "1e999",
    "9" * 400,
    "0x" + "f" * 5000,
    "9" * 5000,
    "[cameras.noise]",
    "[hues]",
    "\n",
    "true",
    "{}",
    "#",
    "\x00",
    "ü",
)


@pytest.mark.slow
def test_ten_thousand_broken_files_are_refused_or_read(tmp_path: Path) -> None:
    """Cut, doubled, reversed or overwritten anywhere: an error of this program's own, or a rig, and nothing else."""
    rng, path, read = np.random.default_rng(0), tmp_path / "rig.toml", 0
    for _ in range(10_000):
        text = BUILT_IN
        for _ in range(int(rng.integers(1, 4))):
            a = int(rng.integers(0, len(text)))
            b = a + int(rng.integers(1, 200))
            part = text[a:b]
            text = text[:a] + ("", part * 2, rng.choice(SCRAPS), part[::-1])[rng.integers(4)] + text[b:]
        path.write_text(text)
        try:
            load_rig(path)
            read += 1
        except ConfigError:
            pass
    assert 0 < read < 8000


def test_what_is_no_toml_or_not_there_is_refused(tmp_path: Path) -> None:
    assert "no valid TOML" in refused("name = ", tmp_path)
    with pytest.raises(ConfigError, match="cannot read the rig file"):
        load_rig(tmp_path / "absent.toml")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match="cannot read the rig file"):
        load_rig(tmp_path / "binary.toml")


def test_the_built_in_rig_is_consistent() -> None:
    rig = load_rig()
    assert [c.name for c in rig.cameras] == ["wrist", "front", "side"]
    for pose in (rig.arm.world_T_base, rig.gripper.flange_T_tip, *(c.pose for c in rig.cameras)):
        np.testing.assert_allclose(spatial.inverse(pose) @ pose, np.eye(4), atol=1e-9)
    wrist = rig.camera("wrist")
    centre = wrist.intrinsics @ np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(centre, [wrist.cx, wrist.cy, 1.0])
    with pytest.raises(UnknownNameError, match=r"'back' in the built-in rig(.|\n)*front, side, wrist"):
        rig.camera("back")


def test_an_unknown_camera_names_the_rig_file(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(BUILT_IN)
    rig = load_rig(tmp_path / "mine.toml")
    with pytest.raises(UnknownNameError, match=rf"'back' in the rig file {tmp_path}/mine.toml"):
        rig.camera("back")


def test_the_hash_names_the_content(tmp_path: Path) -> None:
    same, other = tmp_path / "same.toml", tmp_path / "other.toml"
    same.write_text(BUILT_IN)
    other.write_text(edit("gripper", "max_force", "41.0"))
    assert load_rig(same).hash == load_rig().hash != load_rig(other).hash
