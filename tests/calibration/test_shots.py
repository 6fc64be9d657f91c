"""Pictures are judged as they come, kept on disk after each, and read back as they were."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from resync_robot.calibration.detect import BoardDetector, Rejected, Sighting
from resync_robot.calibration.shots import LIST, Judge, Shot, ShotFolder, read_shots, take, usable
from resync_robot.core.errors import CalibrationError, ConfigError
from tests.calibration import synthetic
from tests.calibration.synthetic import INTRINSICS, SPEC

EMPTY = np.full((240, 424, 3), 90, np.uint8)


def judge() -> Judge:
    return Judge(BoardDetector(SPEC, INTRINSICS))


def picture(seed: int) -> np.ndarray:
    return synthetic.photograph(synthetic.draw_pose(np.random.default_rng(seed)))


def test_a_view_like_an_earlier_one_is_refused_and_names_it() -> None:
    verdicts = judge()
    assert isinstance(verdicts("a.png", picture(0)), Sighting)
    assert isinstance(verdicts("b.png", picture(1)), Sighting)
    again = verdicts("c.png", picture(0))
    assert isinstance(again, Rejected) and "redundant" in again.reason and "a.png" in again.reason
    assert isinstance(Judge(BoardDetector(SPEC, INTRINSICS), redundant=False)("d.png", picture(0)), Sighting)


def test_the_arm_stands_where_it_is_measured_when_the_picture_is_taken() -> None:
    here = np.zeros(6)

    def move(q: np.ndarray) -> None:
        here[:] = q + 0.001

    poses = [np.full(6, 0.1), np.full(6, 0.2)]
    shots = list(take(poses, move, lambda: EMPTY, lambda: here, judge(), "wrist"))
    assert [s.name for s in shots] == ["wrist-000.png", "wrist-001.png"]
    np.testing.assert_allclose([s.q[0] for s in shots], [0.101, 0.201])


def kept(path: Path, count: int = 2) -> list[Shot]:
    folder, verdicts = ShotFolder(path, "wrist", SPEC), judge()
    shots = []
    for i in range(count):
        colour = picture(i) if i < count - 1 else EMPTY
        name = f"wrist-{i:03d}.png"
        shots.append(Shot(name, colour, np.arange(6) / 10 + i, verdicts(name, colour)))
        folder.add(shots[-1])
    return shots


def test_what_is_kept_is_read_back(tmp_path: Path) -> None:
    written = kept(tmp_path / "views")
    read = read_shots(tmp_path / "views", "wrist", judge())
    for before, after in zip(written, read, strict=True):
        assert before.name == after.name
        np.testing.assert_array_equal(before.colour, after.colour)
        np.testing.assert_array_equal(before.q, after.q)
        assert type(before.verdict) is type(after.verdict)


def test_the_list_is_whole_after_every_shot(tmp_path: Path) -> None:
    folder = ShotFolder(tmp_path, "wrist", SPEC)
    for i in range(3):
        folder.add(Shot(f"{i}.png", EMPTY, np.zeros(6), Rejected("dark")))
        assert len(json.loads((tmp_path / LIST).read_text())["shots"]) == i + 1
        assert not list(tmp_path.glob(".*"))


def test_pictures_are_never_overwritten(tmp_path: Path) -> None:
    kept(tmp_path)
    with pytest.raises(ConfigError, match="holds pictures already"):
        ShotFolder(tmp_path, "wrist", SPEC)
    assert len(read_shots(tmp_path, "wrist", judge())) == 2


def test_a_list_from_elsewhere_names_no_picture_out_of_its_folder(tmp_path: Path) -> None:
    """Overlays are named like the pictures."""
    kept(tmp_path)
    content = json.loads((tmp_path / LIST).read_text())
    content["shots"][0]["file"] = "../" + content["shots"][0]["file"]
    (tmp_path / LIST).write_text(json.dumps(content))
    assert "/" not in read_shots(tmp_path, "wrist", judge())[0].name


def broken(path: Path, **change: object) -> str:
    content = json.loads((path / LIST).read_text())
    for name, value in change.items():
        if name in content:
            content[name] = value
        else:
            content["shots"][0][name] = value
    (path / LIST).write_text(json.dumps(content))
    with pytest.raises(CalibrationError) as error:
        read_shots(path, "wrist", judge())
    assert error.value.fix
    return str(error.value)


def test_of_two_that_begin_in_one_folder_at_once_one_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Between its look and its first write the other has begun: only the system can tell them apart."""
    monkeypatch.setattr(Path, "exists", lambda path: False)
    ShotFolder(tmp_path, "wrist", SPEC)
    with pytest.raises(ConfigError, match="holds pictures already"):
        ShotFolder(tmp_path, "wrist", SPEC)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"camera": "front"}, "--camera front"),
        ({"shots": 3}, "not what resync-robot calibrate writes"),
        ({"q": [1, 2]}, "must be 6 numbers"),
        ({"q": ["a"] * 6}, "must be 6 numbers"),
        ({"q": [float("nan")] * 6}, "must be 6 numbers"),
        ({"file": "absent.png"}, "missing or no picture"),
        ({"file": "../../outside.png"}, "missing or no picture"),
    ],
)
def test_a_broken_list_is_one_error(change: dict, word: str, tmp_path: Path) -> None:
    kept(tmp_path / "a" / "views")
    (tmp_path / "outside.png").write_bytes((tmp_path / "a" / "views" / "wrist-000.png").read_bytes())
    assert word in broken(tmp_path / "a" / "views", **change)


def test_no_folder_and_no_list_are_one_error(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match="no pictures in"):
        read_shots(tmp_path / "nowhere", "wrist", judge())
    (tmp_path / LIST).write_text("{")
    with pytest.raises(CalibrationError, match="not what"):
        read_shots(tmp_path, "wrist", judge())
    (tmp_path / LIST).write_bytes(b"\xff\xfe")
    with pytest.raises(CalibrationError, match="not what"):
        read_shots(tmp_path, "wrist", judge())


def test_too_few_usable_pictures_say_why_most_were_refused() -> None:
    dark = [Shot(f"{i}", EMPTY, np.zeros(6), Rejected(f"too far away ({i}.2 m): a square")) for i in range(3)]
    other = Shot("3", EMPTY, np.zeros(6), Rejected("blurred: 5 px"))
    with pytest.raises(CalibrationError, match=r"0 usable pictures of the board of 4(.|\n)*too far away"):
        usable([other, *dark], 8)
    assert usable([other], 0) == []
