"""A recording becomes a drawing that Rerun can load, with everything in it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from resync_robot.commands.review import ReviewConfig, review
from resync_robot.core import spatial
from resync_robot.core.episode import read_episode
from resync_robot.core.episode_records import EpisodeMeta, EventKind
from resync_robot.core.episode_writer import EpisodeWriter
from resync_robot.core.errors import ConfigError, EpisodeError, ResyncError
from resync_robot.core.joints import ARM_JOINTS, JointTarget
from resync_robot.core.rig import load_rig
from resync_robot.core.state import State
from resync_robot.core.vocabulary import BLOCK, BOX, ROBOT
from resync_robot.core.world import CameraFrame

B0, B1, TRAY, HAND = BLOCK("b0"), BLOCK("b1"), BOX("box"), ROBOT("r")
STEPS = ("Slide(r, b0)", "Pick(r, b1)", "Insert(r, b1, b0)")


def scene(t: float, noise: float = 0.0) -> State:
    """A block sliding out of the corner of a box, another at rest, the hand above."""
    b0 = np.array([0.35 + 0.02 * t + noise, 0.1, 0.03, 1, 0, 0, 0, 0.06, 0.06, 0.045])
    b1 = np.array([0.5, -0.1, 0.03, *spatial.quat_from_yaw(0.3), 0.06, 0.05, 0.045])
    tray = np.array([0.45, 0, 0.005, 1, 0, 0, 0, 0.3, 0.3, 0.11, 0.03])
    hand = np.array([0.4, 0.1, 0.2, 0, 1, 0, 0, 0.08])
    spread = np.diag([1e-6, 4e-6, 2e-6, *[1e-4] * 4, *[1e-6] * 3])
    return State({B0: b0, B1: b1, TRAY: tray, HAND: hand}, {B0: spread, B1: spread} if noise else None)


def synthetic_episode(path, seconds: float = 4.0) -> None:
    """What a deployment would record, made up: motion at 50 Hz, beliefs at 5 Hz, a scan and a step each second."""
    rig, rng = load_rig(), np.random.default_rng(0)
    meta = EpisodeMeta.of(
        rig, library_hash="0" * 16, domain="cornered-insertion-s", scenario="S1", goal="On(b1, b0)", seed=1,
        backend="sim", versions={"resync-robot": "0.1"},
    )  # fmt: skip
    with EpisodeWriter(path, meta) as writer:
        for k in range(int(50 * seconds)):
            t = k / 50
            asked = JointTarget(rig.arm.home + 0.2 * np.sin(t), 0.08)
            sent = JointTarget(asked.arm - 0.002, 0.081)
            measured = sent.arm + rng.normal(0, 1e-4, 6)
            writer.joints(t, measured, 0.2 * np.cos(t) * np.ones(6), 0.082, sent, asked)
            writer.tip_force(t, np.array([0, 0, 5 * np.sin(t)]))
            if k % 10 == 0:
                writer.state(t, scene(t, 0.001) if t < 3 else scene(t, 0.001).project([TRAY, B1, HAND]))
                writer.truth(t, scene(t))
                writer.atoms(t, {"Free(b0)": t / seconds, "On(b1, b0)": 0.02, "HandEmpty(r)": 0.99})
            if k % 50 == 0:
                step = min(k // 50, 2)
                if k:
                    writer.event(t, EventKind.SKILL_END, f"{STEPS[step - 1]}: done", ending="done")
                writer.event(t, EventKind.SKILL_START, STEPS[step], step=step)
                writer.plan(t, STEPS, step, "the goal does not hold")
                record_pictures(writer, rig, measured, t)
                writer.points(t, rng.normal((0.45, 0, 0.05), 0.1, (500, 3)), rng.integers(0, 255, (500, 3), np.uint8))
        writer.event(seconds, EventKind.GIVE_UP, "no plan")


def record_pictures(writer, rig, q, t) -> None:
    for camera in rig.cameras:
        mount = rig.arm.world_T_base @ (rig.arm.kinematics.forward(q) if camera.mount == "flange" else np.eye(4))
        pose = mount @ camera.pose if camera.mount == "flange" else camera.pose
        colour = np.full((camera.height, camera.width, 3), 90, np.uint8)
        depth = np.full((camera.height, camera.width), 6000, np.uint16)
        frame = CameraFrame(camera.name, colour, depth, camera.intrinsics, pose, t)
        writer.picture(
            frame, *(cv2.imencode(kind, image)[1].tobytes() for kind, image in ((".jpg", colour), (".png", depth)))
        )


@pytest.fixture(scope="module")
def episode(tmp_path_factory):
    path = tmp_path_factory.mktemp("recorded") / "episode.mcap"
    synthetic_episode(path)
    return path


@pytest.fixture(scope="module")
def drawing(episode, tmp_path_factory):
    path = tmp_path_factory.mktemp("drawn") / "new" / "episode.rrd"
    review(ReviewConfig(episode=episode, save=path))
    return path


@pytest.fixture(scope="module")
def columns(drawing):
    import rerun as rr

    recording = rr.dataframe.load_recording(drawing)
    assert recording.application_id() == "resync-robot"
    return recording


def table(recording, entity):
    """Every row of one entity, as a pandas-free column mapping."""
    view = recording.view(index="time", contents=entity)
    return view.select().read_all().to_pydict()


def test_every_part_is_in_the_drawing(columns):
    entities = {c.entity_path for c in columns.schema().component_columns()}
    wanted = {"/about", "/plan", "/events", "/atoms_now", "/world/points", "/world/robot/hand/left_finger"}
    wanted |= {f"/world/robot/{j}" for j in ARM_JOINTS}
    wanted |= {f"/joints/{j}/{kind}" for j in ARM_JOINTS for kind in ("measured", "sent", "requested")}
    wanted |= {f"/world/cameras/{c}/{kind}" for c in ("wrist", "front", "side") for kind in ("colour", "depth")}
    wanted |= {f"/world/{kind}/{o}/body" for kind in ("belief", "truth") for o in ("b0", "b1", "box")}
    wanted |= {"/world/belief_uncertainty/b0", "/tip_force/z", "/gripper/sent", "/atoms/Free\\(b0\\)"}
    assert wanted <= entities, sorted(wanted - entities)


def test_the_viewer_finds_no_fault_with_the_file(drawing):
    done = subprocess.run([sys.executable, "-m", "rerun_cli", "rrd", "verify", str(drawing)], capture_output=True)
    assert done.returncode == 0, done.stderr.decode()


def test_the_recording_itself_opens_in_the_viewer(episode, tmp_path):
    """By Rerun's own reader of ROS 2, which knows nothing of this program."""
    import rerun as rr

    opened = tmp_path / "opened.rrd"
    command = [sys.executable, "-m", "rerun_cli", "mcap", "convert", str(episode), "-o", str(opened)]
    done = subprocess.run([*command, "--disable-raw-fallback"], capture_output=True)
    assert done.returncode == 0, done.stderr.decode()
    columns = {(c.entity_path, c.archetype) for c in rr.dataframe.load_recording(opened).schema().component_columns()}
    shown = {(path, str(archetype).rsplit(".", 1)[-1]) for path, archetype in columns}
    for camera in ("wrist", "front", "side"):
        assert (f"/camera/{camera}/colour", "EncodedImage") in shown
        assert (f"/camera/{camera}/depth_mm", "DepthImage") in shown
        assert (f"/camera/{camera}/camera_info", "Pinhole") in shown
    assert ("/joint_states", "Scalars") in {(f"/{path.split('/')[1]}", kind) for path, kind in shown}
    assert {"/plan_text", "/atoms_text", "/rosout"} <= {path for path, _ in shown}


def test_joints_are_drawn_as_recorded(columns, episode):
    rows = table(columns, "/joints/elbow_joint/measured")
    values = [v[0] for name, column in rows.items() if "Scalars" in name for v in column if v]
    np.testing.assert_allclose(values, [j.measured[2] for j in read_episode(episode).joints()])


def test_the_hand_is_where_kinematics_puts_it(columns, episode):
    rows = table(columns, "/world/robot/hand")
    drawn = [v[0] for v in rows["/world/robot/hand:Transform3D:translation"] if v]
    joints = list(read_episode(episode).joints())
    arm = load_rig().arm
    start = arm.world_T_base @ arm.kinematics.forward(joints[0].measured)
    np.testing.assert_allclose(drawn[0], start[:3, 3], atol=1e-6)
    assert len(drawn) == pytest.approx(len(joints) / 2, abs=2), "thinned to 25 Hz"


def test_links_reach_from_joint_to_joint(columns):
    """A capsule's far end, seen from the world, is the frame of the joint before."""
    import rerun as rr

    from resync_robot.deployment.rerun_view.arm import _capsule

    arm = load_rig().arm
    frames = [np.eye(4), *arm.kinematics.link_frames(arm.home)]
    for i in range(6):
        back = spatial.inverse(frames[i + 1]) @ frames[i]
        capsule = _capsule(back[:3, 3], 0.05)
        assert isinstance(capsule, rr.Capsules3D)
        rotation = capsule.rotation_axis_angles.as_arrow_array().to_pylist()[0]
        turned = spatial.rotation_from_vector(np.array(rotation["axis"]) * rotation["angle"])
        length = capsule.lengths.as_arrow_array().to_pylist()[0]
        np.testing.assert_allclose(turned @ [0, 0, length], back[:3, 3], atol=1e-6)


def test_the_plan_marks_the_step_under_way(columns):
    rows = table(columns, "/plan")
    text = next(v[0] for v in rows["/plan:TextDocument:text"][1:] if v)
    assert text.startswith("**Pick(r, b1)**") and "the goal does not hold" in text
    steps = "1. ~~Slide(r, b0)~~ done\n2. **Pick(r, b1)** ◀ under way\n3. Insert(r, b1, b0) ◁ next"
    assert text.endswith(steps)


def test_an_object_no_longer_believed_in_disappears(columns):
    for entity in ("/world/belief/b0", "/world/belief_uncertainty/b0"):
        view = columns.view(index="time", contents=f"{entity}/**", include_tombstone_columns=True)
        rows = view.select().read_all().to_pydict()
        cleared = rows[f"{entity}:Clear:is_recursive"]
        times = [t.total_seconds() for t, c in zip(rows["time"], cleared, strict=True) if c]
        assert times == [3.0]


def test_uncertainty_is_two_standard_deviations(columns):
    rows = table(columns, "/world/belief_uncertainty/b1")
    half = next(v[0] for v in rows["/world/belief_uncertainty/b1:Ellipsoids3D:half_sizes"] if v)
    np.testing.assert_allclose(sorted(half), 2 * np.sqrt([1e-6, 2e-6, 4e-6]), rtol=1e-4)


def test_a_torn_recording_is_drawn_up_to_the_tear(episode, tmp_path, caplog):
    torn, out = tmp_path / "torn.mcap", tmp_path / "torn.rrd"
    data = episode.read_bytes()
    torn.write_bytes(data[: len(data) // 2])
    review(ReviewConfig(episode=torn, save=out))
    assert out.stat().st_size > 10_000
    assert "is not whole" in caplog.text


def test_a_torn_recording_is_mended_for_every_reader(episode, tmp_path, capsys):
    from mcap.reader import make_reader

    torn, mended = tmp_path / "torn.mcap", tmp_path / "mended.mcap"
    data = episode.read_bytes()
    torn.write_bytes(data[: int(0.6 * len(data))])
    review(ReviewConfig(episode=torn, mend=mended))
    shown = capsys.readouterr().out
    assert f"of {torn.stat().st_size} bytes are whole, with " in shown and "something is missing after " in shown
    before, after = read_episode(torn), read_episode(mended)
    assert after.damage is None and after.messages == before.messages
    with mended.open("rb") as file:
        count = sum(1 for _ in make_reader(file).iter_messages())
    assert count == sum(map(len, before.messages.values())) > 100
    with pytest.raises(EpisodeError, match="File exists"):
        review(ReviewConfig(episode=torn, mend=mended))


def test_a_hole_in_the_middle_costs_only_what_was_in_it(episode, tmp_path, capsys, caplog):
    data = episode.read_bytes()
    holed, mended = tmp_path / "holed.mcap", tmp_path / "mended.mcap"
    holed.write_bytes(data[: len(data) // 2] + bytes(2000) + data[len(data) // 2 + 2000 :])
    review(ReviewConfig(episode=holed, save=tmp_path / "holed.rrd"))
    assert "is not whole: it is damaged; " in caplog.text and "something is missing from " in caplog.text
    review(ReviewConfig(episode=holed, mend=mended))
    assert "something is missing from " in capsys.readouterr().out
    whole, left = read_episode(episode), read_episode(mended)
    assert left.damage is None and left.duration == whole.duration and left.meta == whole.meta
    ((begin, end),) = read_episode(holed).missing
    assert 0 < begin <= end < whole.duration
    for topic, messages in left.messages.items():
        assert set(messages) <= set(whole.messages[topic])
    lost = [t for topic, all_ in whole.messages.items() for t, _ in set(all_) - set(left.messages.get(topic, ()))]
    assert lost and begin <= min(lost) and max(lost) <= end


def test_a_recording_with_nothing_but_meta(tmp_path):
    path = tmp_path / "e.mcap"
    meta = EpisodeMeta.of(load_rig(), library_hash="", domain="", scenario="", goal="", seed=0, backend="sim")
    EpisodeWriter(path, meta).close()
    review(ReviewConfig(episode=path, save=tmp_path / "e.rrd"))
    assert (tmp_path / "e.rrd").stat().st_size > 0


def test_without_a_display_the_message_says_what_to_do(episode, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    with pytest.raises(EpisodeError, match=r"--save episode\.rrd"):
        review(ReviewConfig(episode=episode))


def test_a_recording_that_is_not_there_is_missed_before_a_display_is(episode, tmp_path, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.chdir(tmp_path)
    missing = ReviewConfig(episode=Path("missing.mcap"))
    with pytest.raises(
        EpisodeError, match=r"there is no recording missing\.mcap\n  -> record one: resync-robot deploy"
    ):
        review(missing)
    for name, age in (("old.mcap", 1), ("new.mcap", 2)):
        path = tmp_path / "runs" / "today-deploy" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(episode.read_bytes())
        os.utime(path, (age, age))
    with pytest.raises(EpisodeError, match=r"resync-robot review runs/today-deploy/new\.mcap"):
        review(missing)
    with pytest.raises(EpisodeError, match=r"is a folder\n.* review .*today-deploy/new\.mcap"):
        review(ReviewConfig(episode=tmp_path / "runs" / "today-deploy"))


def test_a_drawing_that_is_saved_says_how_to_open_it(episode, tmp_path, capsys):
    review(ReviewConfig(episode=episode, save=tmp_path / "e.rrd"))
    assert f"Open it where a viewer runs:  rerun {tmp_path}/e.rrd" in capsys.readouterr().out


def test_unusable_files(tmp_path, episode):
    (tmp_path / "none.mcap").write_bytes(b"")
    with pytest.raises(EpisodeError, match=r"none\.mcap"):
        review(ReviewConfig(episode=tmp_path / "none.mcap", save=tmp_path / "x.rrd"))
    with pytest.raises(ConfigError, match="cannot write --save"):
        review(ReviewConfig(episode=episode, save=episode / "x.rrd"))


@pytest.mark.parametrize("option", ["save", "mend"])
def test_neither_the_recording_nor_another_file_is_replaced(option, episode, tmp_path):
    mine = tmp_path / "mine.mcap"
    mine.write_bytes(episode.read_bytes())
    (tmp_path / "link.rrd").symlink_to(mine)
    (tmp_path / "notes.rrd").write_text("mine")
    other = tmp_path / "other.mcap"
    other.write_bytes(episode.read_bytes())
    for name, word in (("mine.mcap", "is the file that is read"), ("link.rrd", "is the file that is read"),
                       ("notes.rrd", "exists and is not"), ("other.mcap", "exists")):  # fmt: skip
        with pytest.raises(ResyncError, match=word):
            review(ReviewConfig(episode=mine, **{option: tmp_path / name}))
    assert mine.read_bytes() == other.read_bytes() == episode.read_bytes()
    assert (tmp_path / "notes.rrd").read_text() == "mine" and len(list(tmp_path.iterdir())) == 4


@pytest.mark.parametrize("option", ["--save", "--mend"])
def test_a_full_disk_leaves_nothing_half_written(option, episode, tmp_path):
    """The limit on a file's size stands for the end of the disk."""
    out, before = tmp_path / "out", b"RRF2 of an earlier time"
    if option == "--save":
        out.write_bytes(before)
    code = (
        "import resource, signal, sys; from resync_robot.cli import main\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN); resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, -1))\n"
        f"sys.exit(main(['review', {str(episode)!r}, {option!r}, {str(out)!r}]))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 3 and done.stderr.startswith(
        f"error: cannot write {out}: File too large\n  -> free space"
    )
    assert [p.read_bytes() for p in tmp_path.iterdir()] == ([before] if option == "--save" else [])


def test_a_name_that_the_locale_cannot_spell_makes_one_file(episode, tmp_path):
    """Rerun's own writer would take the bytes of a name for UTF-8."""
    code = "import sys; from resync_robot.cli import main; sys.exit(main(['review', *sys.argv[1:]]))"
    name = os.fsencode(tmp_path) + b"/gr\xf6\xdfe.rrd"
    environment = os.environ | {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    command = [sys.executable, "-c", code, str(episode), "--save", name]
    done = subprocess.run(command, capture_output=True, env=environment)
    assert done.returncode == 0, done.stderr
    assert os.listdir(os.fsencode(tmp_path)) == [b"gr\xf6\xdfe.rrd"]  # noqa: PTH208 - bytes


def test_importing_review_is_cheap():
    program = (
        "import sys, resync_robot.commands.review; print(sorted({'numpy', 'rerun', 'cv2', 'mcap'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
