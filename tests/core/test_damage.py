"""What is wrong with a file, in one sentence that names it and its mend."""

from __future__ import annotations

from pathlib import Path

import pytest

from resync_robot.core.damage import AGAIN, PULL, check_folder_kind, check_shape, reading
from resync_robot.core.errors import PolicyError, TrainingError

SHAPE = {"name": str, "values": [float], "inner": {"count": int}, "either": (str, int)}
GOOD = {"name": "a", "values": [1, 2.5], "inner": {"count": 3, "more": None}, "either": 4}


def test_data_of_that_shape_passes() -> None:
    check_shape(GOOD, SHAPE)
    check_shape([], [int])
    check_shape({}, {})


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ([], "it is [], and should be an object with the fields name, values"),
        (None, "it is None, and should be an object"),
        ({}, "it has no field 'name'"),
        (GOOD | {"name": 3}, "'name' is 3, and should be of type str"),
        (GOOD | {"values": 1.0}, "'values' is 1.0, and should be a list"),
        (GOOD | {"values": [1, "x"]}, "'values[1]' is 'x', and should be of type float"),
        (GOOD | {"values": [float("nan")]}, "'values[0]' is nan"),
        (GOOD | {"values": [float("inf")]}, "'values[0]' is inf"),
        (GOOD | {"inner": {}}, "'inner' has no field 'count'"),
        (GOOD | {"inner": {"count": True}}, "'inner.count' is True, and should be of type int"),
        (GOOD | {"inner": {"count": 1.0}}, "'inner.count' is 1.0"),
        (GOOD | {"either": None}, "'either' is None, and should be of type str or int"),
        (GOOD | {"name": ["x" * 100]}, "..., and should be"),
    ],
)
def test_other_data_is_named_with_its_place(data: object, words: str) -> None:
    with pytest.raises(ValueError) as caught:
        check_shape(data, SHAPE)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (KeyError("seeds"), "it has no 'seeds'"),
        (IsADirectoryError(21, "Is a directory"), "Is a directory"),
        (PolicyError("no policy", "train one"), "no policy"),
        (RuntimeError("first\n\tsecond"), "first second"),
        (AssertionError(), "AssertionError"),
    ],
)
def test_any_complaint_about_a_stage_file_is_one_sentence(tmp_path: Path, error: Exception, words: str) -> None:
    path = tmp_path / "stage.json"
    with pytest.raises(TrainingError) as caught, reading(path):
        raise error
    assert caught.value.what == f"{path} cannot be used: {words}"
    assert caught.value.fix == AGAIN
    assert caught.value.__cause__ is error


def test_long_complaints_are_shortened(tmp_path: Path) -> None:
    with pytest.raises(TrainingError) as caught, reading(tmp_path):
        raise ValueError("x" * 10_000)
    assert len(caught.value.what) < 400


@pytest.mark.parametrize("error", [KeyboardInterrupt, MemoryError])
def test_what_is_not_the_file_s_fault_passes(tmp_path: Path, error: type[BaseException]) -> None:
    with pytest.raises(error), reading(tmp_path):
        raise error


def test_a_pointer_is_recognised_whatever_reads_it(tmp_path: Path) -> None:
    path = tmp_path / "weights.safetensors"
    path.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:1\nsize 3\n")
    with pytest.raises(TrainingError, match="is a Git LFS pointer") as caught, reading(path):
        raise RuntimeError("header too large")
    assert PULL in caught.value.fix and AGAIN in caught.value.fix


def test_a_file_where_a_folder_should_be_is_named(tmp_path: Path) -> None:
    check_folder_kind(tmp_path)
    check_folder_kind(tmp_path / "missing")
    (tmp_path / "file").touch()
    with pytest.raises(TrainingError, match="file cannot be used: it should be a folder"):
        check_folder_kind(tmp_path / "file")
