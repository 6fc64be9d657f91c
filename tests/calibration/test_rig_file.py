"""A calibrated pose goes into a rig file, and nothing else of it changes."""

from __future__ import annotations

import errno
import os
import tempfile
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from resync_robot.calibration.rig_file import update_hues, update_rig
from resync_robot.core import spatial
from resync_robot.core.calibration_record import CalibrationRecord
from resync_robot.core.errors import ConfigError, DiskError
from resync_robot.core.rig import load_rig
from resync_robot.core.sensor_noise import SensorNoise
from tests.calibration.synthetic import jolt

BUILT_IN = files("resync_robot.core").joinpath("simulated_rig.toml").read_text()
RECORD = CalibrationRecord(
    calibrated="2026-01-31", checked="2026-02-01", method='eye-in-hand: "PARK"', views=20, left_out=2,
    held_out_mm=0.41, held_out_deg=0.12, held_out_px=0.3,
)  # fmt: skip
RECORD = replace(RECORD, method="eye-in-hand: PARK")


@given(st.integers(0, 10_000), st.sampled_from(["wrist", "front", "side"]))
def test_a_pose_is_read_back_and_all_else_stays(seed: int, camera: str) -> None:
    pose = jolt(np.random.default_rng(seed), 1.0, 0.08)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rig.toml"
        update_rig(None, path, camera, {"pose": pose, "position_sigma": 0.0004}, RECORD)
        rig, before = load_rig(path), load_rig()
        text = path.read_text()
    found = rig.camera(camera)
    np.testing.assert_allclose(found.pose, pose, atol=2e-6)
    assert found.position_sigma == 0.0004 and found.calibration == RECORD
    assert rig.calibration_limits == before.calibration_limits
    for other in (c for c in before.cameras if c.name != camera):
        same = rig.camera(other.name)
        np.testing.assert_array_equal(same.pose, other.pose)
        assert same.calibration is None and same.position_sigma == other.position_sigma
    changed = set(BUILT_IN.splitlines()) - set(text.splitlines())
    assert all(line.startswith(("pose", "position_sigma")) for line in changed), "comments stay"


def test_a_second_calibration_takes_the_place_of_the_first(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    update_rig(None, path, "wrist", {"pose": np.eye(4)}, RECORD)
    first = path.read_text()
    later = replace(RECORD, checked="2026-05-05")
    update_rig(path, path, "wrist", {}, later)
    assert load_rig(path).camera("wrist").calibration == later
    assert path.read_text().count("[cameras.calibration]") == 1
    assert (tmp_path / "rig.toml.bak").read_text() == first
    update_rig(path, path, "side", {"fx": 310.25}, None)
    assert load_rig(path).camera("side").fx == 310.25
    assert load_rig(path).camera("wrist").calibration == later
    assert (tmp_path / "rig.toml.bak").read_text() == first, "no copy is lost to a later one"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["rig.toml", "rig.toml.bak", "rig.toml.bak-2"]


def test_a_full_disk_changes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "rig.toml"
    update_rig(None, path, "wrist", {}, RECORD)
    before = path.read_bytes()

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    for writer in ("write_text", "write_bytes"):
        with monkeypatch.context() as m:
            m.setattr(Path, writer, full)
            with pytest.raises(DiskError, match="No space left"):
                update_rig(path, path, "wrist", {"pose": np.eye(4)}, RECORD)
        assert [p.name for p in tmp_path.iterdir()] == ["rig.toml"] and path.read_bytes() == before


def test_a_link_stays_one(tmp_path: Path) -> None:
    (tmp_path / "lab").mkdir()
    real, link = tmp_path / "lab" / "arm.toml", tmp_path / "rig.toml"
    real.write_text(BUILT_IN)
    link.symlink_to(real)
    update_rig(link, link, "wrist", {}, RECORD)
    assert link.is_symlink() and load_rig(real).camera("wrist").calibration == RECORD
    assert (tmp_path / "rig.toml.bak").read_text() == BUILT_IN


def test_a_comment_of_any_signs_stays(tmp_path: Path) -> None:
    """A mark at the beginning, and signs at which other programs break a line."""
    path = tmp_path / "rig.toml"
    path.write_bytes(("\ufeff# Prüfstand\u2028Süd\x85\n" + BUILT_IN).encode())
    update_rig(path, path, "wrist", {}, RECORD)
    assert path.read_text(encoding="utf-8").split("\n")[0] == "# Prüfstand\u2028Süd\x85"


def test_noise_and_calibration_live_beside_each_other(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    noise = SensorNoise(disparity_sigma_px=0.11, hole_share=0.02)
    update_rig(None, path, "front", {}, noise=noise)
    update_rig(path, path, "front", {"pose": np.eye(4)}, RECORD)
    update_rig(path, path, "front", {}, noise=replace(noise, ripple_px=0.05))
    update_rig(path, path, "wrist", {}, RECORD)
    found = load_rig(path).camera("front")
    assert found.calibration == RECORD
    assert found.noise == replace(noise, ripple_px=0.05)
    assert path.read_text().count("[cameras.noise]") == 1
    assert load_rig(path).camera("side").noise == SensorNoise()


@pytest.mark.parametrize(
    "text",
    [
        BUILT_IN.replace('name = "wrist"', '"name" = "wrist"'),
        BUILT_IN.replace("pose = [0.11,", '"pose" = [0.11,'),
        BUILT_IN.replace("pose = [0.11, 0.0,", "pose = [0.11,\n  0.0,"),
    ],
    ids=["quoted name", "quoted field", "vector over two lines"],
)
def test_a_file_written_in_an_unusual_way_is_refused_and_left_as_it_is(text: str, tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(text)
    load_rig(path)
    with pytest.raises(ConfigError):
        update_rig(path, path, "wrist", {"pose": spatial.transform(None, np.ones(3))}, RECORD)
    assert path.read_text() == text
    assert [p.name for p in tmp_path.iterdir()] == ["rig.toml"]


def test_a_place_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match="cannot write"):
        update_rig(None, tmp_path / "file" / "rig.toml", "wrist", {}, RECORD)


NAMES = st.from_regex(r"[A-Za-z0-9_-]{1,8}", fullmatch=True)
HUES = st.dictionaries(NAMES, st.floats(0.0, 1.0, exclude_max=True), min_size=1, max_size=5)


@settings(max_examples=30)
@given(HUES, HUES, st.booleans())
def test_hues_are_read_back_and_all_else_stays(first: dict[str, float], second: dict[str, float], after: bool) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rig.toml"
        update_hues(None, path, first)
        if after:
            # A table may follow, and comments may stand beside.
            text = path.read_text().replace("[hues]", "# ours\n[hues]  # measured")
            sam3 = '[sam3]\ncheckpoint = "a"\nvocabulary = "b"\n\n[sam3.prompts]\nb0 = "red block"\n'
            path.write_text(f"{text}\n{sam3}")
        update_hues(path, path, second)
        found, text = load_rig(path), path.read_text()
    wanted = {name: round(hue, 4) % 1.0 for name, hue in {**first, **second}.items()}
    assert dict(found.hues) == pytest.approx(wanted)
    assert set(BUILT_IN.splitlines()) <= set(text.splitlines())
    assert ("# measured" in text and found.sam3 is not None) == after


@pytest.mark.parametrize("name", ["", "b 0", "b=0", 'b"', "b\n0", "ä"])
def test_a_thing_without_a_proper_name(name: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="is no name for a thing"):
        update_hues(None, tmp_path / "rig.toml", {name: 0.1})
    assert not list(tmp_path.iterdir())


def test_hues_that_are_written_in_line_are_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text("hues = { b0 = 0.1 }\n" + BUILT_IN)
    before = path.read_text()
    with pytest.raises(ConfigError):
        update_hues(path, path, {"b0": 0.2})
    assert path.read_text() == before and len(list(tmp_path.iterdir())) == 1
