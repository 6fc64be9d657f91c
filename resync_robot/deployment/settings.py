"""What a deployment is told on the command line."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from resync_robot.core.options import DEFAULT_DOMAIN
from resync_robot.given import Given


@dataclass(frozen=True, kw_only=True)
class DeployConfig:
    """Let a robot, simulated or real, reach a goal with what a library knows.

    A domain with a robot of its own runs in its own simulator, without rig and cameras."""

    backend: Literal["sim", "ur7e", "replay"] = "sim"
    """The robot, gripper and cameras to use. Everything above them is the same code."""

    library: Given[Path] = None
    """Library folder that train-sim wrote. Default: the shipped one of the domain."""

    domain: str = DEFAULT_DOMAIN
    """The domain whose objects and skills are used: a name, a file (path.py or path.py:NAME), or
    package.module:NAME."""

    replay: Given[Path] = None
    """The recording that --backend replay runs over: the same executive, told what was measured and seen then.
    Scenario, goal, seed, and how it was perceived are those of the recording."""

    scenario: Annotated[str, tyro.conf.arg(help_behavior_hint="")] = ""
    """Where the objects of a simulated episode lie, and the goal unless --goal is given. Default: the domain's first
    test, such as s1."""

    goal: Given[str] = None
    """The goal as atoms, such as "On(b1,b0)". Default: that of the scenario."""

    seed: int = 0
    """Seed of the simulated worlds; the first episode's world depends on nothing else."""

    episodes: int = 1
    """How many episodes to run, each in a world of its own."""

    perception: Literal["auto", "camera", "oracle"] = "auto"
    """Where poses come from: RGB-D pictures, or the simulator's own state. auto: pictures, where the robot has
    cameras."""

    skills: Literal["auto", "camera", "state"] = "auto"
    """What the learned skills see while they run: pictures, joints and the scan, or the simulator's state. auto:
    pictures, where poses come from the camera too and the library holds a camera policy that recovered in at least
    half of its trials."""

    segmenter: Literal["colour", "sam3"] = "colour"
    """What finds the blocks in pictures: their hues, or SAM 3 by the prompts of the rig file."""

    dry_run: bool = False
    """Look, ground and plan, and print the plan, but move no skill."""

    pddl: Given[Path] = None
    """Folder for domain.pddl and problem.pddl: what a --dry-run planned from, for other planners."""

    confirm: bool = False
    """Ask before each step of the plan."""

    record_pictures: Given[float] = None
    """How often the recording films what each camera sees while the robot moves, Hz; 0: not at all. Default: 10 where
    cameras stream or a domain's own simulator draws itself, 2 with --backend sim and 1 on an emulated rig, where every
    picture has to be rendered."""

    out: Given[Path] = None
    """Folder of the recordings. Default: runs/DATE-deploy."""

    rig: Given[Path] = None
    """The facts of the machine, a TOML file. Default: the rig that the simulation assumes."""
