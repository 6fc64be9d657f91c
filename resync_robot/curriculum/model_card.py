"""The model card of a library's camera policy: policies/NAME/README.md, with the front matter that Hugging Face reads.

`python -m resync_robot.curriculum.model_card LIBRARY` writes it anew; training writes it with the library.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from resync_robot import policies
from resync_robot.core.damage import Shape, check_shape
from resync_robot.core.errors import LibraryError
from resync_robot.core.intervals import wilson
from resync_robot.core.library import CARD, RETRAIN, Library, load_library, save_library
from resync_robot.core.task import Domain
from resync_robot.learning.camera_view import ACTION_NAMES, RATE_HZ, SPAN, STATE_NAMES, VIEWS

FRONT_MATTER = """---
license: apache-2.0
library_name: lerobot
pipeline_tag: robotics
tags:
- robotics
- lerobot
- diffusion-policy
- manipulation
- simulation
- failure-recovery
datasets:
- local/recoveries
---
"""
"""The dataset has the name that LeRobot knows it by; it lies in the run's folder and on no hub."""


def with_card(library: Library, domain: Domain) -> Library:
    """The library with a card beside the recovery's camera policy; as it is where it holds none.

    Raises:
        LibraryError: the policy is not one of LeRobot's diffusion policies with three views, joints and a scan.
    """
    files = library.policies.get(domain.recovery)
    if files is None:
        return library
    card = card_text(library, domain, files).encode()
    return replace(library, policies={**library.policies, domain.recovery: {**files, CARD: card}})


def card_text(library: Library, domain: Domain, files: Mapping[str, bytes]) -> str:
    """What a stranger should know before they use the policy, as Markdown."""
    config = _config(files)
    figures = next((s.figures for s in library.stages if s.recovery == domain.recovery), {}).get("distil", {})
    sections = [
        f"# {domain.recovery} by camera, {domain.name}",
        f"*{domain.instruction}* A diffusion policy that LeRobot runs, trained in simulation alone by "
        "resync-robot: a robot that learns from its failures. It imitates a policy that knows the exact state, from "
        "three pictures, the joints, and what a scan of the scene has measured.",
        _inputs(config),
        _loading(config, domain.recovery),
        _training(library.provenance, figures),
        _trials(figures),
        LIMITS,
    ]
    return FRONT_MATTER + "\n" + "\n\n".join(s for s in sections if s) + "\n"


LIMITS = f"""## Limits

- It has been trained and tried in simulation only; no real arm has run it.
- It knows the cameras of its rig: `resync.json` says where each stands and how much it shows. Where one has moved by
  more than 15 mm or 2 degrees, resync-robot refuses the policy. Stock LeRobot does not look.
- It moves the hand and nothing else. The guards of a deployment (limits, forces, a block that leans, cameras that are
  black, frozen or exchanged) are resync-robot's and not in these files.
- It begins where the hand stands above the block, after a scan, and each picture is a window of {SPAN} m about the
  finger tips: `learning/camera_view.py` of resync-robot cuts it. Whole pictures mean nothing to it.
- resync-robot starts the diffusion from no noise, so that the same picture gives the same, most likely motion;
  `select_action` draws noise.
- `heads.safetensors` (is it done, where is the block) is ours, and LeRobot does not read it."""


def _inputs(config: Mapping[str, Any]) -> str:
    pictures = config["input_features"][f"observation.images.{VIEWS[0]}"]["shape"]
    states = config["input_features"]["observation.state"]["shape"][0]
    rows = [
        (f"`observation.images.{{{', '.join(VIEWS)}}}`", pictures, "RGB in [0, 1], a window about the finger tips"),
        ("`observation.state`", [states], ", ".join(STATE_NAMES[:states])),
        ("`action`", [len(ACTION_NAMES)], f"{', '.join(ACTION_NAMES)}: the next step of the hand, in its own axes"),
    ]
    table = "\n".join(f"| {name} | {'x'.join(map(str, shape))} | {what} |" for name, shape, what in rows)
    return (
        f"## Inputs and outputs\n\n| name | shape | what |\n|---|---|---|\n{table}\n\n"
        f"Metres and radians, {RATE_HZ:g} steps a second, {config['horizon']} steps a chunk. The two processors' files "
        "normalise what goes in and undo it for what comes out."
    )


def _loading(config: Mapping[str, Any], name: str) -> str:
    # A trunk of our own is found by torchvision's name for it, once it has been put there.
    ours = "resync" in config["vision_backbone"]
    trunk, package = f"{policies.__name__}.trunk", policies.__name__
    lines = [
        f"import {trunk}  # the one import: its picture trunk is resync-robot's" if ours else "",
        "from lerobot.policies.diffusion.modeling_diffusion import DiffusionPolicy",
        "from lerobot.policies.factory import make_pre_post_processors",
        "",
        f'folder = "policies/{name}"',
        "policy = DiffusionPolicy.from_pretrained(folder)",
        "before, after = make_pre_post_processors(policy.config, pretrained_path=folder)",
        "action = after(policy.select_action(before(observation)))",
    ]
    code = "\n".join(lines if ours else lines[1:])
    words = f"## Loading it\n\n```python\n{code}\n```"
    if ours:
        words += (
            f"\n\nWithout that import LeRobot says that torchvision has no `{config['vision_backbone']}`. LeRobot's "
            f"commands take `--policy.discover_packages_path={package}` for it."
        )
    return words


def _training(provenance: Mapping[str, Any], figures: Mapping[str, Any]) -> str:
    known = [
        f"{title} {provenance[key]}"
        for key, title in (("preset", "preset"), ("seed", "seed"), ("version", "resync-robot"), ("git", "commit"))
        if key in provenance
    ]
    packages = provenance.get("packages", {})
    known += [f"{name} {packages[name]}" for name in ("lerobot", "torch", "sapien") if name in packages]
    if "frames" in figures:
        known.append(f"{figures['frames']} frames of {figures['segments']} demonstrations")
    words = (
        "## Training\n\nRendered demonstrations of the state policy, then rounds in which this policy drives first and "
        "the state policy goes on from wherever that leads. Lamps, shadows, surfaces, exposure, sizes, friction, "
        "delays and errors of calibration are drawn anew for each."
    )
    return f"{words}\n\nMade with: {', '.join(known)}." if known else words


def _trials(figures: Mapping[str, Any]) -> str:
    try:
        check_shape(figures, {"points": [{"step": int, "worlds": int, "success": int}], "chosen": int})
    except ValueError:
        return ""
    rows = []
    for point in figures["points"]:
        low, high = wilson(point["success"], point["worlds"])
        mark = ", kept" if point["step"] == figures["chosen"] else ""
        rows.append(f"| {point['step']}{mark} | {point['success']} of {point['worlds']} [{low:.2f}, {high:.2f}] |")
    return (
        "## Trials\n\nIn simulated worlds held out from training, from starts where the block is stuck: recovered at "
        "the first attempt, by its own word and in truth, with Wilson 95 % intervals.\n\n"
        "| step | recovered |\n|---|---|\n" + "\n".join(rows)
    )


def _config(files: Mapping[str, bytes]) -> Any:
    pictures = {f"observation.images.{view}": {"shape": list} for view in VIEWS}
    shape: Shape = {"input_features": pictures, "horizon": int, "vision_backbone": str}
    try:
        config = json.loads(files["config.json"])
        check_shape(config, shape)
    except (KeyError, ValueError) as error:
        raise LibraryError(f"the camera policy has no config.json that LeRobot would read: {error}", RETRAIN) from None
    return config


def main(folder: Path) -> None:
    """Write the card of the library in this folder anew. Raises LibraryError, UnknownNameError or DiskError."""
    from resync_robot.sim_training.domains import find_domain

    library = load_library(folder)
    save_library(with_card(library, find_domain(library.domain)), folder)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
