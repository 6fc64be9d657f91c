"""Domains from anywhere: by name, by file, by module."""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import re
import sys
import traceback
from collections.abc import Mapping
from dataclasses import replace
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType

from resync_robot.core.domain_faults import faults
from resync_robot.core.errors import ConfigError, UnknownNameError
from resync_robot.core.task import Domain

GROUP = "resync_robot.domains"
"""Entry points of this group are domains that other packages bring."""
GUIDE = "docs/own-domain.md says how one is written"
USUAL_NAME = "DOMAIN"


def load_domain(spec: str, shipped: Mapping[str, Domain]) -> Domain:
    """The domain that `spec` names: NAME, path.py[:NAME] or package.module:NAME.

    Raises:
        UnknownNameError: there is no domain of that name.
        ConfigError: a file or module cannot be used, or its domain has a fault.
    """
    if spec in shipped:
        return shipped[spec]
    found = open_domain(spec, shipped)
    for what, fix in faults(found):
        raise ConfigError(f"{spec}: {what}", f"{fix}; for all that is wrong: resync-robot check-domain {spec}")
    return replace(found, spec=lasting_spec(spec))


def open_domain(spec: str, shipped: Mapping[str, Domain]) -> Domain:
    """The same, whatever is wrong with its parts."""
    path, name = _file_and_name(spec)
    others = {e.name: e for e in entry_points(group=GROUP)}
    if path is not None:
        found = _pick(_from_file(path), name, str(path))
    elif name is not None:
        found = _pick(_from_module(spec.partition(":")[0]), name, spec.partition(":")[0])
    elif spec in shipped:
        return shipped[spec]
    elif spec in others:
        found = _from_package(others[spec])
    elif "/" in spec or Path(spec).exists():
        raise ConfigError(f"'{spec}' is no domain: the file of one ends in .py", GUIDE)
    else:
        raise UnknownNameError("domain", spec, [*shipped, *others])
    if not isinstance(found, Domain):
        raise ConfigError(f"{spec}: {name or USUAL_NAME} is of type {type(found).__name__}, and no Domain", GUIDE)
    return found


def lasting_spec(spec: str) -> str:
    """The same, so that it can be read from any folder: what a run keeps, and what goes to other processes."""
    path, name = _file_and_name(spec)
    return spec if path is None else f"{path.resolve()}" + (f":{name}" if name else "")


def _file_and_name(spec: str) -> tuple[Path | None, str | None]:
    """(path, name) of a file, (None, name) of a module, (None, None) of what is only a name."""
    if match := re.fullmatch(r"(.+\.py)(?::(\w+))?", spec):
        return Path(match[1]).expanduser(), match[2]
    if match := re.fullmatch(r"[\w.]+:(\w+)", spec):
        return None, match[1]
    return None, None


def _from_file(path: Path) -> ModuleType:
    if path.is_dir():
        raise ConfigError(f"{path} is a folder, and should be the file of a domain", GUIDE)
    if not path.is_file():
        raise ConfigError(f"there is no file {path}", f"check the path; {GUIDE}")
    # The same in every process, so that what one of them pickles another can read.
    name = f"domain_file_{hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:16]}"
    if name in sys.modules:
        return sys.modules[name]
    made = importlib.util.spec_from_file_location(name, path)
    if made is None or made.loader is None:
        raise ConfigError(f"{path} cannot be loaded", GUIDE)
    module = importlib.util.module_from_spec(made)
    sys.modules[name] = module
    try:
        made.loader.exec_module(module)
    except BaseException as error:
        del sys.modules[name]
        raise _unloadable(str(path), error, str(path)) from error
    return module


def _from_module(name: str) -> ModuleType:
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name is not None and (name == error.name or name.startswith(f"{error.name}.")):
            raise ConfigError(f"there is no module {name}", "install it, or put its folder on PYTHONPATH") from None
        raise _unloadable(f"module {name}", error) from error
    except BaseException as error:
        raise _unloadable(f"module {name}", error) from error


def _from_package(entry: EntryPoint) -> object:
    try:
        return entry.load()
    except BaseException as error:
        raise _unloadable(f"domain '{entry.name}' ({entry.value})", error) from error


def _unloadable(where: str, error: BaseException, path: str = "") -> Exception:
    """In one sentence, with the line of the file where it has one; a Ctrl-C stays what it is."""
    if isinstance(error, KeyboardInterrupt):
        return error  # type: ignore[return-value]
    if isinstance(error, SyntaxError):
        return ConfigError(f"{where}, line {error.lineno}: {error.msg}", "correct that line")
    lines = [f.lineno for f in traceback.extract_tb(error.__traceback__) if f.filename == path]
    line = f", line {lines[-1]}" if lines else ""
    words = " ".join(str(error).split()) or type(error).__name__
    return ConfigError(f"{where}{line}: {type(error).__name__}: {words}", f"mend that; {GUIDE}")


def _pick(module: ModuleType, name: str | None, where: str) -> object:
    there = [n for n, value in vars(module).items() if isinstance(value, Domain)]
    if name is not None:
        if not hasattr(module, name):
            raise ConfigError(f"{where} has no '{name}'", f"domains in it: {', '.join(there) or 'none'}")
        return getattr(module, name)
    if hasattr(module, USUAL_NAME):
        return getattr(module, USUAL_NAME)
    if len(there) == 1:
        return getattr(module, there[0])
    if not there:
        raise ConfigError(f"{where} holds no Domain", f"write {USUAL_NAME} = Domain(...); {GUIDE}")
    raise ConfigError(f"{where} holds several domains: {', '.join(there)}", f"say which: {where}:{there[0]}")
