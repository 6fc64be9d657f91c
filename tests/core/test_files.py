import errno
import json
import os
import pickle
from pathlib import Path

import pytest

from resync_robot.core.errors import ConfigError, DiskError
from resync_robot.core.files import (
    FIGURE,
    MCAP,
    PNG,
    REPORT,
    RIG,
    RRD,
    check_output,
    disk_fault,
    read_text,
    unwritable,
    whole,
    whole_folder,
    write_text,
)

RRD_HEAD = b"RRF2" + bytes(20)


@pytest.mark.parametrize("data", [b"gr\xc3\xb6\xc3\x9fe", b"\xef\xbb\xbfgr\xc3\xb6\xc3\x9fe"])
def test_text_is_utf8_with_or_without_a_mark(tmp_path, data):
    (tmp_path / "f").write_bytes(data)
    assert read_text(tmp_path / "f") == "größe"


def test_an_input_is_never_an_output_however_it_is_named(tmp_path, monkeypatch):
    recording = tmp_path / "r.mcap"
    recording.write_bytes(RRD_HEAD)
    (tmp_path / "link").symlink_to(recording)
    os.link(recording, tmp_path / "hard")
    (tmp_path / "d").mkdir()
    monkeypatch.chdir(tmp_path)
    for name in (recording, tmp_path / "link", tmp_path / "hard", tmp_path / "d" / ".." / "r.mcap"):
        with pytest.raises(ConfigError, match="is the file that is read"):
            check_output(name, RRD, [recording])


def test_files_of_another_kind_are_not_replaced(tmp_path):
    (tmp_path / "notes").write_text("mine")
    with pytest.raises(ConfigError, match="exists and is not a Rerun recording"):
        check_output(tmp_path / "notes", RRD)
    (tmp_path / "old").write_bytes(RRD_HEAD)
    check_output(tmp_path / "old", RRD)
    with pytest.raises(ConfigError, match="not an MCAP"):
        check_output(tmp_path / "old", MCAP)
    (tmp_path / "empty").touch()
    for name in ("empty", "missing"):
        check_output(tmp_path / name, RRD)
    with pytest.raises(ConfigError, match="is a folder"):
        check_output(tmp_path, RRD)


def test_what_fails_leaves_what_was_there(tmp_path):
    file = tmp_path / "f"
    file.write_text("before")
    with pytest.raises(RuntimeError), whole(file) as beside:
        beside.write_text("half")
        raise RuntimeError
    assert file.read_text() == "before"
    assert list(tmp_path.iterdir()) == [file]


def test_a_link_stays_a_link_and_permissions_stay(tmp_path):
    (tmp_path / "sub").mkdir()
    real, link = tmp_path / "sub" / "rig.toml", tmp_path / "rig.toml"
    real.write_text("before")
    real.chmod(0o640)
    link.symlink_to(real)
    write_text(link, "größe")
    assert link.is_symlink() and read_text(real) == "größe"
    assert real.stat().st_mode & 0o777 == 0o640


def test_new_files_obey_the_umask(tmp_path):
    before = os.umask(0o027)
    try:
        write_text(tmp_path / "f", "x")
    finally:
        os.umask(before)
    assert (tmp_path / "f").stat().st_mode & 0o777 == 0o640


@pytest.mark.parametrize(
    ("kind", "text", "known"),
    [
        (REPORT, json.dumps({"provenance": {}, "rows": [], "summary": []}), True),
        (REPORT, json.dumps({"rows": [], "notes": "of a person"}), False),
        (REPORT, "[1, 2]", False),
        (REPORT, "[" * 100_000, False),
        (REPORT, "\x00", False),
        (RIG, "\ufeffname = 'a'\ncameras = []\n[arm]\n[gripper]\n", True),
        (RIG, "[project]\nname = 'pyproject'\n", False),
        (RIG, "a recipe", False),
    ],
)
def test_tables_are_known_by_their_names(kind, text, known, tmp_path):
    path = tmp_path / "f"
    path.write_text(text, encoding="utf-8")
    if known:
        check_output(path, kind)
    else:
        with pytest.raises(ConfigError, match="exists and is not"):
            check_output(path, kind)
    assert path.read_text(encoding="utf-8") == text


def test_a_figure_of_ours_is_told_from_other_pictures(tmp_path):
    from matplotlib.figure import Figure

    from resync_robot.figures import save_figure

    figure = Figure()
    save_figure(figure, tmp_path / "ours.png")
    figure.savefig(tmp_path / "theirs.png")
    check_output(tmp_path / "ours.png", FIGURE)
    check_output(tmp_path / "theirs.png", PNG)
    with pytest.raises(ConfigError, match="not a figure that this program drew"):
        check_output(tmp_path / "theirs.png", FIGURE)


def test_a_result_file_is_checked_before_the_work(tmp_path):
    check_output(tmp_path / "deep" / "rows.json", REPORT)
    assert list((tmp_path / "deep").iterdir()) == []
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match="cannot write --json"):
        check_output(tmp_path / "file" / "rows.json", REPORT, option="--json")


def test_a_write_protected_file_is_refused(tmp_path, monkeypatch):
    (tmp_path / "f").write_bytes(RRD_HEAD)
    monkeypatch.setattr(os, "access", lambda path, mode: False)  # root may write everything
    with pytest.raises(ConfigError, match="write-protected"):
        check_output(tmp_path / "f", RRD)


def test_a_device_is_written_as_it_is():
    device = Path(os.devnull)
    check_output(device, REPORT)
    write_text(device, "x")
    assert device.exists() and not device.is_file()


def test_a_full_disk_is_named_with_the_file(tmp_path):
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    with pytest.raises(OSError) as caught, whole(tmp_path / "f") as beside:
        beside.write_text("half")
        raise full
    assert list(tmp_path.iterdir()) == []
    fault = disk_fault(caught.value)
    assert isinstance(fault, DiskError) and fault.what == f"cannot write {tmp_path / 'f'}: No space left on device"
    assert str(pickle.loads(pickle.dumps(fault))) == str(fault)  # noqa: S301 - as it comes from a worker
    assert isinstance(unwritable("f", full, "give another"), DiskError)


def test_the_disk_is_found_behind_the_errors_of_libraries():
    class RustError(Exception):
        pass

    words = RustError("Error while serializing: I/O error: No space left on device (os error 28)")
    assert disk_fault(words) is not None
    try:
        try:
            raise OSError(errno.EDQUOT, "over quota", "a.mp4")
        except OSError as error:
            raise RuntimeError("the encoder failed") from error
    except RuntimeError as error:
        assert "a.mp4" in disk_fault(error).what
    for other in (ValueError("no"), OSError(errno.ENOENT, "no such file"), ConfigError("No space left on device")):
        assert disk_fault(other) is None


def test_a_folder_is_replaced_whole_or_not_at_all(tmp_path):
    folder = tmp_path / "folder"
    for text in ("first", "second"):
        with whole_folder(folder) as beside:
            beside.mkdir()
            (beside / "f").write_text(text)
    with pytest.raises(RuntimeError), whole_folder(folder) as beside:
        beside.mkdir()
        (beside / "f").write_text("half")
        raise RuntimeError
    assert (folder / "f").read_text() == "second" and list(tmp_path.iterdir()) == [folder]
