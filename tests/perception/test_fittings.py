"""Lids and drawers: measured where they are, and never guessed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from resync_robot.core import spatial
from resync_robot.core.errors import ConfigError, UnknownNameError
from resync_robot.core.fittings import Drawer, Lid
from resync_robot.core.rig import Rig
from resync_robot.core.vocabulary import BOX, DRAWER, LID, ROBOT
from resync_robot.perception import sights
from resync_robot.perception.belief import Belief
from resync_robot.perception.catalogue import Catalogue
from resync_robot.perception.fittings import FittingEstimate
from resync_robot.perception.naming import AmbiguousObjectsError, MissingObjectsError, UnsettledSceneError
from resync_robot.perception.next_views import next_views
from resync_robot.perception.objects import SceneEstimate, SceneEstimator
from resync_robot.perception.outline import Votes, grid, outward_of_rectangle, seen_edges
from resync_robot.perception.scan import FURNISHED as ROUND
from resync_robot.perception.scan import Scan
from resync_robot.sim_training.physics.camera_noise import NoisySensor
from tests.perception.raycast import CENTRE, FLOOR, INNER, RIM, Table

COLOURS = {**Catalogue().hues, "lid": 0.80, "drawer": 0.48, "drawer_cabinet": 0.25}
SMALL = {"drawer": Drawer(front=(0.012, 0.14, 0.060), cabinet=(0.10, 0.14, 0.070), travel=0.08)}
FURNISHED = Catalogue(hues=COLOURS, lids={"lid": Lid(size=(0.33, 0.33, 0.012))}, drawers=SMALL)
LARGE = Catalogue(hues=COLOURS)
OBLONG = Catalogue(hues=COLOURS, lids={"lid": Lid(size=(0.20, 0.14, 0.010))}, drawers=SMALL)
ROBOT_FEATURES = np.array([0.45, 0.0, 0.30, 0.0, 1.0, 0.0, 0.0, 0.14])

ON_THE_RIM = (0.476, 0.004, RIM, 0.05)
"""x, y, lower face, yaw of a lid."""
ON_THE_TABLE = (0.46, -0.31, 0.0, 1.2)
CABINET, TURNED = (0.46, 0.31), 0.3


def front(x: float, y: float, yaw: float, opening: float) -> list[float]:
    """Centre of the front of a drawer whose cabinet stands there; the ray-caster lifts it 4 mm off the table."""
    drawer = FURNISHED.drawers["drawer"]
    ahead = (drawer.cabinet[0] + drawer.front[0]) / 2 + opening
    return [x + ahead * np.cos(yaw), y + ahead * np.sin(yaw), 0.004 + drawer.front[2] / 2]


def yaw_of(estimate: FittingEstimate) -> float:
    return float(spatial.yaw_of(estimate.features[3:7]))


@pytest.fixture(scope="module")
def lidded(rig: Rig) -> SceneEstimate:
    """A square lid on the box, a closed drawer, a block on the table."""
    table = Table(rig, FURNISHED)
    table.lid("lid", *ON_THE_RIM)
    table.drawer("drawer", *CABINET, TURNED, 0.0)
    table.block("b0", 0.44, -0.30, 0.0, 0.2, 0.060, 0.045)
    return SceneEstimator(rig, FURNISHED).estimate(table.scan())


@pytest.fixture(scope="module")
def opened(rig: Rig) -> SceneEstimate:
    """An oblong lid on the table, an open drawer that looks the other way, a block in the box."""
    table = Table(rig, OBLONG)
    table.lid("lid", *ON_THE_TABLE)
    table.drawer("drawer", *CABINET, TURNED - np.pi, 0.05)
    table.block("b0", 0.45, 0.05, FLOOR, 0.2, 0.060, 0.045)
    return SceneEstimator(rig, OBLONG).estimate(table.scan())


def test_a_lid_on_the_box_is_measured_and_the_box_under_it(lidded: SceneEstimate) -> None:
    x, y, bottom, yaw = ON_THE_RIM
    lid = lidded.fittings["lid"]
    assert lid.features[:3] == pytest.approx([x, y, bottom + 0.006], abs=0.0007)
    assert abs(spatial.wrap(yaw_of(lid) - yaw, np.pi / 2)) < np.radians(0.3)
    assert lidded.box.features[:2] == pytest.approx(CENTRE, abs=0.0007)
    assert lidded.box.features[7:9] == pytest.approx([INNER, INNER], abs=0.002)


def test_a_lid_that_is_not_square_looks_the_same_after_half_a_turn_only(opened: SceneEstimate) -> None:
    x, y, bottom, yaw = ON_THE_TABLE
    lid = opened.fittings["lid"]
    assert lid.features[:3] == pytest.approx([x, y, bottom + 0.005], abs=0.0007)
    assert abs(spatial.wrap(yaw_of(lid) - yaw, np.pi)) < np.radians(0.3)
    assert lid.features[7:] == pytest.approx(OBLONG.lids["lid"].size)


@pytest.mark.parametrize(("scene", "yaw", "opening"), [("lidded", TURNED, 0.0), ("opened", TURNED - np.pi, 0.05)])
def test_a_drawer_is_measured_whichever_way_it_looks(
    scene: str, yaw: float, opening: float, request: pytest.FixtureRequest
) -> None:
    drawer = request.getfixturevalue(scene).fittings["drawer"]
    assert drawer.features[:3] == pytest.approx(front(*CABINET, yaw, opening), abs=0.001)
    assert abs(spatial.wrap(yaw_of(drawer) - yaw)) < np.radians(0.5)
    assert drawer.features[7] == pytest.approx(opening, abs=0.001)


def test_lid_and_drawer_are_no_blocks_and_blocks_are_seen_beside_them(
    lidded: SceneEstimate, opened: SceneEstimate
) -> None:
    for scene in (lidded, opened):
        assert set(scene.blocks) == {"b0"} and not scene.glimpses and not scene.surplus
        assert set(scene.fittings) == {"lid", "drawer"} and not scene.seen_twice and not scene.without_depth


def test_covariances_are_covariances(lidded: SceneEstimate, opened: SceneEstimate) -> None:
    for estimate in (*lidded.fittings.values(), *opened.fittings.values()):
        assert estimate.covariance.shape == (len(estimate.features),) * 2
        assert np.allclose(estimate.covariance, estimate.covariance.T)
        assert np.linalg.eigvalsh(estimate.covariance).min() > -1e-12
        assert 2e-4 < np.sqrt(estimate.covariance[0, 0]) < 3e-3


def test_what_is_seen_twice_is_not_chosen_and_what_has_another_size_is_not_found(rig: Rig) -> None:
    table = Table(rig, OBLONG)
    table.lid("lid", *ON_THE_TABLE)
    table.lid("lid", 0.47, 0.02, FLOOR, 0.3)
    table.coloured("drawer_cabinet", (*CABINET, 0.035), (0.05, 0.07, 0.035), TURNED)
    table.coloured("drawer", (0.55, 0.33, 0.034), (0.006, 0.045, 0.03), TURNED)
    frames = table.scan()
    scene = SceneEstimator(rig, OBLONG).estimate(frames)
    assert not scene.fittings and set(scene.seen_twice) == {"lid"}
    np.testing.assert_allclose(sorted(map(tuple, scene.seen_twice["lid"])), [(0.46, -0.31), (0.47, 0.02)], atol=0.001)
    assert not SceneEstimator(rig, FURNISHED).estimate(frames).fittings


def test_a_drawer_that_reaches_out_of_the_pictures_is_not_guessed_and_another_look_there_finds_it(rig: Rig) -> None:
    yaw, opening = 0.55, 0.06
    table, estimator = Table(rig, FURNISHED), SceneEstimator(rig, FURNISHED)
    table.lid("lid", *ON_THE_RIM)
    table.drawer("drawer", *CABINET, yaw, opening)
    frames = table.scan()
    belief = belief_of(rig)
    with pytest.raises(MissingObjectsError, match=r"drawer \(drawer shows only in part, at \(0\.5") as missing:
        belief.update(estimator.estimate(frames), ROBOT_FEATURES)
    (place,) = missing.value.in_part["drawer"]
    truth = np.array(front(*CABINET, yaw, opening))
    assert np.linalg.norm(place - truth[:2]) < 0.03
    assert any(np.array_equal(place, p) for p in belief.unclear_places())
    scene = estimator.estimate([*frames, *table.scan(Scan(rig).towards(place))])
    drawer = scene.fittings["drawer"]
    assert drawer.features[:3] == pytest.approx(truth, abs=0.001) and not scene.seen_in_part
    assert drawer.features[7] == pytest.approx(opening, abs=0.001)


@pytest.mark.parametrize("opening", [0.0, 0.15])
def test_two_chosen_views_do_for_a_lid_and_two_for_a_drawer(rig: Rig, opening: float) -> None:
    """The lid is believed 14 mm from where it is, the drawer closed."""
    built, size = LARGE.drawers["drawer"], LARGE.lids["lid"].size
    table, estimator = Table(rig, LARGE), SceneEstimator(rig, LARGE)
    table.lid("lid", 0.55, -0.46, 0.0, 0.1)
    table.drawer("drawer", 0.61, 0.425, np.pi, opening)
    box = estimator.estimate(table.scan()).box
    lid = np.array([0.56, -0.47, size[2] / 2, *spatial.quat_from_yaw(0.1), *size])
    x, z = 0.61 - (built.cabinet[0] + built.front[0]) / 2, built.lift + built.front[2] / 2
    closed = np.array([x, 0.425, z, *spatial.quat_from_yaw(np.pi), 0.0, *built.front])
    looks = (
        ("lid", sights.of_lid(lid), [0.55, -0.46]),
        ("drawer", sights.of_drawer(closed, built), [x - opening, 0.425]),
    )
    for name, sight, true in looks:
        solids = sights.cabinet_and_front(closed, built)
        views = next_views(Scan(rig, ROUND), rig, [], box.features, rig.arm.home, False, [sight], solids)
        assert len(views) == 2
        found = estimator.estimate(table.scan(views), box).fittings[name]
        assert found.features[:2] == pytest.approx(true, abs=0.0015)
        if name == "drawer":
            assert found.features[7] == pytest.approx(opening, abs=0.0015)


def belief_of(rig: Rig) -> Belief:
    return Belief(
        ROBOT("r"), BOX("box"), (), rig, SceneEstimator(rig, FURNISHED), (LID("lid"), DRAWER("drawer"))
    )  # fmt: skip


def test_the_belief_holds_them_and_says_what_is_not_clear(rig: Rig, lidded: SceneEstimate) -> None:
    belief, lid, drawer = belief_of(rig), LID("lid"), DRAWER("drawer")
    state = belief.update(lidded, ROBOT_FEATURES)
    assert belief.report.seen == ("lid", "drawer")
    assert state.get(drawer, "opening") == pytest.approx(0.0, abs=0.001)
    gone = replace(lidded, fittings={"lid": lidded.fittings["lid"]})
    with pytest.raises(MissingObjectsError, match="did not find drawer"):
        belief.update(gone, ROBOT_FEATURES)
    rough, fine = belief.state(ROBOT_FEATURES).covariance(drawer), state.covariance(drawer)
    assert rough is not None and fine is not None
    assert rough[7, 7] > 100 * fine[7, 7] and np.linalg.eigvalsh(rough).min() > -1e-12
    assert len(belief.unclear_places()) >= 1
    places = np.array([[0.45, 0.0], [0.46, -0.3]])
    with pytest.raises(AmbiguousObjectsError, match="2 things that may be lid"):
        belief.update(
            replace(lidded, fittings={"drawer": lidded.fittings["drawer"]}, seen_twice={"lid": places}), ROBOT_FEATURES
        )
    assert belief.report.ambiguous == ("lid",)
    assert belief.state(ROBOT_FEATURES)[lid][:2] == pytest.approx(state[lid][:2]), "it keeps its old place"
    with pytest.raises(UnsettledSceneError) as both:
        belief.update(replace(lidded, fittings={}, seen_twice={"lid": places}), ROBOT_FEATURES)
    assert set(both.value.names) == {"lid", "drawer"}


def test_a_lid_without_a_colour_cannot_be_asked_for(rig: Rig) -> None:
    with pytest.raises(UnknownNameError, match="unknown lid of the catalogue 'lid'"):
        Belief(ROBOT("r"), BOX("box"), (), rig, fittings=(LID("lid"),))


@pytest.mark.parametrize(
    ("hues", "what"),
    [
        ({"drawer": 0.48}, r"only one colour(.|\n)*drawer and drawer_cabinet"),
        ({"drawer_cabinet": 0.48}, "only one colour"),
        ({"lid": 0.0}, "b0 and lid have the same hue, 0"),
    ],
)
def test_colours_that_would_have_to_be_guessed_are_refused(hues: dict[str, float], what: str) -> None:
    with pytest.raises(ConfigError, match=what):
        Catalogue(hues={**Catalogue().hues, **hues})


@given(
    yaw=st.floats(-np.pi / 4, np.pi / 4),
    extents=st.tuples(st.floats(0.01, 0.4), st.floats(0.01, 0.4)),
    along=st.floats(-0.9, 0.9),
)
def test_just_outside_an_edge_outward_is_the_normal_of_that_edge(
    yaw: float, extents: tuple[float, float], along: float
) -> None:
    turn = spatial.rotation_about("z", yaw)[:2, :2]
    width, length = extents
    places = np.array([[width / 2 + 1e-4, along * length / 2], [along * width / 2, -length / 2 - 1e-4]])
    outward = outward_of_rectangle(places @ turn.T, np.zeros(2), yaw, np.array(extents))
    np.testing.assert_allclose(outward @ turn, [[1, 0], [0, -1]], atol=1e-9)


@given(yaw=st.floats(-np.pi / 4, np.pi / 4), edge=st.integers(0, 3))
def test_an_edge_is_seen_as_far_as_what_lies_outside_it_is(yaw: float, edge: int) -> None:
    centre, extents, within = np.array([0.4, -0.2]), np.array([0.10, 0.04]), 0.006
    cells = grid(centre, 0.08, 0.001)
    beyond = (cells - centre) @ [np.cos(yaw + edge * np.pi / 2), np.sin(yaw + edge * np.pi / 2)] - extents[edge % 2] / 2

    def least(unseen: np.ndarray) -> float:
        votes = Votes(cells, np.zeros(len(cells)), np.where(unseen, 0.0, 1.0), 1)
        return float(seen_edges(votes, (centre, yaw, extents), within).min())

    assert least(beyond > within + 1e-6) == 1
    assert least(beyond > within / 2) == pytest.approx(0.5, abs=0.2)
    assert least(beyond > -1e-6) == 0


@pytest.mark.slow
def test_at_the_noise_of_a_d435i_they_are_found_and_the_covariance_holds(rig: Rig) -> None:
    """1 mm and 0.2 degrees of error a view, a lid on the table or in the box, drawers of any opening; all of them
    where the scan's pictures show every edge, which at a drawer's height end at y = 0.406 m."""
    rng, estimator = np.random.default_rng(2400), SceneEstimator(rig, OBLONG)
    cabinet = (0.46, 0.29)
    errors: dict[str, list[tuple[float, ...]]] = {"lid": [], "drawer": []}
    for k in range(24):
        sensor = NoisySensor(2400 + k, rig.camera("wrist"))
        in_box = k % 2 == 1
        x, y = (0.47, 0.0) + rng.uniform(-0.02, 0.02, 2) if in_box else (0.46, -0.295) + rng.uniform(-0.005, 0.005, 2)
        bottom, turn = (FLOOR, rng.uniform(-np.pi / 2, np.pi / 2)) if in_box else (0.0, rng.uniform(-0.4, 0.4))
        yaw, opening = rng.uniform(-0.3, 0.3) - np.pi * (k % 3 == 0), rng.uniform(0.0, 0.07)
        table = Table(rig, OBLONG)
        table.lid("lid", x, y, bottom, turn)
        table.drawer("drawer", *cabinet, yaw, opening)
        scene = estimator.estimate([sensor.apply(f) for f in table.scan()])
        for name, centre, heading, period in (
            ("lid", [x, y, bottom + 0.005], turn, np.pi),
            ("drawer", front(*cabinet, yaw, opening), yaw, 2 * np.pi),
        ):
            estimate = scene.fittings.get(name)
            if estimate is None:
                continue
            off = estimate.features[:3] - centre
            askew = abs(float(spatial.wrap(yaw_of(estimate) - heading, period)))
            beyond = float(off[:2] @ np.linalg.solve(estimate.covariance[:2, :2], off[:2]) > 5.99)
            slid = abs(estimate.features[7] - opening) if name == "drawer" else 0.0
            errors[name].append((float(np.linalg.norm(off)), askew, beyond, slid))
    assert len(errors["lid"]) >= 23 and len(errors["drawer"]) >= 23
    for name in errors:
        position, askew, beyond = np.array(errors[name])[:, :3].T
        assert np.median(position) < 0.0012 and np.percentile(position, 95) < 0.0035
        assert np.median(askew) < np.radians(0.5)
        assert beyond.mean() < 0.2
    assert np.median([e[3] for e in errors["drawer"]]) < 0.001
