"""A recording that has a little of everything."""

from __future__ import annotations

import numpy as np

from resync_robot.core.episode_records import EpisodeMeta, EventKind, Timing
from resync_robot.core.episode_writer import EpisodeWriter
from resync_robot.core.joints import JointTarget
from resync_robot.core.rig import load_rig
from resync_robot.core.state import State
from resync_robot.core.vocabulary import BLOCK
from resync_robot.core.world import CameraFrame

SIX = np.linspace(-1, 1, 6)


def meta() -> EpisodeMeta:
    return EpisodeMeta.of(
        load_rig(), library_hash="abc", domain="d", scenario="S1", goal="On(b1, b0)", seed=3, backend="sim"
    )


def block_state(x: float) -> State:
    features = np.array([x, 0, 0.02, 1, 0, 0, 0, 0.06, 0.06, 0.045])
    return State({BLOCK("b0"): features}, {BLOCK("b0"): np.eye(10) * 1e-6})


def write(path, seconds: float = 3.0, begin: float = 0.0) -> None:
    """Fifty joint messages a second, and one of everything else each second."""
    rng = np.random.default_rng(0)
    with EpisodeWriter(path, meta(), begin) as writer:
        for k in range(int(seconds * 50)):
            t = begin + k * 0.02
            target = JointTarget(SIX * k, 0.1)
            writer.joints(t, SIX * k + 0.01, SIX, 0.09, target, target)
            writer.tip_force(t, np.array([0.0, 1.0, k]))
            if k % 50 == 0:
                writer.event(t, EventKind.SCAN, "looked", pose=np.eye(2))
                writer.state(t, block_state(k * 0.02))
                writer.truth(t, block_state(k * 0.02 + 0.001))
                writer.atoms(t, {"On(b0, b1)": 0.25, "HandEmpty(r)": 1.0})
                writer.plan(t, ["Pick(r, b0)", "Insert(r, b0, b1)"], k // 50, "first")
                xyz = rng.normal(size=(200, 3)).astype(np.float32)
                writer.points(t, xyz, np.tile(np.array([7, 8, 9], np.uint8), (200, 1)))
                frame = CameraFrame(
                    "wrist", np.zeros((4, 6, 3), np.uint8), np.zeros((4, 6), np.uint16), np.eye(3) * 2, np.eye(4), t
                )
                writer.picture(frame, rng.bytes(3000), b"png")
                writer.window("wrist", t, b"png")
                writer.film("wrist", t, b"\xff\xd8jpeg")
                writer.timing(Timing(t - 0.08, t - 0.01, t, 0.002))
        writer.flush()
        assert writer.error is None
