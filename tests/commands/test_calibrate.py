"""`calibrate`: bad input is one error and loses nothing; in simulation a camera that was knocked is found again."""

from __future__ import annotations

import colorsys
import io
import tomllib
from dataclasses import replace
from datetime import date, timedelta
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from resync_robot import cli
from resync_robot.calibration.detect import Rejected
from resync_robot.calibration.rig_file import update_rig
from resync_robot.calibration.shots import Shot, ShotFolder
from resync_robot.commands.deploy import DeployConfig, calibration_complaints
from resync_robot.core import spatial
from resync_robot.core.calibration_record import CalibrationRecord
from resync_robot.core.errors import MotionError, RenderError
from resync_robot.core.rig import Rig, load_rig
from resync_robot.perception.hues import apart
from resync_robot.sim_training.scenes.calibration import CalibrationWorld, displaced, empty_task, row_task
from tests import emulators
from tests.calibration import synthetic

RECORD = CalibrationRecord(
    calibrated="2026-01-01", checked="2026-01-01", method="eye-in-hand", views=20, left_out=1,
    held_out_mm=0.5, held_out_deg=0.2, held_out_px=0.3,
)  # fmt: skip


@pytest.fixture(scope="module")
def renderer() -> None:
    try:
        CalibrationWorld(empty_task(load_rig(), 0), load_rig(), None)
    except RenderError as error:
        pytest.skip(f"no Vulkan device: {error.what}")


def run(*args: str) -> int | str | None:
    try:
        return cli.main(["calibrate", *args])
    except SystemExit as end:
        return end.code


def stored(
    folder: Path, rig: Rig, true_flange_T_cam: np.ndarray, count: int = 14, tilt: float = 45.0, kind: str = ""
) -> None:
    """A folder of pictures as an earlier run leaves them, without a renderer; of no board at all where it is `absent`,
    and of one that was `moved` half way."""
    rng = np.random.default_rng(5)
    keep = ShotFolder(folder, "wrist", synthetic.SPEC)
    down = np.array([[0, 1.0, 0], [1, 0, 0], [0, 0, -1]])
    world_T_board = spatial.transform(down, np.array([0.48, 0, 0]) - down @ synthetic.SPEC.centre)
    taken = 0
    while taken < count:
        cam_T_board = synthetic.draw_pose(rng, tilt)
        world_T_flange = world_T_board @ spatial.inverse(true_flange_T_cam @ cam_T_board)
        try:
            q = rig.arm.kinematics.inverse(spatial.inverse(rig.arm.world_T_base) @ world_T_flange, rig.arm.home)
        except MotionError:
            continue
        name = f"wrist-{taken:03d}.png"
        picture = np.full((240, 424, 3), 128, np.uint8) if kind == "absent" else synthetic.photograph(cam_T_board)
        keep.add(Shot(name, picture, q, Rejected("not judged here")))
        taken += 1
        if kind == "moved" and taken == count // 2:
            world_T_board = spatial.transform(None, np.array([0.03, 0.02, 0.0])) @ world_T_board


@pytest.mark.parametrize(
    ("args", "word"),
    [
        (("board", "--out", "board.svg"), "give --out board.pdf"),
        (("board", "--dpi", "5"), "--dpi is 5"),
        (("board", "--board.square", "32"), "lengths are in metres"),
        (("board", "--board.dictionary", "9x9"), "valid: 4x4_50"),
        (("board", "--out", "/dev/null/board.pdf"), "cannot write --out /dev/null/board.pdf: /dev/null is no folder"),
        (("hand-eye", "--camera", "back"), "unknown camera 'back' in the built-in rig"),
        (("hand-eye", "--backend", "ur7e"), "--backend ur7e needs the rig file"),
        (("check", "--live", "--backend", "ur7e"), "--rig emulated"),
        (("hand-eye", "--poses", "0"), "--poses is 0; allowed: 8 to 100"),
        (("hand-eye", "--poses", "7"), "--poses is 7; allowed: 8 to 100"),
        (("intrinsics", "--poses", "101"), "--poses is 101; allowed: 8 to 100"),
        (("check", "--poses", "3"), "--poses is 3; allowed: 4 to 100"),
        (("hand-eye", "--most-tilt", "80"), "--most-tilt is 80"),
        (("hand-eye", "--most-tilt", "0"), "--most-tilt is 0; allowed: 10 to 60, in degrees"),
        (("check", "--most-tilt", "-5"), "--most-tilt is -5"),
        (("intrinsics", "--most-tilt", "nan"), "--most-tilt is nan"),
        (("hand-eye", "--most-tilt", "inf"), "--most-tilt is inf"),
        (("hand-eye", "--seed", "-1"), "--seed is -1"),
        (("check", "--seed", "99999999999"), "from 0 to 2147483647"),
        (("hand-eye", "--board-at", "nan", "0"), "out of reach"),
        (("hand-eye", "--board.square", "nan"), "squares of nan m"),
        (("board", "--dpi", "0"), "--dpi is 0; allowed: 50 to 2400"),
        (("board", "--dpi", "999999"), "--dpi is 999999"),
        (("noise", "--frames", "0"), "--frames is 0"),
        (("noise", "--frames", "1000000"), "--frames is 1000000"),
        (("noise", "--seed", "-3"), "--seed is -3"),
        (("hues", "--names", "b0", "--seed", "-3"), "--seed is -3"),
        (("hues", "--names", "b 0"), "has 'b 0', which is no name for a thing"),
        (("hues", "--names", "b0", ""), "--names is empty"),
        (("hues", "--names", "größe"), "use letters, digits, _ and -"),
        (("hues", "--names", "b0", "drawer"), "of the drawer 'drawer' only one colour is known"),
        (("check", "--camera", "back", "--live", "--poses", "0"), "--poses is 0"),
        (("hand-eye", "--board-at", "5", "0"), "out of reach"),
        (("hand-eye", "--rig", "absent.toml"), "absent.toml"),
        (("hand-eye", "--views", "nowhere"), "no pictures in nowhere"),
        (("noise", "--frames", "2"), "--frames is 2"),
        (("noise", "--camera", "back"), "front, side, wrist"),
        (("noise", "--backend", "ur7e"), "--backend ur7e needs the rig file"),
        (("hues", "--names", "b0", "--backend", "ur7e"), "--backend ur7e needs the rig file"),
        (("hues", "--names", "b0", "b0"), "has a name twice"),
        (("hues", "--names", "a", "b", "c", "d", "e"), "allowed: 1 to 4"),
        (("hues", "--names", "b0", "--rig", "absent.toml"), "absent.toml"),
        (
            ("hand-eye", "--write", "/dev/null/rig.toml"),
            "cannot write --write /dev/null/rig.toml: /dev/null is no folder",
        ),
        (("hand-eye", "--out", "/dev/null/run"), "cannot write to /dev/null/run"),
        (("check", "--camera", "back"), "front, side, wrist"),
        (("check", "--live", "--rig", "absent.toml"), "absent.toml"),
        (("intrinsics", "--views", "nowhere"), "no pictures in nowhere"),
        (("hand-eye", "--board-at", "1.9", "0"), "reaches 0 of"),
    ],
)
def test_bad_input_is_one_error_with_code_2(
    args: tuple[str, ...],
    word: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(*args) == 2
    shown = capsys.readouterr()
    assert shown.err.startswith("error: ") and word in shown.err
    assert "Traceback" not in shown.err and shown.out == ""
    assert not list(tmp_path.rglob("*.toml")) and not list(tmp_path.rglob("*.p*"))


@pytest.mark.parametrize(
    "words", [("hand-eye", "--camera", "wrist"), ("check", "--live"), ("noise",), ("hues", "--names", "b0")]
)
def test_a_machine_that_does_not_answer(
    words: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    rig = emulators.rig_file(tmp_path)
    before = rig.read_text()
    assert run(*words, "--backend", "ur7e", "--rig", str(rig), "--seed", "1") == 2
    assert "resync-robot emulate" in capsys.readouterr().err
    assert rig.read_text() == before


def test_a_real_machine_waits_for_a_person_before_it_moves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    rig = emulators.rig_file(tmp_path)
    rig.write_text(rig.read_text().replace("emulated = true", "emulated = false"))
    for camera, word in (("wrist", "Lay the board (192 x 256 mm) flat"), ("front", "between the open pads")):
        assert run("hand-eye", "--camera", camera, "--backend", "ur7e", "--rig", str(rig)) == 2
        shown = capsys.readouterr()
        assert word in shown.out and "nobody is there to do this" in shown.err


def test_a_rig_file_that_lies_there_is_not_replaced_by_the_built_in_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    mine = (resources.files("resync_robot.core") / "simulated_rig.toml").read_text("utf-8")
    for words in (
        ("hand-eye",),
        ("hand-eye", "--write", "rig.toml"),
        ("intrinsics", "--write", "rig.toml"),
        ("noise", "--write", "rig.toml"),
        ("hues", "--names", "b0", "--write", "rig.toml"),
    ):
        for content, word in ((mine, "give --rig rig.toml"), ("mine", "exists and is not a rig file")):
            Path("rig.toml").write_text(content, encoding="utf-8")
            assert run(*words) == 2
            assert word in capsys.readouterr().err
            assert Path("rig.toml").read_text(encoding="utf-8") == content


def test_pictures_of_an_earlier_run_are_enough(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    rig = load_rig()
    truth = rig.camera("wrist").pose @ synthetic.jolt(np.random.default_rng(0), 0.02, 0.01)
    stored(Path("views"), rig, truth)
    assert run("hand-eye", "--views", "views", "--out", "run") == 0
    said = capsys.readouterr().out
    assert "14 of 14 views" in said and "on views held out" in said
    found = load_rig(Path("rig.toml")).camera("wrist")
    np.testing.assert_allclose(found.pose, truth, atol=1e-3)
    assert found.calibration is not None and found.calibration.checked == date.today().isoformat()
    assert found.calibration.held_out_mm < 1.0
    assert len(list(Path("run/overlays").glob("*.png"))) == 3
    assert tomllib.loads(Path("rig.toml").read_text())["cameras"][1]["name"] == "front"

    assert run("check", "--views", "views", "--rig", "rig.toml") == 0
    assert run("check", "--views", "views") == 3, "the built-in rig does not know that the camera was moved"
    assert "hand-eye --camera wrist" in capsys.readouterr().out
    assert run("intrinsics", "--views", "views") == 0
    assert "off by" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("kind", "word"),
    [
        ("few", "usable pictures"),
        ("flat", "too flat"),
        ("size", "measures squares of 32."),
        ("board", "usable pictures"),
        ("absent", "no board of"),
        ("moved", "the board moved"),
    ],
)
def test_pictures_from_which_nothing_follows_are_one_error_and_stay(
    kind: str, word: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    rig = load_rig()
    count, tilt = (5 if kind == "few" else 14), (5.0 if kind == "flat" else 45.0)
    stored(Path("views"), rig, rig.camera("wrist").pose, count, tilt, kind)
    before = sorted(p.name for p in Path("views").iterdir())
    more = {"size": ("--board.square", "0.034"), "board": ("--board.dictionary", "5x5_50")}.get(kind, ())
    assert run("hand-eye", "--views", "views", "--write", "rig.toml", *more) == 2
    shown = capsys.readouterr().err
    assert shown.startswith("error: ") and word in shown and "--views views" in shown and "\n  -> " in shown
    assert not Path("rig.toml").exists()
    assert sorted(p.name for p in Path("views").iterdir()) == before


def test_a_deployment_warns_of_an_old_or_bad_calibration(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    fresh = replace(RECORD, checked=date.today().isoformat())
    old = replace(RECORD, checked=(date.today() - timedelta(days=100)).isoformat(), held_out_px=4.0)
    update_rig(None, path, "wrist", {}, fresh)
    update_rig(path, path, "front", {}, old)
    rig = load_rig(path)
    lines = calibration_complaints(DeployConfig(), rig)
    assert len(lines) == 2 and all("front" in line for line in lines)
    assert calibration_complaints(DeployConfig(), load_rig()) == []
    emulated = load_rig(Path(__file__).parents[2] / "hardware" / "emulated.toml")
    assert calibration_complaints(DeployConfig(backend="ur7e"), emulated) == [], "its cameras stand where it says"
    assert emulated.controller is not None
    real = replace(emulated, controller=replace(emulated.controller, emulated=False))
    assert len(calibration_complaints(DeployConfig(backend="ur7e"), real)) == 1
    on_a_real_arm = calibration_complaints(DeployConfig(backend="ur7e"), rig)
    assert len(on_a_real_arm) == 3 and any("'side' has never" in line for line in on_a_real_arm)


@pytest.mark.slow
@pytest.mark.parametrize("camera", ["wrist", "front"])
def test_in_simulation_a_knocked_camera_is_found(
    renderer: None, camera: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run("hand-eye", "--camera", camera, "--poses", "16", "--seed", "1", "--write", "rig.toml") == 0
    assert "the simulator's truth is 0." in capsys.readouterr().out
    rig, truth = load_rig(Path("rig.toml")), displaced(load_rig(), 1).camera(camera)
    found = rig.camera(camera).pose
    assert np.linalg.norm(found[:3, 3] - truth.pose[:3, 3]) < 0.001
    assert np.degrees(np.linalg.norm(spatial.rotation_vector(found[:3, :3].T @ truth.pose[:3, :3]))) < 0.1
    assert run("check", "--camera", camera, "--seed", "1", "--rig", "rig.toml") == 0
    assert run("check", "--camera", camera, "--seed", "2", "--rig", "rig.toml") == 3, "another machine"


@pytest.mark.slow
def test_the_simulation_is_drawn_over_the_picture(
    renderer: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run("check", "--live", "--out", "run") == 3
    assert "robot off by" in capsys.readouterr().out
    assert sorted(p.name for p in Path("run").iterdir()) == [
        "live-front.png", "live-side.png", "live-wrist.png", "live.rrd",
    ]  # fmt: skip
    for name, pose in {c.name: c.pose for c in displaced(load_rig(), 0).cameras}.items():
        update_rig(Path("rig.toml") if Path("rig.toml").exists() else None, Path("rig.toml"), name, {"pose": pose})
    assert run("check", "--live", "--rig", "rig.toml") == 0, "with the cameras where they are it fits"


@pytest.mark.slow
@pytest.mark.parametrize("camera", ["wrist", "front"])
def test_the_noise_of_the_simulated_camera_is_measured_and_written(
    renderer: None, camera: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run("noise", "--camera", camera, "--write", "rig.toml") == 0
    found, true = load_rig(Path("rig.toml")).camera(camera).noise, load_rig().camera(camera).noise
    assert found != true
    assert found.disparity_sigma_px == pytest.approx(true.disparity_sigma_px, rel=0.1)
    assert found.ripple_px == pytest.approx(true.ripple_px, abs=0.01)
    assert found.hole_share == pytest.approx(true.hole_share, rel=0.5)
    assert found.colour_sigma == pytest.approx(true.colour_sigma, rel=0.2)


def test_the_colours_of_what_stands_in_a_row_are_learned(
    renderer: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    names = ("cup", "b1", "b2")
    assert run("hues", "--names", *names, "--seed", "5", "--write", "rig.toml") == 0
    assert "cup" in capsys.readouterr().out
    true = row_task(load_rig(), names, 5).physics["colours"]
    found = load_rig(Path("rig.toml")).hues
    for name in names:
        assert apart(found[name], colorsys.rgb_to_hsv(*true[name])[0]) < 0.03


@pytest.mark.slow
def test_a_camera_of_another_size_and_noise_is_measured_as_what_it_is(
    renderer: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    wrist, path = load_rig().camera("wrist"), Path("mine.toml")
    noisy = replace(wrist.noise, disparity_sigma_px=0.2, colour_sigma=5.0)
    twice = {"width": 2 * wrist.width, "height": 2 * wrist.height, "fx": 2 * wrist.fx, "fy": 2 * wrist.fy}
    update_rig(None, path, "wrist", {**twice, "cx": 2 * wrist.cx, "cy": 2 * wrist.cy}, noise=noisy)
    assert run("noise", "--rig", "mine.toml", "--write", "mine.toml") == 0
    found = load_rig(path).camera("wrist")
    assert found.width == 2 * wrist.width
    assert found.noise.disparity_sigma_px == pytest.approx(0.2, rel=0.1)
    assert found.noise.colour_sigma == pytest.approx(5.0, rel=0.2)


@pytest.mark.realtime
def test_the_protocols_of_a_real_arm_serve_as_well(
    renderer: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with emulators.lab(tmp_path) as rig:
        found = ("--backend", "ur7e", "--rig", str(rig), "--write", "mine.toml", "--seed", "5")
        assert run("hues", "--names", "b0", "b1", *found) == 0
        assert run("check", "--live", "--backend", "ur7e", "--rig", str(rig), "--seed", "5") == 3, (
            "cameras were knocked"
        )
    true = row_task(load_rig(), ("b0", "b1"), 5).physics["colours"]
    for name, hue in load_rig(Path("mine.toml")).hues.items():
        assert apart(hue, colorsys.rgb_to_hsv(*true[name])[0]) < 0.03


@pytest.mark.slow
@pytest.mark.realtime
@pytest.mark.parametrize("camera", ["wrist", "front"])
def test_a_knocked_camera_of_an_emulated_arm_is_found_again(
    renderer: None, camera: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with emulators.lab(tmp_path) as rig:
        words = ("--camera", camera, "--backend", "ur7e", "--rig", str(rig), "--seed", "3")
        assert run("hand-eye", *words, "--poses", "16", "--write", "mine.toml") == 0
    found, true = load_rig(Path("mine.toml")).camera(camera), displaced(load_rig(rig), 3).camera(camera)
    off = spatial.inverse(true.pose) @ found.pose
    assert 1000 * np.linalg.norm(off[:3, 3]) < 1.5
    assert np.degrees(np.linalg.norm(spatial.rotation_vector(off[:3, :3]))) < 0.2
