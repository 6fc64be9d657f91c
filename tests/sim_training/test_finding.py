"""Domains by name, file and module; and one clear error for each way in which a file can be wrong."""

import json
import pickle
import subprocess
import sys
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest

from resync_robot.core.errors import ConfigError, ResyncError, UnknownNameError
from resync_robot.sim_training.domains import DOMAINS, find_domain, finding
from tests.domains import PUCK_DOMAIN, PUCK_FILE, puck

WHOLE = PUCK_FILE.read_text("utf-8")


def test_a_file_is_found_with_and_without_a_name() -> None:
    for spec in (str(PUCK_FILE), f"{PUCK_FILE}:DOMAIN"):
        assert find_domain(spec) == replace(PUCK_DOMAIN, spec=spec)


def test_a_module_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "my_domains.py").write_text(WHOLE.replace("DOMAIN = Domain(", "PUCK = Domain("))
    monkeypatch.syspath_prepend(tmp_path)
    assert find_domain("my_domains:PUCK").name == PUCK_DOMAIN.name


def test_an_installed_package_brings_domains(monkeypatch: pytest.MonkeyPatch) -> None:
    entry = EntryPoint("theirs", "resync_robot.sim_training.domains.cornered_insertion_s:CORNERED_INSERTION_S", "")
    broken = EntryPoint("broken", "no_such_package:DOMAIN", "")
    groups = {finding.GROUP: (entry, broken)}
    monkeypatch.setattr(finding, "entry_points", lambda group: groups[group])
    assert find_domain("theirs") == replace(DOMAINS["cornered-insertion-s"], spec="theirs")
    with pytest.raises(UnknownNameError, match=r"valid: .*broken, cornered-insertion-s, .*theirs"):
        find_domain("thiers")
    with pytest.raises(ConfigError, match=r"domain 'broken' \(no_such_package:DOMAIN\): ModuleNotFoundError"):
        find_domain("broken")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("DOMAIN = (1,\n", r"domain.py, line 1: '\(' was never closed"),
        ("import no_such_package\n", r"domain.py, line 1: ModuleNotFoundError: No module named 'no_such_package'"),
        ("x = 1\n\ny = x / 0\n", r"domain.py, line 3: ZeroDivisionError: division by zero"),
        ("raise SystemExit\n", r"domain.py, line 1: SystemExit"),
        (
            "from resync_robot.core.task import Domain\nDOMAIN = Domain(name='x')\n",
            r"line 2: TypeError: .*missing 6 requ",
        ),
        ("", r"domain.py holds no Domain\n  -> write DOMAIN = Domain\(...\)"),
        ("DOMAIN = {}\n", r"DOMAIN is of type dict, and no Domain"),
        (WHOLE.replace("DOMAIN = Domain(", "A = B = Domain("), r"several domains: A, B\n  -> say which: .*domain.py:A"),
        (WHOLE + "\nDOMAIN.classifiers.pop('At')\n", r"predicate At has no classifier\n  -> .*check-domain"),
    ],
    ids=str,
)
def test_each_way_in_which_a_file_can_be_wrong(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "domain.py").write_text(text)
    with pytest.raises(ConfigError, match=words):
        find_domain(str(tmp_path / "domain.py"))


def test_a_file_that_was_mended_is_read_again(tmp_path: Path) -> None:
    file = tmp_path / "domain.py"
    file.write_text("import no_such_package\n")
    with pytest.raises(ConfigError):
        find_domain(str(file))
    file.write_text(WHOLE)
    assert find_domain(str(file)).name == PUCK_DOMAIN.name


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("{}/none.py", r"there is no file .*none.py\n  -> check the path"),
        ("{}/folder.py", r"is a folder"),
        ("{}/other.toml", r"the file of one ends in .py"),
        (f"{PUCK_FILE}:OTHER", r"has no 'OTHER'\n  -> domains in it: DOMAIN"),
        (f"{PUCK_FILE}:FETCH", r"FETCH is of type Operator, and no Domain"),
        ("no_such_package.domains:D", r"there is no module no_such_package.domains\n  -> install it"),
        ("resync_robot.core.task:NONE", r"resync_robot.core.task has no 'NONE'"),
        ("resync_robot.core.task:Domain", r"Domain is of type type, and no Domain"),
    ],
    ids=str,
)
def test_what_cannot_be_found(spec: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "folder.py").mkdir()
    (tmp_path / "other.toml").write_text("")
    with pytest.raises(ConfigError, match=words) as caught:
        find_domain(spec.format(tmp_path))
    assert caught.value.fix
    assert isinstance(pickle.loads(pickle.dumps(caught.value)), ResyncError)  # noqa: S301 - our own, as from a worker


def test_a_kept_name_holds_from_any_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(PUCK_FILE.parent)
    kept = [find_domain(s).spec for s in (PUCK_FILE.name, f"{PUCK_FILE.name}:DOMAIN", "cornered-insertion-s")]
    assert kept == [str(PUCK_FILE), f"{PUCK_FILE}:DOMAIN", "cornered-insertion-s"]


def test_what_one_process_keeps_of_a_file_s_domain_another_reads(tmp_path: Path) -> None:
    world = puck.Rooms(PUCK_DOMAIN.scenarios["door"].sample(np.random.default_rng(0), 0))
    (tmp_path / "kept").write_bytes(pickle.dumps(world))
    code = (
        "import json, pickle, sys; from resync_robot.sim_training.domains import find_domain; find_domain(sys.argv[1]);"
        "print(json.dumps(pickle.load(open(sys.argv[2], 'rb')).perceive().to_json()))"
    )
    command = [sys.executable, "-c", code, str(PUCK_FILE), str(tmp_path / "kept")]
    assert json.loads(subprocess.check_output(command)) == world.perceive().to_json()
