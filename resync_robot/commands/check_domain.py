"""The contract suite for domains, as a command: what a domain that somebody wrote still lacks."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from resync_robot.core.options import DEFAULT_DOMAIN
from resync_robot.given import Given

if TYPE_CHECKING:
    from resync_robot.core.task import Domain

EACH = 4
"""Worlds of a scenario on the contact sheet."""
MOST_WORLDS = 1000


@dataclass(frozen=True, kw_only=True)
class CheckDomainConfig:
    """Check that a domain keeps its contract: its parts fit, its scenes stand, its failures can be learned from."""

    domain: tyro.conf.Positional[str] = DEFAULT_DOMAIN
    """The domain: a name, a file (path.py or path.py:NAME), or package.module:NAME."""

    worlds: int = 20
    """Worlds of each scenario that are tried."""

    sheet: Given[Path] = None
    """PNG file for a contact sheet: a few worlds of each scenario."""

    json: bool = False
    """Print the findings as JSON."""


def check_domain(config: CheckDomainConfig) -> int:
    """Print what was found; the exit code is 2 where something fails, else 0.

    Raises:
        ResyncError: there is no such domain, or its file cannot be loaded.
    """
    from resync_robot.console import say, show_findings
    from resync_robot.core.files import PNG, check_output
    from resync_robot.core.options import check_range
    from resync_robot.sim_training.domain_checks import examine
    from resync_robot.sim_training.domains import DOMAINS
    from resync_robot.sim_training.domains.finding import open_domain

    check_range("--worlds", config.worlds, 1, MOST_WORLDS)
    if config.sheet is not None:
        check_output(config.sheet, PNG, option="--sheet")
    domain = with_robot(open_domain(config.domain, DOMAINS))
    findings = []
    for finding in examine(domain, config.worlds):
        findings.append(finding)
        if not config.json:
            show_findings([finding], width=29)
    healthy = not any(f.status == "fail" for f in findings)
    if config.json:
        sys.stdout.write(json.dumps({"healthy": healthy, "findings": [asdict(f) for f in findings]}, indent=2) + "\n")
    if config.sheet is not None and healthy:
        _draw_sheet(domain, config.sheet)
        say(f"Contact sheet: {config.sheet}")
    return 0 if healthy else 2


def with_robot(domain: Domain) -> Domain:
    """The same with the simulated arm, where it brings no robot and the arm has a skill for each of its operators."""
    from dataclasses import replace

    from resync_robot.core.domain_faults import faults
    from resync_robot.core.rig import load_rig
    from resync_robot.policies.given_skills import given_skills

    if domain.embodiment is not None or list(faults(domain)):
        return domain
    rig = load_rig()
    if {s.name for s in given_skills(rig, domain.operators)} != {o.name for o in domain.operators}:
        return domain
    from resync_robot.library_models import embodiment_of

    return replace(domain, embodiment=embodiment_of(domain, rig))


def _draw_sheet(domain: Domain, path: Path) -> None:
    """A row of worlds for each scenario, its name and what it is about above it."""
    import io

    import numpy as np
    from PIL import Image, ImageDraw

    from resync_robot.core.errors import ConfigError
    from resync_robot.core.files import write_bytes
    from resync_robot.figures import fitting, font

    if domain.embodiment is None:
        raise ConfigError(f"{domain.name} has no simulator of its own to draw with", "leave --sheet out")
    rows = []
    for name, scenario in domain.scenarios.items():
        tasks = [scenario.sample(np.random.default_rng(seed), seed) for seed in range(EACH)]
        worlds = np.hstack([np.pad(domain.embodiment.simulate(t).picture(), ((0, 8), (0, 8), (0, 0))) for t in tasks])
        title = Image.new("RGB", (worlds.shape[1], 26), "black")
        words = fitting(f"{name}: {scenario.description}", worlds.shape[1] - 12, font(16))
        ImageDraw.Draw(title).text((6, 3), words, "white", font(16))
        rows += [np.asarray(title), worlds]
    data = io.BytesIO()
    Image.fromarray(np.vstack(rows)).save(data, "PNG")
    write_bytes(path, data.getvalue())
