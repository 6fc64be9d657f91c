"""A library comes back as it was saved; any other folder is refused, and nothing in it can run."""

import errno
import hashlib
import json
import os
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from resync_robot.core.errors import DiskError, LibraryError
from resync_robot.core.library import LearnedFailure, LearnedStage, Library, Record, load_library, save_library

GAUSSIANS = {"box": {"mean": [0.0, 1.0]}, "can": {"mean": [2.0]}}
FAILURE = LearnedFailure(
    skill="Pick", argument=1, objects={"can": "can", "box": "box"}, before=GAUSSIANS, after=GAUSSIANS
)
LIBRARY = Library(
    types_hash="0123",
    domain="test",
    rig_hash="abc",
    domain_pddl="(define (domain test))\n",
    predicates={"free": Record({"types": ["block"]}, {"w": np.arange(6, dtype=np.float32).reshape(2, 3)})},
    skills={
        "Recover": Record({"rate_hz": 10.0}, {"b": np.ones(4, np.float32), "a": np.zeros((2, 2), np.float32)}),
        "Pick": Record({"rate_hz": 20.0}),
    },
    stages=(
        LearnedStage(recovery="Recover", scenario="s0", failure=FAILURE, figures={"seconds": 3.5}),
        LearnedStage(recovery="Push", scenario="s1", failure=replace(FAILURE, argument=2)),
    ),
    provenance={"seed": 3, "seconds": 12.5},
    policies={"Recover": {"config.json": b"{}", "model.safetensors": b"\x00\x01" * 50}},
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    save_library(LIBRARY, tmp_path / "library")
    return tmp_path / "library"


def test_a_saved_library_comes_back(folder: Path) -> None:
    back = load_library(folder)
    assert (back.domain, back.rig_hash, back.domain_pddl) == ("test", "abc", LIBRARY.domain_pddl)
    assert back.types_hash == LIBRARY.types_hash == "0123"
    assert (back.stages, back.provenance) == (LIBRARY.stages, LIBRARY.provenance)
    assert back.policies == LIBRARY.policies
    for found, saved in ((back.predicates, LIBRARY.predicates), (back.skills, LIBRARY.skills)):
        assert set(found) == set(saved)
        for name, record in saved.items():
            assert found[name].meta == record.meta
            assert set(found[name].tensors) == set(record.tensors)
            for key, tensor in record.tensors.items():
                np.testing.assert_array_equal(found[name].tensors[key], tensor)
    assert back.content_hash == LIBRARY.content_hash


def test_the_content_hash_knows_behaviour_and_not_the_date() -> None:
    assert replace(LIBRARY, provenance={"seed": 4}).content_hash == LIBRARY.content_hash
    assert replace(LIBRARY, stages=(replace(LIBRARY.stages[0], figures={}), LIBRARY.stages[1])).content_hash == (
        LIBRARY.content_hash
    )
    assert replace(LIBRARY, stages=LIBRARY.stages[::-1]).content_hash != LIBRARY.content_hash
    assert replace(LIBRARY, domain_pddl="(define)").content_hash != LIBRARY.content_hash
    weights = {"free": Record({"types": ["block"]}, {"w": np.zeros((2, 3), np.float32)})}
    assert replace(LIBRARY, predicates=weights).content_hash != LIBRARY.content_hash


def test_the_content_hash_knows_the_camera_policy() -> None:
    other = {"Recover": {"config.json": b"{}", "model.safetensors": b"\x00\x02" * 50}}
    assert replace(LIBRARY, policies=other).content_hash != LIBRARY.content_hash


def test_saving_again_replaces_and_leaves_no_rest(folder: Path) -> None:
    save_library(replace(LIBRARY, skills={}), folder)
    assert set(load_library(folder).skills) == set()
    assert [p.name for p in folder.parent.iterdir()] == ["library"]


def test_a_folder_that_is_no_library_is_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "library").mkdir()
    (tmp_path / "library" / "thesis.tex").write_text("mine")
    with pytest.raises(LibraryError, match="exists and is no library"):
        save_library(LIBRARY, tmp_path / "library")
    assert (tmp_path / "library" / "thesis.tex").read_text() == "mine"


def test_a_full_disk_leaves_the_old_library(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(path: Path, data: bytes) -> None:
        if path.name == "library.json":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(DiskError, match="No space left"):
        save_library(replace(LIBRARY, domain="other"), folder)
    assert load_library(folder).domain == "test"
    assert [p.name for p in folder.parent.iterdir()] == ["library"]


def test_the_rest_of_a_save_that_was_killed_does_no_harm(folder: Path) -> None:
    for name in ("library.part", "library.old"):
        (folder.parent / name).mkdir()
        (folder.parent / name / "junk").write_text("half a file")
    save_library(replace(LIBRARY, domain="other"), folder)
    assert load_library(folder).domain == "other"
    assert [p.name for p in folder.parent.iterdir()] == ["library"]


def files() -> list[str]:
    return [
        "domain.pddl",
        "stages/2-Push.json",
        "provenance.json",
        "predicates/free.json",
        "predicates/free.safetensors",
        "skills/Recover.safetensors",
        "skills/Pick.json",
    ]


def refused(folder: Path, *words: str) -> None:
    with pytest.raises(LibraryError) as error:
        load_library(folder)
    for word in (*words, "train-sim"):
        assert word in str(error.value)


@pytest.mark.parametrize("name", files())
def test_a_missing_file_is_named(folder: Path, name: str) -> None:
    (folder / name).unlink()
    refused(folder, name)


@pytest.mark.parametrize("name", files())
def test_a_truncated_file_is_named(folder: Path, name: str) -> None:
    path = folder / name
    path.write_bytes(path.read_bytes()[:-1])
    refused(folder, name, "truncated or altered")


@pytest.mark.parametrize("name", files())
def test_an_altered_file_is_named(folder: Path, name: str) -> None:
    path = folder / name
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(bytes(data))
    refused(folder, name, "truncated or altered")


@pytest.mark.parametrize("name", [*files(), "library.json"])
def test_a_git_lfs_pointer_is_no_reason_to_train_anew(folder: Path, name: str) -> None:
    (folder / name).write_text("version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n")
    with pytest.raises(LibraryError, match="is a Git LFS pointer") as caught:
        load_library(folder)
    assert str(folder / name) in caught.value.what
    assert "git lfs pull" in caught.value.fix and "train-sim" not in str(caught.value)


@pytest.mark.parametrize("name", [n for n in files() if n.endswith((".json", ".pddl"))])
def test_line_ends_that_git_changed_are_no_reason_to_train_anew(folder: Path, name: str) -> None:
    path = folder / name
    path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    with pytest.raises(LibraryError, match="the line ends of") as caught:
        load_library(folder)
    assert str(path) in caught.value.what and "core.autocrlf" in caught.value.what
    assert ".gitattributes" in caught.value.fix and "train-sim" not in str(caught.value)


def test_a_manifest_with_other_line_ends_is_the_same_manifest(folder: Path) -> None:
    path = folder / "library.json"
    path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    load_library(folder)


def test_git_never_changes_the_line_ends_of_the_shipped_library(tmp_path: Path) -> None:
    root = Path(__file__).parents[2]
    asked = ["git", "check-attr", "text", "--", "resync_robot/shipped/cornered-insertion-s/domain.pddl"]
    answer = subprocess.run(asked, cwd=root, capture_output=True, text=True)
    if answer.returncode:
        pytest.skip("no checkout")
    assert answer.stdout.strip().endswith("text: unset")


def alter_manifest(folder: Path, **values: object) -> None:
    path = folder / "library.json"
    path.write_text(json.dumps({**json.loads(path.read_text("utf-8")), **values}))


def test_another_version_is_refused(folder: Path) -> None:
    alter_manifest(folder, version=99)
    refused(folder, "version 99", "reads version 3")


def test_a_library_of_one_stage_only_is_refused_with_what_to_use_instead(folder: Path) -> None:
    """Version 2 had no stages; the message says what there is in its place."""
    alter_manifest(folder, version=2)
    with pytest.raises(LibraryError, match="is a library of version 2") as caught:
        load_library(folder)
    assert "leave out --library" in caught.value.fix and "train-sim" in caught.value.fix


def alter_stage(folder: Path, to: str = "stages/2-Push.json", **values: object) -> None:
    """Change fields of the second stage, or its name, and list what comes of it."""
    path = folder / "stages/2-Push.json"
    saved = json.loads(path.read_text("utf-8"))
    if isinstance(failure := values.get("failure"), dict):
        values = {**values, "failure": {**saved["failure"], **failure}}
    path.unlink()
    (folder / to).write_text(json.dumps({**saved, **values}))
    listed = json.loads((folder / "library.json").read_text("utf-8"))["files"]
    del listed["stages/2-Push.json"]
    alter_manifest(folder, files={**listed, to: hashlib.sha256((folder / to).read_bytes()).hexdigest()})


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"recovery": "Pull"}, "it is about Pull"),
        ({"scenario": 3}, "'scenario'"),
        ({"failure": {"argument": "block"}}, "'failure.argument'"),
        ({"failure": {"objects": {}}}, "before and after for each object"),
        ({"failure": {"after": {"box": {}}}}, "before and after for each object"),
        ({"failure": []}, "'failure'"),
    ],
)
def test_a_stage_that_is_none_is_refused(folder: Path, changes: dict[str, object], word: str) -> None:
    alter_stage(folder, **changes)  # type: ignore[arg-type]
    refused(folder, "2-Push.json is no stage", word)


@pytest.mark.parametrize("name", ["stages/3-Push.json", "stages/02-Push.json", "stages/Push-Push.json"])
def test_stages_that_do_not_count_from_one_are_refused(folder: Path, name: str) -> None:
    alter_stage(folder, to=name)
    refused(folder, "should count from 1")


@pytest.mark.parametrize("name", ["../secret", "predicates/../../secret", "/etc/hostname"])
def test_a_file_outside_the_folder_is_refused_unread(folder: Path, name: str) -> None:
    (folder.parent / "secret").write_text("not yours")
    listed = json.loads((folder / "library.json").read_text("utf-8"))["files"]
    alter_manifest(folder, files={**listed, name: "0" * 64})
    refused(folder, "outside the library", name)


@pytest.mark.parametrize("value", [None, [], {}, {"domain.pddl": "0"}])
def test_a_manifest_without_its_files_is_refused(folder: Path, value: object) -> None:
    alter_manifest(folder, files=value)
    refused(folder, "no full list of files")


@pytest.mark.parametrize("text", ["", "{", "[]", "null", "\x00"])
def test_a_manifest_that_is_none_is_refused(folder: Path, text: str) -> None:
    (folder / "library.json").write_text(text)
    refused(folder)


def test_a_folder_that_is_none_is_refused(tmp_path: Path) -> None:
    refused(tmp_path / "absent", "no library folder")
    refused(tmp_path, "library.json")


def test_weights_that_are_none_are_refused_though_their_hash_is_right(folder: Path) -> None:
    junk = b"\x80\x04junk that a pickle reader would run"
    (folder / "predicates/free.safetensors").write_bytes(junk)
    listed = json.loads((folder / "library.json").read_text("utf-8"))["files"]
    listed["predicates/free.safetensors"] = hashlib.sha256(junk).hexdigest()
    alter_manifest(folder, files=listed)
    refused(folder, "free.safetensors cannot be read")


def test_a_folder_that_cannot_be_written_says_so(tmp_path: Path) -> None:
    # A file where a folder should be: refused to root as well, whom permissions do not stop.
    (tmp_path / "file").write_text("")
    with pytest.raises(LibraryError, match=r"cannot write the library(.|\n)*--out"):
        save_library(LIBRARY, tmp_path / "file" / "library")
