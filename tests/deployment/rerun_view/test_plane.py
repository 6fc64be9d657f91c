"""What moves in a plane is drawn in it: in its place, of its size, under its name, in a view of its own."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from resync_robot.commands.review import ReviewConfig, review
from resync_robot.core.episode import read_episode
from resync_robot.core.episode_records import EpisodeMeta
from resync_robot.core.episode_writer import EpisodeWriter
from resync_robot.core.state import State
from resync_robot.core.symbols import ROUND, SE2, SE3, Type
from resync_robot.deployment.rerun_view import plane
from resync_robot.deployment.rerun_view.layout import blueprint

DISC = Type("disc", ("x", "y", "theta", "d"), pose=SE2, extents=("d", "d"), symmetry=ROUND)
BAR = Type("bar", ("x", "y", "theta", "long", "wide"), pose=SE2, extents=("long", "wide"), symmetry=2)
FLAG, MOOD, CUBE = Type("flag", ("x", "y", "theta"), pose=SE2), Type("mood", ("good",)), Type("cube", SE3, pose=SE3)
D, B, F, M = DISC("d"), BAR("b"), FLAG("f"), MOOD("m")


def state(t: float, bar: bool = True) -> State:
    """A disc on its way to the right above a bar at rest, which may be gone."""
    things = {D: [1.0 + t, 2.0, 0.0, 0.4], F: [0.0, -1.0, 0.0], M: [1.0]}
    return State(
        {o: np.array(x) for o, x in {**things, **({B: [3.0, 1.0, math.pi / 6, 2.0, 0.5]} if bar else {})}.items()}
    )


def record(path: Path, types: tuple[Type, ...], objects: dict[str, str], truth: bool = True) -> None:
    meta = EpisodeMeta(
        rig_hash="", rig={}, library_hash="", domain="toys", scenario="s", goal="", seed=0, backend="sim",
        types={t.name: t.to_json() for t in types}, objects=objects,
    )  # fmt: skip
    with EpisodeWriter(path, meta) as writer:
        for k in range(5):
            writer.state(0.5 * k, state(0.5 * k + 0.1, bar=k < 3))
            if truth:
                writer.truth(0.5 * k, state(0.5 * k))


OBJECTS = {o.name: o.type.name for o in (D, B, F, M)}


def rows(drawing: Path, entity: str) -> dict[str, list[Any]]:
    """The parts of what was drawn there, without the times at which nothing was."""
    import rerun as rr

    view = rr.dataframe.load_recording(drawing).view(
        index="time", contents=f"{entity}/**", include_tombstone_columns=True
    )
    table = view.select().read_all().to_pydict()
    return {name.rsplit(":", 1)[-1]: [v for v in column if v is not None] for name, column in table.items()}


@pytest.fixture(scope="module")
def drawing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("plane")
    record(folder / "e.mcap", (DISC, BAR, FLAG, MOOD), OBJECTS)
    review(ReviewConfig(episode=folder / "e.mcap", save=folder / "e.rrd"))
    return folder / "e.rrd"


def test_what_is_round_is_a_disc_that_moves_y_upwards(drawing: Path) -> None:
    shown = rows(drawing, "/plane/truth/d")
    np.testing.assert_allclose([v[0] for v in shown["positions"]], [[1.0 + 0.5 * k, -2.0] for k in range(5)])
    assert shown["radii"][0] == pytest.approx([0.2]) and shown["labels"][0] == ["d"]


def test_what_is_not_is_an_outline_that_turns_with_it(drawing: Path) -> None:
    ((strip,),) = rows(drawing, "/plane/truth/b")["strips"]
    corners = np.array(strip) * plane.FLIP - (3.0, 1.0)
    assert len(strip) == 5 and strip[0] == strip[4]
    turned = corners @ np.array(
        [[math.cos(math.pi / 6), -math.sin(math.pi / 6)], [math.sin(math.pi / 6), math.cos(math.pi / 6)]]
    )
    np.testing.assert_allclose(np.abs(turned), np.tile([1.0, 0.25], (5, 1)), atol=1e-6)


def test_what_has_no_size_is_a_point_and_what_has_no_place_is_left_out(drawing: Path) -> None:
    import rerun as rr

    assert rows(drawing, "/plane/truth/f")["positions"] == [[[0.0, 1.0]]], "drawn once, for it stays"
    entities = {c.entity_path for c in rr.dataframe.load_recording(drawing).schema().component_columns()}
    assert not {e for e in entities if e.endswith("/m")} and not {e for e in entities if e.startswith("/world/robot")}


def test_what_is_no_longer_believed_in_disappears(drawing: Path) -> None:
    assert rows(drawing, "/plane/belief/b")["is_recursive"] == [[True]]
    (circle,) = rows(drawing, "/plane/belief/d")["strips"][0]
    np.testing.assert_allclose(np.linalg.norm(np.array(circle) - (1.1, -2.0), axis=1), 0.2, atol=1e-6)


def test_names_stand_at_the_belief_where_nobody_knows_the_truth(tmp_path: Path) -> None:
    record(tmp_path / "e.mcap", (DISC, BAR, FLAG, MOOD), OBJECTS, truth=False)
    review(ReviewConfig(episode=tmp_path / "e.mcap", save=tmp_path / "e.rrd"))
    assert rows(tmp_path / "e.rrd", "/plane/belief/d")["labels"][0] == ["d"]


def test_the_view_is_as_large_as_what_moves_in_it(tmp_path: Path) -> None:
    record(tmp_path / "e.mcap", (DISC, BAR, FLAG, MOOD), OBJECTS)
    seen = plane.bounds(read_episode(tmp_path / "e.mcap"))
    assert seen is not None
    (left, top), (right, bottom) = seen
    # The disc ends at 3.1 m, the bar, which is there for a while, beyond; the flag stands lowest.
    assert -0.5 < left < 0.0 and -2.5 < top < -2.2 and 1.0 < bottom < 1.5
    assert 3.0 + math.cos(math.pi / 6) < right < 4.3


@pytest.mark.parametrize(
    ("objects", "views"),
    [
        (OBJECTS, {"2D"}),
        ({"c": "cube"}, {"3D"}),
        ({**OBJECTS, "c": "cube"}, {"2D", "3D"}),
        ({"m": "mood"}, set()),
    ],
)
def test_a_view_for_each_kind_of_pose(tmp_path: Path, objects: dict[str, str], views: set[str]) -> None:
    record(tmp_path / "e.mcap", (DISC, BAR, FLAG, MOOD, CUBE), objects)
    names: list[str] = []

    def collect(part: Any) -> None:
        names.append(getattr(part, "class_identifier", ""))
        for inner in getattr(part, "contents", None) or ():
            if not isinstance(inner, str):
                collect(inner)

    collect(blueprint(read_episode(tmp_path / "e.mcap")).root_container)
    assert {n for n in names if n in ("2D", "3D")} == views, names
    assert names.count("TimeSeries") == 1, "atoms over time; of an arm nothing"
