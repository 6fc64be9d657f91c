"""Domains by name. To add one, write its file and name it here."""

from __future__ import annotations

from resync_robot.core.errors import UnknownNameError
from resync_robot.core.task import Domain
from sim_training.domains.cornered_insertion_s import CORNERED_INSERTION_S

DOMAINS: dict[str, Domain] = {CORNERED_INSERTION_S.name: CORNERED_INSERTION_S}


def find_domain(name: str) -> Domain:
    """The domain of that name. Raises UnknownNameError, which lists the valid ones."""
    if name not in DOMAINS:
        raise UnknownNameError("domain", name, list(DOMAINS))
    return DOMAINS[name]
