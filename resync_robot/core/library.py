"""The library: everything the stages of training learned so far, as one folder of open files.

    library/
      library.json          version, domain, rig hash, list of files with their SHA-256
      domain.pddl           types, predicates, operators
      stages/1-NAME.json    for each stage, in the order learned: the recovery, the scenario it began from, the failure
                            that it mends with its pair Gaussians, and figures of its training
      predicates/NAME.json  signature, stage, form, effects;  NAME.safetensors  classifier weights
      skills/NAME.json      signature, settings;              NAME.safetensors  policy and terminal weights
      policies/NAME/        the skill's camera policy, where one was trained: a LeRobot checkpoint, as LeRobot wrote it,
                            and its model card, README.md
      execution.json        other names of skills, and how practice went
      provenance.json       git hash, seeds, versions of the run that learned the last stage

Loading checks the version, every file's hash and every record; nothing is unpickled.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load as load_tensors
from safetensors.numpy import save as save_tensors

from resync_robot.core.damage import PULL, Shape, check_shape, is_pointer
from resync_robot.core.errors import LibraryError
from resync_robot.core.files import unwritable, whole_folder

VERSION = 3
"""3: several stages, each with its own failure; effect vectors; several learned atoms that a skill relies on."""
CARD = "README.md"
"""The model card of a policy, in its folder."""
RETRAIN = "train a new one: resync-robot train-sim --domain cornered-insertion-s"


@dataclass(frozen=True)
class Record:
    """One learned thing: plain JSON `meta` and named weight arrays (float32)."""

    meta: Mapping[str, Any]
    tensors: Mapping[str, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class LearnedFailure:
    """What a stage learned about the failure of a skill.

    Attributes:
        skill: the skill that failed (C^F).
        argument: which of its arguments the failure is about (o^R); None where that is another object.
        objects: those that caused it (o^F), one or more: name -> name of the type.
        before, after: for each of them, by its name, the pair Gaussian of how it and o^R lie beside each other when the
            skill fails, and after the recovery; as plain data.
        relevant: name of the type of o^R; empty in libraries of earlier versions, where it is that of the argument.
    """

    skill: str
    argument: int | None
    objects: Mapping[str, str]
    before: Mapping[str, Any]
    after: Mapping[str, Any]
    relevant: str = ""


@dataclass(frozen=True, kw_only=True)
class LearnedStage:
    """One stage: a failure, and the recovery that mends it, whose record is among the library's skills.

    Attributes:
        scenario: in which the failure was met.
        figures: step of the training -> how it went, durations included.
    """

    recovery: str
    scenario: str
    failure: LearnedFailure
    figures: Mapping[str, Any] = field(default_factory=dict)


STAGE: Shape = {
    "recovery": str,
    "scenario": str,
    "failure": {"skill": str, "argument": (int, type(None)), "objects": dict, "before": dict, "after": dict},
    "figures": dict,
}
"""The fields of stages/1-NAME.json."""


@dataclass(frozen=True)
class Library:
    """What training learned, as data; the rooms that know how to use a record rebuild the live object.

    Attributes:
        stages: in the order learned.
        predicates, skills: by name; `skills` are the recoveries.
    """

    domain: str
    rig_hash: str
    domain_pddl: str
    predicates: Mapping[str, Record]
    skills: Mapping[str, Record]
    stages: tuple[LearnedStage, ...]
    provenance: Mapping[str, Any]
    execution: Mapping[str, Any] = field(default_factory=dict)
    policies: Mapping[str, Mapping[str, bytes]] = field(default_factory=dict)
    """By skill: file name -> content."""
    types_hash: str = ""
    """Of the domain's types (`Domain.types_hash`); empty in a library that was saved without."""

    @property
    def content_hash(self) -> str:
        """SHA-256 over what decides behaviour: everything but provenance (which holds dates and durations) and model
        cards (which are for people), and figures of the stages."""
        digest = hashlib.sha256()
        without_figures = replace(self, stages=tuple(replace(s, figures={}) for s in self.stages))
        for name, data in sorted(_files(without_figures).items()):
            if name != "provenance.json" and not (name.startswith("policies/") and name.endswith(f"/{CARD}")):
                digest.update(name.encode() + b"\0" + data)
        return digest.hexdigest()

    def stage(self, recovery: str) -> LearnedStage:
        """The stage that learned this recovery. Raises LibraryError where there is none."""
        for stage in self.stages:
            if stage.recovery == recovery:
                return stage
        raise LibraryError(f"the library holds no skill '{recovery}'", RETRAIN)


def save_library(library: Library, folder: Path) -> None:
    """Write beside `folder` and swap, so that a kill or a full disk leaves the old library or the new one.

    Raises:
        LibraryError: the folder cannot be written, or is there and is no library.
        DiskError: there is no room for it.
    """
    if folder.exists() and not (folder / "library.json").is_file() and any(folder.iterdir()):
        raise LibraryError(f"{folder} exists and is no library; it is left as it is", "give another folder with --out")
    contents = _files(library)
    manifest = {
        "version": VERSION,
        "domain": library.domain,
        "rig_hash": library.rig_hash,
        "types_hash": library.types_hash,
        "content_hash": library.content_hash,
        "files": {name: hashlib.sha256(data).hexdigest() for name, data in sorted(contents.items())},
    }
    try:
        with whole_folder(folder) as beside:
            for name, data in {**contents, "library.json": _json(manifest)}.items():
                path = beside / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(data)
    except OSError as error:
        fix = "give another folder with --out"
        raise unwritable(f"the library {folder}", error, fix, LibraryError) from None


def load_library(folder: Path) -> Library:
    """Read and verify a library folder.

    Raises:
        LibraryError: missing, of another version, truncated, or altered; the message names the file.
    """
    manifest = _read_json(folder, "library.json")
    if not isinstance(manifest, dict) or manifest.get("version") != VERSION:
        found = manifest.get("version") if isinstance(manifest, dict) else None
        raise LibraryError(
            f"{folder} is a library of version {found}, this program reads version {VERSION}",
            f"leave out --library, for the one that comes with the program, or {RETRAIN}",
        )
    listed = manifest.get("files")
    if not isinstance(listed, dict) or not {
        "domain.pddl",
        "execution.json",
        "provenance.json",
    } <= set(listed):
        raise LibraryError(f"{folder / 'library.json'} has no full list of files", RETRAIN)
    contents: dict[str, bytes] = {}
    for name, digest in listed.items():
        if not isinstance(name, str) or ".." in Path(name).parts or Path(name).is_absolute():
            raise LibraryError(f"{folder / 'library.json'} lists a file outside the library: {name!r}", RETRAIN)
        data = _read(folder, name)
        if hashlib.sha256(data).hexdigest() != digest:
            raise _altered(folder / name, data, digest)
        contents[name] = data
    try:
        domain, rig_hash = str(manifest["domain"]), str(manifest["rig_hash"])
    except KeyError as error:
        raise LibraryError(f"{folder / 'library.json'} has no field {error}", RETRAIN) from None
    return Library(
        domain=domain,
        rig_hash=rig_hash,
        domain_pddl=contents["domain.pddl"].decode(),
        predicates=_records(folder, contents, "predicates"),
        skills=_records(folder, contents, "skills"),
        stages=_stages(folder, contents),
        provenance=_parse(folder, "provenance.json", contents["provenance.json"]),
        execution=_parse(folder, "execution.json", contents["execution.json"]),
        policies=_policies(contents),
        types_hash=str(manifest.get("types_hash", "")),
    )


def _altered(path: Path, data: bytes, digest: str) -> LibraryError:
    """What became of a file that hashes to something else than `digest`."""
    if hashlib.sha256(data.replace(b"\r\n", b"\n")).hexdigest() == digest:
        return LibraryError(
            f"the line ends of {path} were changed (CR LF for LF), as git does with core.autocrlf",
            f"write '{path.name} -text' into a .gitattributes beside it, remove the file, and: git checkout -- {path}",
        )
    return LibraryError(f"{path} was truncated or altered since it was saved", f"copy it here anew, or {RETRAIN}")


def _files(library: Library) -> dict[str, bytes]:
    contents = {
        "domain.pddl": library.domain_pddl.encode(),
        "execution.json": _json(library.execution),
        "provenance.json": _json(library.provenance),
    }
    for i, stage in enumerate(library.stages, start=1):
        contents[f"stages/{i}-{stage.recovery}.json"] = _json(asdict(stage))
    for room, records in (("predicates", library.predicates), ("skills", library.skills)):
        for name, record in records.items():
            contents[f"{room}/{name}.json"] = _json(record.meta)
            if record.tensors:
                arrays = {k: np.ascontiguousarray(v) for k, v in sorted(record.tensors.items())}
                contents[f"{room}/{name}.safetensors"] = save_tensors(arrays)
    for skill, files in library.policies.items():
        contents |= {f"policies/{skill}/{name}": data for name, data in files.items()}
    return contents


def _stages(folder: Path, contents: Mapping[str, bytes]) -> tuple[LearnedStage, ...]:
    found: dict[str, LearnedStage] = {}
    for name in contents:
        if name.startswith("stages/"):
            number, _, recovery = name.removeprefix("stages/").removesuffix(".json").partition("-")
            try:
                found[number] = _stage(_parse(folder, name, contents[name]), recovery)
            except ValueError as error:
                raise LibraryError(f"{folder / name} is no stage: {error}", RETRAIN) from None
    numbers = [str(i + 1) for i in range(len(found))]
    if set(found) != set(numbers):
        raise LibraryError(f"{folder / 'stages'} holds {', '.join(sorted(found))}, and should count from 1", RETRAIN)
    return tuple(found[n] for n in numbers)


def _stage(saved: Any, recovery: str) -> LearnedStage:
    check_shape(saved, STAGE)
    told = saved["failure"]
    failure = LearnedFailure(**{f.name: told[f.name] for f in fields(LearnedFailure) if f.name in told})
    if saved["recovery"] != recovery:
        raise ValueError(f"it is about {saved['recovery']}")
    if not failure.objects or not set(failure.objects) == set(failure.before) == set(failure.after):
        raise ValueError("it does not have a Gaussian before and after for each object of the failure")
    return LearnedStage(recovery=recovery, scenario=saved["scenario"], failure=failure, figures=saved["figures"])


def _policies(contents: Mapping[str, bytes]) -> dict[str, dict[str, bytes]]:
    found: dict[str, dict[str, bytes]] = {}
    for path, data in contents.items():
        room, *rest = Path(path).parts
        if room == "policies" and len(rest) == 2:
            found.setdefault(rest[0], {})[rest[1]] = data
    return found


def _records(folder: Path, contents: Mapping[str, bytes], room: str) -> dict[str, Record]:
    records = {}
    for name in sorted(contents):
        if name.startswith(f"{room}/") and name.endswith(".json"):
            stem = name.removesuffix(".json")
            weights = contents.get(f"{stem}.safetensors")
            try:
                tensors = load_tensors(weights) if weights is not None else {}
            except SafetensorError as error:
                raise LibraryError(f"{folder / stem}.safetensors cannot be read: {error}", RETRAIN) from None
            records[stem.removeprefix(f"{room}/")] = Record(_parse(folder, name, contents[name]), tensors)
    return records


def _json(data: Any) -> bytes:
    return (json.dumps(data, indent=2, sort_keys=True) + "\n").encode()


def _parse(folder: Path, name: str, data: bytes) -> Any:
    try:
        return json.loads(data)
    except (ValueError, UnicodeDecodeError) as error:
        raise LibraryError(f"{folder / name} is no valid JSON: {error}", RETRAIN) from None


def _read(folder: Path, name: str) -> bytes:
    try:
        data = (folder / name).read_bytes()
    except OSError as error:
        raise LibraryError(f"cannot read {folder / name}: {error.strerror}", RETRAIN) from None
    if is_pointer(data):
        raise LibraryError(f"{folder / name} is a Git LFS pointer and not the file itself", PULL)
    return data


def _read_json(folder: Path, name: str) -> Any:
    if not folder.is_dir():
        raise LibraryError(f"there is no library folder {folder}", RETRAIN)
    return _parse(folder, name, _read(folder, name))
