"""The model in Rerun: a graph of skills and predicates, and a table."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import rerun as rr

from resync_robot.core.episode import read_episode
from resync_robot.core.episode_records import EpisodeMeta
from resync_robot.core.episode_writer import EpisodeWriter
from resync_robot.core.errors import EpisodeError
from resync_robot.core.vocabulary import BLOCK, ROBOT, TYPES
from resync_robot.deployment.rerun_view.drawing import save_drawing
from resync_robot.deployment.rerun_view.model import ATOM, LEARNED_ATOM, SKILL, graph_of
from resync_robot.planning.pddl import domain_to_pddl
from resync_robot.sim_training.domains.cornered_insertion_s.domain import HAND_EMPTY, HOLDING, INSERT, ON, PICK

PDDL = domain_to_pddl("toy", (ROBOT, BLOCK), (HAND_EMPTY, HOLDING, ON), (PICK, INSERT))


def record(path: Path, model: dict[str, Any]) -> Path:
    types = {t.name: t.to_json() for t in TYPES.values()}
    meta = EpisodeMeta(
        rig_hash="", rig={}, library_hash="", domain="toy", scenario="s", goal="", seed=0, backend="sim",
        types=types, model=model,
    )  # fmt: skip
    with EpisodeWriter(path, meta):
        pass
    return path


def test_edges_lead_from_what_is_needed_over_the_skill_to_what_it_makes_true() -> None:
    nodes, edges = graph_of((PICK, INSERT), {"Holding"})
    assert nodes["skill:Pick"] == SKILL and nodes["atom:Holding"] == LEARNED_ATOM and nodes["atom:On"] == ATOM
    assert set(edges) == {
        ("atom:HandEmpty", "skill:Pick"),
        ("skill:Pick", "atom:Holding"),
        ("atom:Holding", "skill:Insert"),
        ("skill:Insert", "atom:On"),
        ("skill:Insert", "atom:HandEmpty"),
    }


def test_a_recording_shows_the_model_that_it_was_planned_with(tmp_path: Path) -> None:
    path = record(tmp_path / "e.mcap", {"pddl": PDDL, "learned": ["On"]})
    assert read_episode(path).meta.model["learned"] == ["On"]
    save_drawing(read_episode(path), tmp_path / "e.rrd")
    view = rr.dataframe.load_recording(tmp_path / "e.rrd").view(index="time", contents="model/**")
    told = str(view.select_static().read_all().to_pydict())
    assert "Pick" in told and "**On**(b0, b1)" in told


def test_one_without_a_model_is_drawn_as_before(tmp_path: Path) -> None:
    save_drawing(read_episode(record(tmp_path / "e.mcap", {})), tmp_path / "e.rrd")
    assert (tmp_path / "e.rrd").stat().st_size > 0


@pytest.mark.parametrize("model", [{"pddl": "(nonsense", "learned": []}, {"pddl": 3, "learned": []}, {"pddl": PDDL}])
def test_what_is_no_model_is_named(tmp_path: Path, model: dict[str, Any]) -> None:
    with pytest.raises(EpisodeError, match="holds no model"):
        save_drawing(read_episode(record(tmp_path / "e.mcap", model)), tmp_path / "e.rrd")
