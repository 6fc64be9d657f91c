import os

import pytest

from resync_robot.core.errors import ConfigError
from resync_robot.core.files import MCAP, RRD, check_output, read_text, whole, write_text

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
