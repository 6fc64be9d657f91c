"""The contract suite for domains: the guide's domain keeps it, and each breach that is planted in it is named."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from resync_robot.core.findings import Finding
from resync_robot.core.state import State
from resync_robot.core.symbols import Object
from resync_robot.core.task import Domain, Task
from resync_robot.sim_training.domain_checks import examine
from resync_robot.sim_training.domains import find_domain
from tests.domains import PUCK_DOMAIN, puck

WORLDS = 4
GOOD = replace(PUCK_DOMAIN, scenarios={name: PUCK_DOMAIN.scenarios[name] for name in ("door", "open", "stone")})
"""Less of it, for the sake of time."""
BODY = GOOD.embodiment
assert BODY is not None


def test_the_guide_s_domain_keeps_it() -> None:
    found = list(examine(PUCK_DOMAIN, WORLDS))
    assert Counter(f.status for f in found) == {"ok": len(found)}, [f for f in found if f.status != "ok"]
    detail = {f.name: f.detail for f in found}
    assert detail["given model: door"] == f"fails in {WORLDS} of {WORLDS}, on door"
    assert detail["given model: stone"] == f"fails in {WORLDS} of {WORLDS}, on stone"


def test_a_domain_without_an_embodiment_is_looked_at_as_far_as_it_goes() -> None:
    whole = find_domain("cornered-insertion-s")
    found = list(examine(replace(whole, scenarios={name: whole.scenarios[name] for name in ("s0", "s3")}), 1))
    assert [f.name for f in found] == ["parts", "tasks: s0", "tasks: s3", "tasks: free", "simulator"]
    assert {f.status for f in found[:-1]} == {"ok"}
    assert found[-1].status == "warn" and "no embodiment" in found[-1].detail


class Forgetful(puck.Rooms):  # type: ignore[name-defined]
    def restore(self, snapshot: Any) -> None:
        theta = {o: leaf.theta for o, leaf in self._doors.items()}
        super().restore(snapshot)
        for obj, leaf in self._doors.items():
            leaf.theta = theta[obj]


class Inexact(puck.Rooms):  # type: ignore[name-defined]
    def restore(self, snapshot: Any) -> None:
        super().restore(snapshot)
        self._discs[self._robot].x += 1e-5


class Numb(puck.Rooms):  # type: ignore[name-defined]
    def contacts(self) -> Mapping[Object, float]:
        return {}


class Falling(puck.Rooms):  # type: ignore[name-defined]
    def reset(self, state: State) -> bool:
        return super().reset(state) and False


class Drifting(puck.Rooms):  # type: ignore[name-defined]
    def reset(self, state: State) -> bool:
        stands = super().reset(state)
        self._discs[self._robot].x += 0.1
        return stands


class Timeless(puck.Rooms):  # type: ignore[name-defined]
    def act(self, action: np.ndarray, duration: float) -> None:
        super().act(action, 0.0)


class Broken(puck.Rooms):  # type: ignore[name-defined]
    def act(self, action: np.ndarray, duration: float) -> None:
        super().act(action, duration)
        self._discs[self._robot].x = np.nan


class Blind(puck.Rooms):  # type: ignore[name-defined]
    def picture(self) -> np.ndarray:
        return super().picture() / 255


def simulated_by(rooms: type) -> Domain:
    return replace(GOOD, embodiment=replace(BODY, simulate=rooms))


def with_sample(name: str, sample: Any) -> Domain:
    scenario = replace(GOOD.scenarios[name], sample=sample, sample_practice=sample, sample_unseen=sample)
    return replace(GOOD, scenarios={**GOOD.scenarios, name: scenario})


def with_classifier(classifier: Any) -> Domain:
    return replace(GOOD, classifiers={**GOOD.classifiers, "At": classifier})


def opened(rng: np.random.Generator, seed: int) -> Task:
    return GOOD.scenarios["open"].sample(rng, seed)


def closed(rng: np.random.Generator, seed: int, counts: Any = None) -> Task:
    return GOOD.scenarios["door"].sample(rng, seed)


def skills_that_raise() -> tuple:
    raise ValueError("no\ngripper")


UNSEEDED = np.random.default_rng(0)


@pytest.mark.parametrize(
    ("domain", "finding"),
    [
        (replace(GOOD, name="Puck"), Finding("parts", "fail", "names folders")),
        (with_sample("open", lambda rng, seed: opened(UNSEEDED, seed)), Finding("tasks: open", "fail", "each time")),
        (with_sample("open", lambda rng, seed: 3), Finding("tasks: open", "fail", "of type int")),
        (with_classifier(lambda state, objects: 2.0), Finding("tasks: door", "fail", "says 2.0 of At(p0, pad0)")),
        (with_classifier(lambda state, objects: 1.0), Finding("tasks: door", "fail", "holds from the beginning")),
        (with_classifier(lambda state: 1.0), Finding("tasks: door", "fail", "raises TypeError")),
        (replace(GOOD, operators=GOOD.operators[:1]), Finding("tasks: door", "fail", "no plan with seed 0")),
        (replace(GOOD, embodiment=replace(BODY, skills=tuple)), Finding("skills", "fail", "Fetch has no skill")),
        (
            replace(GOOD, embodiment=replace(BODY, skills=skills_that_raise)),
            Finding("skills", "fail", "raises ValueError: no gripper"),
        ),
        (simulated_by(Falling), Finding("scenes: door", "fail", "8 of 8 do not stand (seeds 0, 1, 2, 3, 0)")),
        (simulated_by(Drifting), Finding("scenes: door", "fail", "do not stand")),
        (simulated_by(Broken), Finding("actions", "fail", "a feature is no number")),
        (simulated_by(Timeless), Finding("actions", "fail", "the clock says 0 s")),
        (simulated_by(Forgetful), Finding("snapshots", "fail", "features differ by up to")),
        (simulated_by(Inexact), Finding("snapshots", "warn", "features differ by up to")),
        (simulated_by(Blind), Finding("picture", "warn", "float64 (256, 480, 3)")),
        (
            replace(GOOD, free=closed),
            Finding("given model: free", "fail", "in 0 of 4; most often: Fetch(r, p0) did not"),
        ),
        (with_sample("open", closed), Finding("given model: open", "fail", "reaches the goal in 0 of 4")),
        (with_sample("door", opened), Finding("given model: door", "fail", "reaches the goal in 4 of 4")),
        (simulated_by(Numb), Finding("given model: door", "fail", "in 4 of 4 failures nothing is run into")),
        (replace(GOOD, free=None), Finding("simulator", "warn", "no free is declared")),
    ],
)
def test_each_breach_is_named(domain: Domain, finding: Finding) -> None:
    found = next(f for f in examine(domain, WORLDS) if f.status != "ok")
    assert (found.name, found.status) == (finding.name, finding.status)
    assert finding.detail in found.detail and found.fix
