"""The model in Rerun: a graph of skills and predicates, and a table."""

from __future__ import annotations

import itertools
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


def test_a_recording_shows_the_model_that_it_was_planned_with(tmp_path: Path) -> None:
    path = record(tmp_path / "e.mcap", {"pddl": PDDL, "learned": ["On"]})
    assert read_episode(path).meta.model["learned"] == ["On"]
    save_drawing(read_episode(path), tmp_path / "e.rrd")
    view = rr.dataframe.load_recording(tmp_path / "e.rrd").view(index="time", contents="model/**")
    told = str(view.select_static().read_all().to_pydict())
    assert "Pick" in told and "**On**(b0, b1)" in told


def test_no_node_of_the_graph_lies_upon_another(tmp_path: Path) -> None:
    save_drawing(read_episode(record(tmp_path / "e.mcap", {"pddl": PDDL, "learned": ["On"]})), tmp_path / "e.rrd")
    view = rr.dataframe.load_recording(tmp_path / "e.rrd").view(index="time", contents="model/graph")
    told = view.select_static().read_all().to_pydict()
    (names,), (places,) = (next(v for k, v in told.items() if word in k) for word in ("labels", "positions"))
    assert sorted(names) == ["HandEmpty", "Holding", "Insert", "On", "Pick"]
    for (name, (x, y)), (other, (x2, y2)) in itertools.combinations(zip(names, places, strict=True), 2):
        assert abs(y - y2) > 40 or abs(x - x2) > 7 * (len(name) + len(other)) / 2


def test_one_without_a_model_is_drawn_as_before(tmp_path: Path) -> None:
    save_drawing(read_episode(record(tmp_path / "e.mcap", {})), tmp_path / "e.rrd")
    assert (tmp_path / "e.rrd").stat().st_size > 0


@pytest.mark.parametrize("model", [{"pddl": "(nonsense", "learned": []}, {"pddl": 3, "learned": []}, {"pddl": PDDL}])
def test_what_is_no_model_is_named(tmp_path: Path, model: dict[str, Any]) -> None:
    with pytest.raises(EpisodeError, match="holds no model"):
        save_drawing(read_episode(record(tmp_path / "e.mcap", model)), tmp_path / "e.rrd")
