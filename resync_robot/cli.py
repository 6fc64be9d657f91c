"""The command line: its sub-commands, one clear message for what goes wrong, nothing else.

Each command is a settings dataclass and a function beside it. The modules imported here load nothing heavy
before their function runs, so that --help answers at once.
"""

from __future__ import annotations

import logging
import os
import select
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import fields
from io import TextIOWrapper
from itertools import pairwise
from typing import Any, TextIO, get_args, get_type_hints

import tyro

from resync_robot import __version__
from resync_robot.commands.calibrate import CalibrateConfig, calibrate
from resync_robot.commands.check_domain import CheckDomainConfig, check_domain
from resync_robot.commands.deploy import DeployConfig, deploy
from resync_robot.commands.doctor import DoctorConfig, doctor
from resync_robot.commands.emulate import EmulateConfig, emulate
from resync_robot.commands.evaluate import EvaluateConfig, evaluate
from resync_robot.commands.export_dataset import ExportDatasetConfig, export_dataset
from resync_robot.commands.new_domain import NewDomainConfig, new_domain
from resync_robot.commands.review import ReviewConfig, review
from resync_robot.commands.train_sim import TrainConfig, train
from resync_robot.core.errors import ConfigError, DiskError, ResyncError
from resync_robot.core.files import disk_fault, packaged_rig
from resync_robot.signals import ended_by, number_of, raised, words_for

COMMANDS: dict[str, tuple[type, Callable[[Any], int | None]]] = {
    "train-sim": (TrainConfig, train),
    "deploy": (DeployConfig, deploy),
    "emulate": (EmulateConfig, emulate),
    "evaluate": (EvaluateConfig, evaluate),
    "review": (ReviewConfig, review),
    "calibrate": (CalibrateConfig, calibrate),
    "doctor": (DoctorConfig, doctor),
    "check-domain": (CheckDomainConfig, check_domain),
    "new-domain": (NewDomainConfig, new_domain),
    "export-dataset": (ExportDatasetConfig, export_dataset),
}
"""Name on the command line -> its settings and what runs with them."""

DESCRIPTION = """A robot that learns from its own failures: it trains in simulation, discovers the concepts that \
say when its skills fail, plans with them, and deploys.

Every command takes -v (--verbose) to log at debug level. --version prints the version."""

BAD_INPUT, FAULT, SIGNALLED, UNREAD = 2, 3, 128, 141
"""Exit codes; 0 is success, 1 a defect of this program. FAULT: of the machine, such as a full disk. To SIGNALLED the
signal's number is added, as a shell does; UNREAD is that of SIGPIPE."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one sub-command and return its exit code.

    It ends quietly where the reader of its output has left (`| head`), and with one message where a disk is full.
    """
    for output in (sys.stdout, sys.stderr):
        if isinstance(output, TextIOWrapper):
            # What the terminal's encoding has no sign for is no reason to end.
            output.reconfigure(errors="backslashreplace")
    code = 0
    try:
        try:
            code = _run(argv)
        except SystemExit:
            # Flushed here and below: the interpreter, at its end, would report a closed pipe on its own.
            print(end="", flush=True)
            raise
        print(end="", flush=True)
        return code
    except SystemExit as end:
        # Rich answers a closed pipe by this, with code 1.
        if not isinstance(end.__context__, BrokenPipeError):
            raise
        code, lost = UNREAD, _unread()
    except Exception as error:
        # A closed pipe, or a terminal that is gone, which SIGHUP tells first. A worker's pipe breaks with the same
        # error, and that is a defect to be seen.
        lost = _unread() if isinstance(error, OSError) else set()
        if lost:
            ended = ended_by(error) if isinstance(error, OSError) else None
            code = SIGNALLED + ended if ended is not None else (code if code > SIGNALLED else UNREAD)
        else:
            lost = _tell_disk_fault(error)
            code = FAULT
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for output in lost:
        # What is still buffered has to go somewhere when the interpreter ends.
        os.dup2(nowhere, output)
    return code


def _tell_disk_fault(error: Exception) -> set[int]:
    """Say which disk does not take what is written; which of standard output and error lie on it. Raises all else."""
    fault = disk_fault(error)
    if fault is None:
        raise error
    # An error of a file has its name.
    lost = {1} if isinstance(error, OSError) and not error.filename and not _takes_lines(sys.stdout) else set()
    if lost:
        fault = DiskError("cannot write standard output", "free some space where it goes, or send it elsewhere")
    if not _takes_lines(sys.stderr, f"error: {fault}"):
        lost.add(2)
    return lost


def _takes_lines(output: TextIO, line: str = "") -> bool:
    try:
        print(line, file=output, flush=True)
    except OSError:
        return False
    return True


def _unread() -> set[int]:
    """Which of standard output and error are pipes whose reader has left."""
    poll = select.poll()
    for output in (1, 2):
        poll.register(output, 0)
    return {output for output, event in poll.poll(0) if event & (select.POLLERR | select.POLLHUP)}


def _run(argv: Sequence[str] | None) -> int:
    args = list(sys.argv[1:] if argv is None else argv)
    if args == ["--version"]:
        print(f"resync-robot {__version__}")
        return 0
    verbose = {"-v", "--verbose"} & set(args)
    log_to_stderr(logging.DEBUG if verbose else logging.INFO)
    try:
        refuse_empty(args)
        refuse_missing([a for a in args if a not in verbose])
        # Some settings refuse values as soon as they are read.
        config = tyro.extras.subcommand_cli_from_dict(
            {name: settings for name, (settings, _) in COMMANDS.items()},
            prog="resync-robot",
            description=DESCRIPTION,
            args=name_rig(gather(gather([a for a in args if a not in verbose], "--library"), "--fault")),
            config=(tyro.conf.FlagCreatePairsOff, tyro.conf.DisallowNone, tyro.conf.OmitSubcommandPrefixes),
        )
        run = next(function for settings, function in COMMANDS.values() if settings is type(config))
        with raised():
            return run(config) or 0
    except ResyncError as error:
        print(f"error: {error}", file=sys.stderr)
        return FAULT if isinstance(error, DiskError) else BAD_INPUT
    except KeyboardInterrupt as end:
        number = number_of(end)
        # The terminal may have gone, which is what SIGHUP says.
        with suppress(OSError):
            print(words_for(number), file=sys.stderr)
        return SIGNALLED + number


def refuse_empty(args: Sequence[str]) -> None:
    """No setting has an empty value; a path of no letters would be the current folder. Raises ConfigError."""
    of = "the first word"
    for arg in args:
        option, equals, value = arg.partition("=") if arg.startswith("--") else (of, "=", arg)
        if equals and not value.strip():
            raise ConfigError(f"{option} is empty", "give it a value, or leave it out")
        of = of if of.startswith("-") and not arg.startswith("-") else option if arg.startswith("-") else arg


def refuse_missing(args: Sequence[str]) -> None:
    """What stands alone and needs more: the parser's own words for it do not say what to type. Raises ConfigError."""
    kinds = get_args(get_type_hints(CalibrateConfig)["what"])
    if args[:1] == ["calibrate"] and (len(args) == 1 or (args[1].startswith("-") and args[1] not in ("-h", "--help"))):
        raise ConfigError(
            "calibrate needs a word for what to do: board, intrinsics, hand-eye, check, noise or hues",
            "start with  resync-robot calibrate board;  resync-robot calibrate --help  says what each does",
        )
    files = {
        f"--{field.name.replace('_', '-')}"
        for settings in (kinds if args[:1] == ["calibrate"] else [COMMANDS[w][0] for w in args[:1] if w in COMMANDS])
        for field in fields(settings)
        if "Path" in str(field.type)
    }
    for option, value in pairwise([*args, "--"]):
        if option in files and value.startswith("--"):
            raise ConfigError(f"{option} needs the name of a file or folder", f"write it behind: {option} NAME")


def gather(args: Sequence[str], option: str) -> list[str]:
    """Make one `option A B` of `option A ... option B`: the parser would silently keep the last one only."""
    kept: list[str] = []
    values: list[str] = []
    target = kept
    for arg in args:
        if arg == option:
            target = values
        elif arg.startswith(f"{option}="):
            values.append(arg.removeprefix(f"{option}="))
        else:
            target = kept if arg.startswith("-") else target
            target.append(arg)
    return kept if option not in args and not values else [*kept, option, *values]


def name_rig(args: Sequence[str]) -> list[str]:
    """`--rig emulated` is the file of that rig which comes with this package."""
    given, before = [], ""
    for arg in args:
        name = arg.removeprefix("--rig=") if arg.startswith("--rig=") else arg if before == "--rig" else ""
        packaged = packaged_rig(name)
        given.append(arg if packaged is None else arg.removesuffix(name) + str(packaged))
        before = arg
    return given


def log_to_stderr(level: int) -> None:
    """Log this project's messages; those of other packages from warnings on."""
    logging.basicConfig(format="%(levelname)s %(name)s: %(message)s", level=logging.WARNING, stream=sys.stderr)
    logging.getLogger("resync_robot").setLevel(level)
