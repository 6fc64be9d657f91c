"""What `resync-robot calibrate` does: the arm goes through its poses, the pictures are judged, a verdict is written."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import date
from pathlib import Path

import numpy as np

from resync_robot.calibrating.machine import Machine, open_machine, picture_folder, poster_of
from resync_robot.calibrating.settings import CheckConfig, HandEyeConfig, IntrinsicsConfig, LookConfig, check_target
from resync_robot.calibration.detect import BoardDetector, Rejected, Sighting
from resync_robot.calibration.hand_eye import Calibrator, HandEye, Noise, View, difference
from resync_robot.calibration.intrinsics import LEAST_VIEWS, check_intrinsics
from resync_robot.calibration.judge import Errors, board_by, held_out, judge
from resync_robot.calibration.overlay import draw_corners, save_picture
from resync_robot.calibration.propose import Proposer, Reach, board_in_hand, board_on_table, with_board
from resync_robot.calibration.rig_file import update_rig
from resync_robot.calibration.shots import Judge, Shot, ShotFolder, read_shots, take, usable
from resync_robot.console import say
from resync_robot.core.calibration_record import CalibrationRecord, complaints
from resync_robot.core.errors import CalibrationError, ResyncError
from resync_robot.core.joints import JointTarget
from resync_robot.core.rig import CameraRig, Rig, load_rig
from resync_robot.hardware.joint_moves import travel
from resync_robot.hardware.stream import Stream
from resync_robot.sim_training.scenes.calibration import Bench

SPARE = 1.5
"""Poses proposed for each picture wanted: some pictures are refused."""
JOINT_NOISE = 3e-4
"""rad by which a simulated arm misreports each joint, pose by pose: some 0.3 mm at the flange."""
LEAST_CHECKED = 4
"""Views of a check."""
WORST_SHOWN = 3
HELD_OPENING = 0.004
"""m between the pads that hold a board."""


def hand_eye(config: HandEyeConfig) -> int:
    """Take pictures (or read them), solve, judge on views held out, write the rig file.

    Raises:
        ResyncError: bad input, or pictures from which nothing follows; the pictures taken are kept.
    """
    rig, camera = _rig_and_camera(config)
    target = config.write or config.rig or Path("rig.toml")
    check_target(target, config.rig)
    folder = picture_folder(config)
    with _keeping(config, folder):
        shots, truth = _shots(config, rig, camera, folder)
        calibrator = _calibrator(config, camera)
        views = _views(calibrator, rig, shots, calibrator.demands.least_views)
        result = calibrator.solve(views, config.seed)
        errors = held_out(calibrator, views, result)
        _draw_views(folder, calibrator, shots, views, result.mount_T_cam, result.other_T_board, result.kept)
        _report(views, result, errors, camera, truth)
        mm, deg, px = errors.rms
        today = date.today().isoformat()
        record = CalibrationRecord(
            calibrated=today, checked=today, method=f"{_kind(camera)}: PARK, then all corners together",
            views=int(result.kept.sum()), left_out=int((~result.kept).sum()),
            held_out_mm=mm, held_out_deg=deg, held_out_px=px,
        )  # fmt: skip
        bad = complaints({camera.name: record}, rig.calibration_limits, date.today())
        if bad:
            raise CalibrationError(f"{'; '.join(bad)}: {target} was not written", f"look at {folder / 'overlays'}")
    noise = Noise()
    scale = max(1.0, result.noise_scale)
    sigmas = {
        "position_sigma": np.hypot(result.position_sigma / np.sqrt(3), noise.arm_position * scale),
        "rotation_sigma": np.hypot(result.rotation_sigma / np.sqrt(3), noise.arm_rotation * scale),
    }
    rounded = {name: float(f"{value:.2g}") for name, value in sigmas.items()}
    update_rig(config.rig, target, camera.name, {"pose": result.mount_T_cam, **rounded}, record)
    say(f"Written: {target}. Overlays: {folder / 'overlays'}. Next:  resync-robot calibrate check --rig {target}")
    return 0


def check(config: CheckConfig) -> int:
    """Judge the rig file's camera pose by fresh pictures of a board, wherever it lies, and by the robot's outline.

    Returns:
        0 where all is within the rig's limits, else 3.
    """
    rig, camera = _rig_and_camera(config)
    if config.rig is not None:
        check_target(config.rig, config.rig)
    folder = picture_folder(config)
    with _keeping(config, folder):
        shots, _ = _shots(config, rig, camera, folder)
        calibrator = _calibrator(config, camera)
        views = _views(calibrator, rig, shots, LEAST_CHECKED)
        board = board_by(calibrator, views, camera.pose)
        errors = judge(calibrator, views, camera.pose, board)
        _draw_views(folder, calibrator, shots, views, camera.pose, board, np.ones(len(views), dtype=bool))
    # The board's place was fitted to the same views, which takes up one of them.
    mm, deg, px = (value * np.sqrt(len(views) / (len(views) - 1)) for value in errors.rms)
    say(f"Camera '{camera.name}' on {len(views)} fresh views: {mm:.2f} mm, {deg:.2f} degrees, {px:.2f} px (rms).")
    old = camera.calibration
    today = date.today().isoformat()
    record = CalibrationRecord(
        calibrated=old.calibrated if old else today, checked=today,
        method=old.method if old else "design value", views=old.views if old else 0,
        left_out=old.left_out if old else 0, held_out_mm=mm, held_out_deg=deg, held_out_px=px,
    )  # fmt: skip
    bad = complaints({camera.name: record}, rig.calibration_limits, date.today())
    for line in bad:
        say(f"Worse than its limits: {line}.")
    if config.rig is not None:
        update_rig(config.rig, config.rig, camera.name, {}, record)
        say(f"Written: {config.rig}. Overlays: {folder / 'overlays'}")
    if bad:
        say(f"  -> resync-robot calibrate hand-eye --camera {camera.name} --rig {config.rig or 'rig.toml'}")
    return 3 if bad else 0


def intrinsics(config: IntrinsicsConfig) -> int:
    """Compare the rig file's camera matrix with one estimated from pictures of the board."""
    rig, camera = _rig_and_camera(config)
    if config.write is not None:
        check_target(config.write, config.rig)
    folder = picture_folder(config)
    with _keeping(config, folder):
        shots, _ = _shots(config, rig, camera, folder)
        seen = [sighting.corners for _, sighting in usable(shots, LEAST_VIEWS)]
        found = check_intrinsics(config.board, camera, seen)
    names = ("fx", "fy", "cx", "cy")
    values = dict(zip(names, found.matrix[[0, 1, 0, 1], [0, 1, 2, 2]], strict=True))
    for (name, value), sigma in zip(values.items(), found.sigma_px, strict=True):
        say(f"  {name}  rig {getattr(camera, name):8.2f}   found {value:8.2f} +- {sigma:.2f} px")
    say(f"Held-out views: {found.held_out_px:.2f} px (rms). Lens distortion: {found.distortion_px:.2f} px at worst.")
    say(f"The rig file's camera matrix is off by {found.rig_px:.2f} px at worst over the picture.")
    limit = rig.calibration_limits.max_px
    if found.distortion_px > 2 * limit:
        say(f"Warning: distortion above {2 * limit:g} px; let the camera's driver rectify its pictures.")
    if config.write is not None:
        update_rig(config.rig, config.write, camera.name, values)
        say(f"Written: {config.write}. The camera's pose belongs to its matrix: resync-robot calibrate hand-eye next.")
    return 3 if found.rig_px > 3 * limit and config.write is None else 0


# -- parts


def _rig_and_camera(config: LookConfig) -> tuple[Rig, CameraRig]:
    rig = load_rig(config.rig)
    return rig, rig.camera(config.camera)


def _kind(camera: CameraRig) -> str:
    return "eye-in-hand" if camera.mount == "flange" else "eye-to-base"


@contextmanager
def _keeping(config: LookConfig, folder: Path) -> Iterator[None]:
    """Say with every error of the calibration where the pictures are."""
    kept = config.views or folder / "views"
    try:
        yield
    except CalibrationError as error:
        if not (kept / "shots.json").exists():
            raise
        raise CalibrationError(f"{error.what}. The pictures are kept: --views {kept}", error.fix) from None
    except (ResyncError, KeyboardInterrupt):
        # The robot stopped, say, or whoever calibrates ended it.
        if (kept / "shots.json").exists():
            say(f"The pictures so far are kept: --views {kept}")
        raise


def _calibrator(config: LookConfig, camera: CameraRig) -> Calibrator:
    return Calibrator(config.board, camera.intrinsics, camera.mount == "world")


def _views(calibrator: Calibrator, rig: Rig, shots: list[Shot], least: int) -> list[View]:
    return [
        calibrator.view(shot.name, rig.arm.world_T_base @ rig.arm.kinematics.forward(shot.q), sighting.corners)
        for shot, sighting in usable(shots, least)
    ]


def _shots(config: LookConfig, rig: Rig, camera: CameraRig, folder: Path) -> tuple[list[Shot], np.ndarray | None]:
    """The pictures, and the simulator's truth where it took them just now."""
    verdicts = Judge(BoardDetector(config.board, camera.intrinsics))
    if config.views is not None:
        shots = read_shots(config.views, camera.name, verdicts)
        for shot in shots:
            _tell(shot)
        return shots, None
    board = (
        board_in_hand(config.board, rig) if camera.mount == "world" else board_on_table(config.board, config.board_at)
    )
    proposer = Proposer(rig, camera, config.board, board, Reach(most_tilt_deg=config.most_tilt))
    # A check must not repeat the poses, nor the noise, of the calibration that it checks.
    draw = 2 * config.seed + isinstance(config, CheckConfig)
    poses = proposer(int(np.ceil(SPARE * config.poses)), draw)
    keep = ShotFolder(folder / "views", camera.name, config.board)
    taken: list[Shot] = []
    rng = np.random.default_rng([draw, 7])
    bench = Bench(config.seed, poster=poster_of(config.board, camera, board, draw))
    with open_machine(
        config.backend, rig, load_rig(None), bench, [camera], draw, JOINT_NOISE, _for_a_person(config, camera)
    ) as machine:
        stream = Stream(machine.robot, with_board(rig, config.board) if camera.mount == "world" else rig)
        if camera.mount == "world":
            # The sheet is in the hand: the pads close on it.
            stream.run(JointTarget(stream.target.arm, HELD_OPENING), 1.5)
        for shot in take(
            poses,
            lambda q: travel(stream, q),
            lambda: machine.cameras[camera.name].capture().colour,
            lambda: _joints(machine, rng),
            verdicts,
            camera.name,
        ):
            keep.add(shot)
            _tell(shot)
            taken.append(shot)
            if sum(isinstance(s.verdict, Sighting) for s in taken) >= config.poses:
                break
        return taken, machine.truth.get(camera.name)


def _for_a_person(config: LookConfig, camera: CameraRig) -> str:
    width, height = config.board.size
    if camera.mount == "world":
        return f"Hold the board's upper edge between the open pads, printed side towards camera '{camera.name}'."
    x, y = config.board_at
    return f"Lay the board ({1000 * width:.0f} x {1000 * height:.0f} mm) flat, its middle at x {x:g}, y {y:g} m."


def _joints(machine: Machine, rng: np.random.Generator) -> np.ndarray:
    q = machine.robot.state().q
    return q + rng.normal(0.0, machine.joint_noise, 6) if machine.joint_noise else q


def _tell(shot: Shot) -> None:
    if isinstance(shot.verdict, Rejected):
        say(f"  {shot.name}  refused: {shot.verdict.reason}")
    else:
        say(f"  {shot.name}  {len(shot.verdict.corners.ids)} corners at {shot.verdict.depth:.2f} m")


def _report(views: list[View], result: HandEye, errors: Errors, camera: CameraRig, truth: np.ndarray | None) -> None:
    for view, kept, distance in zip(views, result.kept, result.distances, strict=True):
        if not kept:
            say(f"  {view.name}  left out: {distance:.1f} times as far from the others as noise explains")
    mm, deg, px = errors.rms
    moved = difference(camera.pose, result.mount_T_cam)
    say(f"Camera '{camera.name}' ({_kind(camera)}), {result.kept.sum()} of {len(views)} views.")
    say(f"  moved from the rig file's pose by {moved[0]:.1f} mm, {moved[1]:.2f} degrees")
    say(f"  PARK and SHAH differ by {result.park_shah_mm:.2f} mm, {result.park_shah_deg:.3f} degrees")
    say(
        f"  pose known to {1000 * result.position_sigma:.2f} mm, {np.degrees(result.rotation_sigma):.3f} degrees "
        f"(one sigma); views scatter {result.noise_scale:.2f} times as expected"
    )
    say(f"  on views held out: {mm:.2f} mm, {deg:.2f} degrees, {px:.2f} px (rms, one picture each)")
    if truth is not None:
        off = difference(truth, result.mount_T_cam)
        say(f"  the simulator's truth is {off[0]:.2f} mm, {off[1]:.3f} degrees away")


def _draw_views(
    folder: Path,
    calibrator: Calibrator,
    shots: list[Shot],
    views: list[View],
    mount_T_cam: np.ndarray,
    other_T_board: np.ndarray,
    kept: np.ndarray,
) -> None:
    """Overlays of the views left out and of the worst of the others."""
    errors = judge(calibrator, views, mount_T_cam, other_T_board)
    pictures = {s.name: s.colour for s in shots}
    worst = [i for i in np.argsort(-errors.px) if kept[i]][:WORST_SHOWN]
    for i in [*np.flatnonzero(~kept), *worst]:
        view = views[i]
        title = f"{view.name} {'' if kept[i] else 'LEFT OUT '}{errors.mm[i]:.2f} mm, {errors.px[i]:.2f} px"
        predicted = calibrator.predicted(view, mount_T_cam, other_T_board)
        picture = draw_corners(
            pictures[view.name], calibrator.spec, calibrator.intrinsics, view.corners, predicted, title
        )
        save_picture(folder / "overlays" / view.name, picture)
