"""Random scenes for perception, the comparison with the truth, and the report."""

from __future__ import annotations

import json
from collections import Counter
from importlib.resources import files
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.stats import chi2

from resync_robot import cli
from resync_robot.core.errors import RenderError
from resync_robot.core.rig import load_rig
from resync_robot.core.state import State
from resync_robot.core.vocabulary import BLOCK
from resync_robot.evaluation.perception_report import ALL, LEVELS, draw_reliability, perception_report, perception_table
from resync_robot.evaluation.perception_trial import ObjectRow, SceneRow, _Trial, compare
from resync_robot.perception.blocks import BlockEstimate
from resync_robot.perception.objects import SceneEstimate
from resync_robot.perception.pose import BoxEstimate
from resync_robot.perception.scan import Scan
from resync_robot.sim_training.domains.cornered_insertion_s.layouts import THE_BOX, R
from resync_robot.sim_training.physics.camera_noise import NoisySensor
from resync_robot.sim_training.physics.scene import require_renderer
from resync_robot.sim_training.physics.world import SimWorld
from resync_robot.sim_training.scenes.perception import LOWER, TOUCHING, TWIN, UPPER, draw_scene

SCENES = [draw_scene(1000, i) for i in range(60)]


def test_a_scene_is_a_pure_function_of_its_number() -> None:
    for i in range(3):
        again = draw_scene(1000, i)
        assert again.task.initial == SCENES[i].task.initial
        assert again.conditions == SCENES[i].conditions
    assert draw_scene(1001, 0).task.initial != SCENES[0].task.initial


def test_every_condition_is_drawn_and_is_what_it_says() -> None:
    conditions = Counter(c for s in SCENES for c in s.conditions.values())
    assert len(conditions) == 7 and min(conditions.values()) >= 5
    assert {len(s.conditions) for s in SCENES} == {2, 3, 4, 5}
    assert 10 < sum(TWIN in s.conditions for s in SCENES) < 50
    for scene in SCENES:
        state = scene.task.initial
        for kind, apart in ((TOUCHING, 1.0), (UPPER, 0.0)):
            mine = [BLOCK(n) for n, c in scene.conditions.items() if c == kind]
            others = [BLOCK(n) for n, c in scene.conditions.items() if c == (LOWER if kind == UPPER else kind)]
            for block in mine:
                width = state.get(block, "size_x")[0]
                away = min(np.linalg.norm((state[block] - state[o])[:2]) for o in others if o != block)
                assert apart * width <= away < apart * 1.1 * width + 0.002
        if TWIN in scene.conditions:
            assert sum(scene.hues[n] == scene.hues[TWIN] for n in scene.conditions) == 2


def exact(covariance: float = 1e-6) -> tuple[State, State]:
    """What is believed, and the truth, of one scene with twins."""
    true = next(s for s in SCENES if TWIN in s.conditions).task.initial
    believed = {o: true[o] for o in true.objects}
    return State(believed, {o: np.eye(len(true[o])) * covariance for o in believed if o != R}), true


DRAWN = next(s for s in SCENES if TWIN in s.conditions)


def test_errors_are_measured_whichever_twin_is_which() -> None:
    believed, true = exact()
    other = next(BLOCK(n) for n in DRAWN.conditions if n != TWIN and DRAWN.hues[n] == DRAWN.hues[TWIN])
    features = {o: believed[o] for o in believed.objects}
    features[BLOCK(TWIN)], features[other] = features[other] + np.eye(10)[0] * 0.001, features[BLOCK(TWIN)]
    rows, false = compare(DRAWN, State(features, {o: believed.covariance(o) for o in features}), true, set(), (1000, 7))
    assert false == 0
    assert all(r.found and (r.seed, r.scene) == (1000, 7) for r in rows)
    by_name = {r.name: r for r in rows}
    assert by_name[other.name].position_mm == pytest.approx(1.0)
    assert by_name[other.name].place_distance == pytest.approx(1.0)
    assert by_name[TWIN].position_mm == pytest.approx(0.0)
    assert by_name[TWIN].twin and by_name[other.name].twin


def test_what_is_far_off_or_open_is_not_found() -> None:
    believed, true = exact()
    single = next(BLOCK(n) for n in DRAWN.conditions if sum(DRAWN.hues[n] == h for h in DRAWN.hues.values()) == 1)
    gone = believed.with_features(single, x=float(true[single][0]) + 0.05)
    rows, false = compare(DRAWN, gone, true, set(), (1000, 0))
    assert false == 1
    assert [r.name for r in rows if not r.found] == [single.name]
    rows, false = compare(DRAWN, believed, true, {single.name}, (1000, 0))
    assert (false, [r.name for r in rows if not r.found]) == (0, [single.name])
    rows, false = compare(DRAWN, None, true, set(), (1000, 0))
    assert not any(r.found for r in rows) and false == 0
    assert {r.name for r in rows} == {THE_BOX.name, *DRAWN.conditions}


def test_a_block_that_the_second_scan_misses_is_not_found_where_it_stood(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = next(s for s in SCENES if not {TWIN, UPPER} & {*s.conditions, *s.conditions.values()})
    true, rig = drawn.task.initial, load_rig()

    def scan(*names: str) -> SceneEstimate:
        covariance = np.eye(10) * 1e-6
        blocks = {n: BlockEstimate(n, true[BLOCK(n)], covariance, _top(true[BLOCK(n)]), True, False, 4) for n in names}
        return SceneEstimate(BoxEstimate(true[THE_BOX], np.eye(11) * 1e-6), blocks, {})

    trial = _Trial(rig, drawn, SimWorld(drawn.task, rig), NoisySensor(0, rig.camera("wrist")))
    gone, *left = drawn.conditions
    monkeypatch.setattr(Scan, "__call__", lambda *args: [])
    for seen, found in ((drawn.conditions, True), (left, False)):
        monkeypatch.setattr(trial.estimator, "estimate", lambda frames, names=tuple(seen): scan(*names))
        (row,) = (r for r in trial.look((1000, 0)).objects if r.name == gone)
        assert row.found == found
    assert f"did not find {gone}" in trial.complaints[-1]


def _top(block: np.ndarray) -> float:
    return float(block[2] + block[9] / 2)


def scene_row(index: int, rng: np.random.Generator, sigma: float = 1.0) -> SceneRow:
    row = ObjectRow(
        seed=0, scene=index, name="b0", condition="free in the box", twin=False, found=True, position_mm=1.0,
        yaw_deg=0.2, width_mm=0.1, height_mm=0.1, yaw_distance=0.5,
        place_distance=float(sigma**2 * chi2.rvs(2, random_state=rng)),
    )  # fmt: skip
    missed = ObjectRow(seed=0, scene=index, name="b1", condition="at a wall", twin=False, found=False)
    return SceneRow(seed=0, scene=index, objects=(row, missed), false=index % 2, views=6, seconds=(0.5,), complaint="")


def test_the_report_counts_and_shows_whether_ellipses_are_honest(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    report = perception_report([scene_row(i, rng) for i in range(400)])
    summary = {s["condition"]: s for s in report["summary"]}
    assert report["false_objects"] == 200
    assert (summary[ALL]["n"], summary[ALL]["found"]) == (800, 400)
    assert summary["at a wall"]["position_mm"] is None
    for level in LEVELS:
        assert summary["free in the box"]["place_coverage"][str(level)] == pytest.approx(level, abs=0.06)
    bold = perception_report([scene_row(i, rng, 2.0) for i in range(400)])
    share = {s["condition"]: s for s in bold["summary"]}["free in the box"]["place_coverage"]["0.95"]
    assert share < 0.85
    text = perception_table(report)
    assert "| at a wall | 400 | 0.0 % | - |" in text and "200 false objects" in text
    draw_reliability(report, tmp_path / "reliability.png")
    assert (tmp_path / "reliability.png").stat().st_size > 5000
    json.dumps(report)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--scenes", "0"], "--scenes is 0"),
        (["--seeds", "-1"], "--seeds is"),
        (["--methods", "rc"], "--methods has no meaning"),
        (["--domain", "other"], "--domain has no meaning"),
        (["--episodes", "3"], "--episodes has no meaning"),
        (["--perception", "camera"], "--perception has no meaning"),
        (["--skills", "state"], "--skills has no meaning"),
        (["--rig", "absent.toml"], "absent.toml"),
    ],
)
def test_bad_input_is_one_message(words: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["evaluate", "--perception-only", *words]) == cli.BAD_INPUT
    assert message in capsys.readouterr().err


def test_no_file_of_somebody_else_is_replaced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nor by the picture, whose name nobody gave."""
    rig = tmp_path / "rig.toml"
    rig.write_bytes(files("resync_robot.core").joinpath("simulated_rig.toml").read_bytes())
    (tmp_path / "notes.json").write_text('{"mine": 1}')
    cv2.imwrite(str(tmp_path / "plot.png"), np.zeros((9, 9, 3), np.uint8))
    before = {p: p.read_bytes() for p in tmp_path.iterdir()}
    for name, word in (
        ("rig.toml", "is the file that is read"),
        ("notes.json", "exists and is not a report"),
        ("plot.json", "plot.png exists and is not a figure"),
        ("new.png", "has the name of the picture beside it"),
    ):
        words = ["--perception-only", "--rig", str(rig), "--json", str(tmp_path / name)]
        assert cli.main(["evaluate", *words]) == cli.BAD_INPUT
        assert word in capsys.readouterr().err
    assert {p: p.read_bytes() for p in tmp_path.iterdir()} == before


def test_scenes_are_scanned_and_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    try:
        require_renderer()
    except RenderError as error:
        pytest.skip(f"no Vulkan device, so no rendered pictures: {error.what}")
    out = tmp_path / "perception.json"
    words = ["--perception-only", "--scenes", "2", "--seeds", "1000", "--workers", "1", "--json", str(out)]
    assert not cli.main(["evaluate", *words])
    report = json.loads(out.read_text())
    assert report["scenes"] == 2 and report["false_objects"] == 0
    assert report["provenance"]["seeds"] == [1000] and report["provenance"]["rig"] == load_rig().hash
    assert all(row["seed"] == 1000 for row in report["rows"])
    objects = [o for row in report["rows"] for o in row["objects"]]
    assert all(o["found"] for o in objects)
    # Every fourth scene is scanned again with a block in the hand.
    assert {o["condition"] for o in objects if o["scene"] == 0} >= {"the box", "while one is held"}
    assert max(o["position_mm"] for o in objects) < 6.0
    assert out.with_suffix(".png").exists()
    assert "| all blocks |" in capsys.readouterr().out
