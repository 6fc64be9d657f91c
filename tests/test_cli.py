"""The command line: what it answers, with which exit code, and what it must not load to do so."""

import errno
import logging
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from resync_robot import __version__, cli
from resync_robot.commands.calibrate import CalibrateConfig
from resync_robot.commands.check_domain import CheckDomainConfig
from resync_robot.commands.doctor import DoctorConfig
from resync_robot.commands.evaluate import EvaluateConfig
from resync_robot.commands.export_dataset import ExportDatasetConfig
from resync_robot.commands.new_domain import NewDomainConfig
from resync_robot.commands.review import ReviewConfig
from resync_robot.commands.train_sim import QUICK_MINUTES, TrainConfig
from resync_robot.core.errors import ConfigError, DiskError


@pytest.fixture
def given(monkeypatch: pytest.MonkeyPatch):
    """Replace what a command runs by a function; calling this returns the settings that it was run with."""

    def replace(name: str, result: object = None) -> list[object]:
        seen: list[object] = []

        def run(config: object) -> object:
            seen.append(config)
            if isinstance(result, BaseException):
                raise result
            return result

        monkeypatch.setitem(cli.COMMANDS, name, (cli.COMMANDS[name][0], run))
        return seen

    return replace


def exit_code(*args: str) -> int | str | None:
    """The exit code, whether it is returned or the parser ends the program."""
    try:
        return cli.main(args)
    except SystemExit as end:
        return end.code


def test_help_names_every_command_and_loads_nothing_heavy() -> None:
    code = (
        "import sys; from resync_robot.cli import main\n"
        "try: main(['--help'])\n"
        "except SystemExit: pass\n"
        "heavy = {'torch', 'sapien', 'mani_skill', 'lerobot', 'rerun', 'numpy', 'scipy', 'cv2', 'matplotlib'}\n"
        "print('LOADED', sorted(heavy & set(sys.modules)))"
    )
    outcome = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True)
    for name in cli.COMMANDS:
        assert name in outcome.stdout
    assert "LOADED []" in outcome.stdout


UNNAMED = {
    (ReviewConfig, "episode"),
    (CalibrateConfig, "what"),
    (CheckDomainConfig, "domain"),
    (NewDomainConfig, "name"),
    (ExportDatasetConfig, "run"),
}
"""What is given without the name of an option."""
RENAMED = {(TrainConfig, "library"): "from"}
"""What has another name on the command line: `from` is no name in Python."""


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_every_command_explains_each_of_its_options(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code(name, "--help") == 0
    shown = capsys.readouterr().out
    settings = cli.COMMANDS[name][0]
    for field in settings.__dataclass_fields__:
        unnamed = (settings, field) in UNNAMED
        option = RENAMED.get((settings, field), field.replace("_", "-"))
        assert f"--{option}" in shown or unnamed
    assert "{None}" not in shown


@pytest.mark.parametrize("what", ["board", "intrinsics", "hand-eye", "check"])
def test_what_to_calibrate_explains_its_options(what: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code("calibrate", what, "--help") == 0
    shown = capsys.readouterr().out
    assert "--board.square" in shown and "--out" in shown and "{None}" not in shown


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code("--version") == 0
    assert capsys.readouterr().out == f"resync-robot {__version__}\n"


@pytest.mark.parametrize(
    ("args", "word"),
    [
        ((), "train-sim"),
        (("fly",), "fly"),
        (("train-sim", "--speed", "9"), "--speed"),
        (("train-sim", "--preset", "huge"), "huge"),
        (("train-sim", "--seed", "one"), "one"),
        (("deploy", "--backend", "ur5"), "ur5"),
        (("review",), "PATH"),
    ],
)
def test_what_cannot_be_parsed_is_one_message_and_code_2(
    args: tuple[str, ...], word: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert exit_code(*args) == 2
    shown = capsys.readouterr()
    assert word in shown.err
    assert "Traceback" not in shown.err
    assert shown.out == ""


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (("calibrate",), "board, intrinsics, hand-eye, check, noise or hues"),
        (("calibrate", "--camera", "wrist"), "board, intrinsics, hand-eye, check, noise or hues"),
        (("evaluate", "--json"), "--json needs the name of a file or folder"),
        (("review", "--save"), "--save needs the name of a file or folder"),
        (("review", "x.mcap", "--save", "--mend", "y.mcap"), "--save needs the name of a file or folder"),
        (("calibrate", "hand-eye", "--write"), "--write needs the name of a file or folder"),
        (("evaluate", "--library", "--seeds", "1"), "--library needs the name of a file or folder"),
    ],
)
def test_what_stands_alone_and_needs_more_says_what_to_type(
    args: tuple[str, ...], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert exit_code(*args) == 2
    shown = capsys.readouterr().err
    assert shown.startswith("error: ") and words in shown and "\n  -> " in shown


@pytest.mark.parametrize(
    "words",
    [
        *((name,) for name in cli.COMMANDS),
        *(("calibrate", v) for v in ("board", "intrinsics", "hand-eye", "check", "noise", "hues")),
    ],
)
def test_help_has_no_words_of_the_program_itself(words: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code(*words, "--help") == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "(default: None)" not in shown and "(default: )" not in shown
    assert "what options" not in shown and "what.board" not in shown


def test_quick_takes_as_long_by_its_help_as_by_the_readme(capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code("train-sim", "--help") == 0
    assert f"about {QUICK_MINUTES} minutes on two cores" in " ".join(capsys.readouterr().out.split())
    readme = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")
    assert f"{QUICK_MINUTES} min" in readme


@pytest.mark.parametrize(
    ("args", "option"),
    [
        (("train-sim", "--out", ""), "--out"),
        (("train-sim", "--out="), "--out"),
        (("train-sim", "--out", " "), "--out"),
        (("deploy", "--rig", "", "--dry-run"), "--rig"),
        (("evaluate", "--json", ""), "--json"),
        (("evaluate", "--library", ""), "--library"),
        (("review", ""), "review"),
    ],
)
def test_an_empty_value_is_not_the_current_folder(
    args: tuple[str, ...], option: str, given, capsys: pytest.CaptureFixture[str]
) -> None:
    assert exit_code(*args) == 2
    assert f"error: {option} is empty" in capsys.readouterr().err


def test_an_error_of_ours_is_one_message_and_code_2(given, capsys: pytest.CaptureFixture[str]) -> None:
    given("doctor", ConfigError("the rig is on fire", "put it out"))
    assert exit_code("doctor") == 2
    shown = capsys.readouterr()
    assert shown.err == "error: the rig is on fire\n  -> put it out\n"
    assert shown.out == ""


def test_a_defect_keeps_its_traceback(given) -> None:
    given("doctor", ZeroDivisionError())
    with pytest.raises(ZeroDivisionError):
        cli.main(["doctor"])


def test_control_c_is_one_line_and_code_130(given, capsys: pytest.CaptureFixture[str]) -> None:
    given("doctor", KeyboardInterrupt())
    assert exit_code("doctor") == 130
    assert capsys.readouterr().err == "interrupted by Ctrl-C\n"


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_to_end_is_one_line_and_the_code_that_a_shell_has(number: signal.Signals) -> None:
    code = doctor_that(f"import os, time; os.kill(os.getpid(), {int(number)}); time.sleep(60)")
    outcome = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert (outcome.returncode, outcome.stderr) == (128 + number, f"ended by {number.name}\n")


def test_a_terminal_that_is_gone_is_no_defect() -> None:
    """Its hang-up ends the command in order, though nobody can be told."""
    master, slave = os.openpty()
    cleaned = "try: print('runs', flush=True); time.sleep(60)\n    finally: os.write(3, b'clean'); print('bye')"
    reading, writing = os.pipe()
    code = doctor_that(f"\n    import os, time\n    {cleaned}")
    process = subprocess.Popen(
        [sys.executable, "-c", f"import os, fcntl, termios; os.dup2({writing}, 3)\n"
         "os.setsid(); fcntl.ioctl(0, termios.TIOCSCTTY, 0)\n" + code],
        stdin=slave, stdout=slave, stderr=slave, pass_fds=(writing,),
    )  # fmt: skip
    os.close(slave)
    os.close(writing)
    try:
        assert b"runs" in os.read(master, 1024)
        os.close(master)
        assert process.wait(60) == 128 + signal.SIGHUP
        assert os.read(reading, 100) == b"clean"
    finally:
        os.close(reading)
        process.kill()
        process.wait()


@pytest.mark.parametrize(("result", "code"), [(None, 0), (0, 0), (2, 2)])
def test_a_command_may_return_its_exit_code(given, result: int | None, code: int) -> None:
    given("doctor", result)
    assert exit_code("doctor") == code


def test_options_reach_the_settings(given) -> None:
    seen = given("train-sim")
    assert exit_code("train-sim", "--preset", "full", "--seed", "7", "--resume", "--out", "here") == 0
    assert seen == [TrainConfig(preset="full", seed=7, resume=True, out=Path("here"))]


@pytest.mark.parametrize(
    "args",
    [
        ("--library", "a", "b"),
        ("--library", "a", "--library", "b"),
        ("--library=a", "--library=b"),
        ("--library", "a", "--episodes", "10", "--library", "b"),
    ],
)
def test_several_libraries_are_all_kept(given, args: tuple[str, ...]) -> None:
    seen = given("evaluate")
    assert exit_code("evaluate", *args, "--seeds", "0", "1") == 0
    assert seen == [EvaluateConfig(library=(Path("a"), Path("b")), seeds=(0, 1))]


@pytest.mark.parametrize("args", [("-v", "doctor"), ("doctor", "-v"), ("doctor", "--verbose")])
def test_verbose_logs_our_packages_at_debug_level(given, args: tuple[str, ...]) -> None:
    seen = given("doctor")
    assert exit_code(*args) == 0
    assert seen == [DoctorConfig()]
    assert logging.getLogger("resync_robot.sim_training.ppo").isEnabledFor(logging.DEBUG)
    assert not logging.getLogger("matplotlib").isEnabledFor(logging.DEBUG)
    assert exit_code("doctor") == 0
    assert not logging.getLogger("resync_robot.sim_training.ppo").isEnabledFor(logging.DEBUG)


def test_the_module_runs_as_the_command_does() -> None:
    command = [sys.executable, "-m", "resync_robot", "--version"]
    outcome = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    assert outcome.stdout == f"resync-robot {__version__}\n"


REPORTS = "from resync_robot.console import say; [say('a line') for _ in range(3)]"
PRINTS = "[print('a line' * 1000) for _ in range(30)]"


def unread(code: str, stderr_too: bool = False, unbuffered: bool = False) -> tuple[int, str]:
    """Exit code and error output of Python code whose standard output is a pipe that nobody reads any more."""
    reading, writing = os.pipe()
    os.close(reading)
    try:
        outcome = subprocess.run(
            [sys.executable, "-c", code],
            stdout=writing,
            stderr=writing if stderr_too else subprocess.PIPE,
            env=os.environ | {"PYTHONUNBUFFERED": "1" if unbuffered else ""},
            text=True,
            timeout=120,
        )
    finally:
        os.close(writing)
    return outcome.returncode, outcome.stderr or ""


def doctor_that(does: str) -> str:
    """Code of the program with another doctor."""
    return (
        "import sys; from resync_robot import cli\n"
        f"def run(config): {does}\n"
        "cli.COMMANDS['doctor'] = (cli.DoctorConfig, run)\n"
        "sys.exit(cli.main(['doctor']))"
    )


@pytest.mark.parametrize("stderr_too", [False, True])
@pytest.mark.parametrize("argument", ["--help", "--version"])
def test_a_reader_that_has_left_ends_the_program_quietly(argument: str, stderr_too: bool) -> None:
    code = f"import sys; from resync_robot.cli import main; sys.exit(main(['{argument}']))"
    assert unread(code, stderr_too) == (141, "")


@pytest.mark.parametrize("does", [REPORTS, PRINTS])
@pytest.mark.parametrize(("stderr_too", "unbuffered"), [(False, False), (True, False), (False, True)])
def test_a_command_that_reports_to_nobody_ends_quietly(does: str, stderr_too: bool, unbuffered: bool) -> None:
    assert unread(doctor_that(does), stderr_too, unbuffered) == (141, "")


def printed_to(where: str, code: str, **environment: str) -> tuple[int, bytes]:
    """Exit code and error output of Python code whose standard output is that file, with these variables set."""
    with open(where, "wb") as output:  # noqa: PTH123 - of a name, not of a path
        outcome = subprocess.run(
            [sys.executable, "-c", code],
            stdout=output,
            stderr=subprocess.PIPE,
            env=os.environ | environment,
            timeout=120,
        )
    return outcome.returncode, outcome.stderr


@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize("does", [REPORTS, PRINTS, "sys.exit(cli._run(['--help']))"])
def test_output_to_a_full_disk_is_one_message_and_code_3(does: str, unbuffered: str) -> None:
    code, shown = printed_to("/dev/full", doctor_that(does), PYTHONUNBUFFERED=unbuffered)
    assert code == 3
    assert shown.startswith(b"error: cannot write standard output\n  -> ") and shown.count(b"\n") == 2


def test_a_full_disk_is_one_message_and_code_3(given, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for error in (
        OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "runs/a.json"),
        DiskError("cannot write runs/a.json: No space left on device", "free some space"),
    ):
        given("doctor", error)
        assert exit_code("doctor") == 3
        shown = capsys.readouterr()
        assert shown.err.startswith("error: cannot write runs/a.json: No space left on device\n  -> free some space")
        assert shown.out == ""


def test_every_sign_is_printed_in_every_encoding(tmp_path: Path) -> None:
    helped = "import sys; from resync_robot.cli import main; sys.exit(main(['deploy', '--help']))"
    said = doctor_that(r"from resync_robot.console import say; say('\u25c0 \udcff'); print('\u2022')")
    for code in (helped, said):
        for encoding in ("ascii", "iso-8859-1", "utf-8"):
            assert printed_to(str(tmp_path / "out"), code, PYTHONIOENCODING=encoding) == (0, b"")
            assert (tmp_path / "out").stat().st_size > 0


def test_a_defect_is_shown_though_nobody_reads_the_output() -> None:
    assert "ZeroDivisionError" in unread(doctor_that("print('a line'); 1 / 0"))[1]


def test_a_pipe_that_breaks_elsewhere_is_a_defect_and_keeps_its_traceback(given) -> None:
    given("doctor", BrokenPipeError("a worker has gone"))
    with pytest.raises(BrokenPipeError):
        cli.main(["doctor"])
