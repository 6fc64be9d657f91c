"""One rendered scene in which a recovery runs: the teacher's exact state, the student's pictures, one step of both."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import sapien
import torch
from jaxtyping import Float, UInt8
from sapien import render

from resync_robot.core import spatial
from resync_robot.core.rig import CameraRig, Rig
from resync_robot.core.state import State
from resync_robot.core.vocabulary import BOX
from resync_robot.core.world import Window
from resync_robot.learning import camera_view, recovery_policy
from resync_robot.learning.camera_view import PICTURE, VIEWS, Scanned
from resync_robot.learning.carried import Carried
from resync_robot.sim_training.demonstrations.starts import Start, draw_still
from resync_robot.sim_training.failed_worlds import CONTROL_PERIOD, RECOVERY_TORQUE, FailedWorlds, lagging
from resync_robot.sim_training.physics.camera_noise import NoisySensor, Tone
from resync_robot.sim_training.physics.scene import add_camera, build_scene, colour_of, look_through, whole_picture
from resync_robot.sim_training.physics.world import MOVED, SETTLING

FOCAL_SIGMA = 0.005
"""Relative error of a calibrated focal length."""
START_HEIGHT = (0.045, 0.075)
"""m of the tip over the stud at which the policy takes over, around what the skill's approach gives."""
TILTED = 0.3
"""Share of the still moments in which the block stands on an edge or lies on its side. A demonstration hardly ever gets
there, but a student may, and must see it."""
START_SPREAD = 0.006
"""m by which the scan that the approach relies on may be wrong, and some."""
SCAN_SIGMA = {"stud": (0.0015, 0.0015, 0.001), "corner": (0.001, 0.001), "size": (0.0008, 0.0008)}
"""m; errors of what the scan tells. Twice what is measured of simulated scans, for a block may stand in a corner that
no camera sees well."""
SLIPPED, BESIDE = 0.5, 0.002
"""Most of the hand's way that a block did not go along in still moments, and m by which it went elsewhere. Of the
teacher's recoveries one in ten loses more than a twentieth of the way, and half end within 1.5 mm of where the hand
took them."""
REMEMBERED = 0.5
"""Share of the still moments with a block that stands for which the scan tells where it stood before it was moved, as
it does later in a recovery; of the others it tells where the block is now. One that leans has been pressed on."""


@dataclass(frozen=True)
class Seen:
    """What the robot has at one moment.

    Attributes:
        pictures: (views, p, p, 3) uint8.
        q: (6,) rad.
        tip: (3,) m, world.
        carried: (2,) m, world: how far the hand has gone since the scan while it pressed on the block.
    """

    pictures: UInt8[np.ndarray, "v p p 3"]
    q: Float[np.ndarray, "6"]
    tip: Float[np.ndarray, "3"]
    carried: Float[np.ndarray, "2"]


class RenderedRecovery:
    """A recovery in a scene of its own, from `start`, with its own errors of calibration, delays and lag.

    Args:
        rig: as the robot believes it; the scene's cameras stand off it, by the rig's own sigmas.
        lag: most control steps that the arm is behind its commands.
        seed: of everything that is drawn here.
        picture: pixels of a side of what is seen.
        still: no errors of cameras or scan, and no lag: for tests.
    """

    def __init__(
        self, start: Start, rig: Rig, lag: float, seed: int, picture: int = PICTURE, still: bool = False
    ) -> None:
        self._rng = rng = np.random.default_rng([seed, 47])
        self.start, self._rig, self._picture = start, rig, picture
        self._worlds = FailedWorlds([start.task], start.block, rig, np, torch.device("cpu"))
        self._zero = torch.zeros(1, dtype=torch.long)
        self._built = build_scene(start.task, rig, rendered=True)
        self._body = self._built.rigid[start.block]
        self._focal: dict[str, float] = {}
        self._cameras = {name: self._mount(rig.camera(name), still) for name in VIEWS}
        tone = Tone.of(start.task.physics)
        self._sensors = {n: NoisySensor(int(rng.integers(2**31)), rig.camera(n), tone=tone) for n in VIEWS}
        self.lag = torch.tensor([0.0 if still else lag * rng.random()])
        self._exact = still
        self._delayed = not still and rng.random() < 0.5
        self._before: np.ndarray | None = None
        self.stands = self._settle()
        self._scan_rng = np.random.default_rng([seed, 67])
        self.scanned = self._scan(start.task.initial)
        self.sent, self._last = self._place_arm()
        self._carried = Carried(float(self.scanned.stud[2]))
        self._carried.follow(self._tip())
        self.x = self._failure = self._state()
        self.previous = self.x

    @property
    def yaw(self) -> float:
        """Heading of the hand's x axis, rad: square to the box."""
        x = self._built.flange.entity_pose.to_transformation_matrix()
        return float(np.arctan2(x[1, 0], x[0, 0]))

    def see(self) -> Seen:
        """Pictures, which may be one control step old, and the arm as it is."""
        now = self._take()
        shown = now if self._before is None or not self._delayed else self._before
        self._before = now
        return Seen(shown, self._joints(), self._tip(), self._carried.away)

    def step(self, goal: Float[np.ndarray, "3"]) -> None:
        """Send the tip to `goal` over one control step, as late as this arm is."""
        before, command = (torch.as_tensor(v, dtype=torch.float32)[None] for v in (self.sent, goal))
        q = self._worlds.joints_at(lagging(command, before, self.lag), self._zero)[0]
        self._built.approach(self._last, q, 0.0, CONTROL_PERIOD)
        self._last, self.sent = q, np.asarray(goal, dtype=np.float64)
        self._carried.follow(self._tip())
        self.previous, self.x = self.x, self._state()

    def reach(self, wanted: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        """Where the tip is really sent if it is wanted there."""
        row = torch.as_tensor(wanted, dtype=torch.float32)[None]
        return recovery_policy.within_reach(self.x, row)[0].double().numpy()

    def block(self) -> Float[np.ndarray, "7"]:
        """Where the block is, as in `camera_view.BLOCK_NAMES`: what the policy's auxiliary head learns to see."""
        block = self.x[0, recovery_policy.BLOCK].double().numpy()
        world_T_block = spatial.pose_from_features(block[:7])
        top = world_T_block @ np.array([0.0, 0.0, block[9] / 2, 1.0])
        gaps = recovery_policy.wall_gaps(self.x)[0].double().numpy().clip(max=camera_view.WIDEST_GAP)
        away, up = (camera_view.to_hand(v, self.yaw) for v in (top[:3] - self._tip(), world_T_block[:3, 2]))
        return np.concatenate([away, gaps, up[:2]])

    def freeze(self, random: torch.Generator) -> None:
        """Put the block anywhere between its place and the middle of the box, and the hand at rest somewhere over it.

        A recovery's own path hardly shows such moments: a block that is nearly free, or not at all, and a hand that
        has left it. Yet these are what tells a recovery that is done from one that is not.
        """
        still = draw_still(self._failure, random)[0].double().numpy()
        block = still[recovery_policy.BLOCK]
        pose = spatial.pose_from_features(block[:7])
        tips = self._rng.random() < TILTED
        if tips:
            # Small leans are the ones that something can still be done about.
            pose = tilted(pose, block[7], block[9], int(self._rng.integers(4)), np.pi / 2 * self._rng.random() ** 2)
        self._remember(pose, outdated=tips or self._scan_rng.random() < REMEMBERED)
        self._body.entity.set_pose(sapien.Pose(pose))
        self._body.linear_velocity = self._body.angular_velocity = np.zeros(3)
        self.sent = still[recovery_policy.TIP]
        self._last = self._worlds.joints_at(torch.as_tensor(self.sent, dtype=torch.float32)[None], self._zero)[0]
        self._built.set_configuration(self._last, 0.0)
        self._before = None
        self.x = self.previous = self._state()

    def _remember(self, pose: Float[np.ndarray, "4 4"], outdated: bool) -> None:
        """What a scan told, and how far the hand went since, with the block at `pose` now: of where it is, or of where
        it stood before a hand took it there."""
        before, block, rng = self.start.task.initial, self.start.block, self._scan_rng
        now = before.with_features(block, x=pose[0, 3], y=pose[1, 3])
        self.scanned = self._scan(before if outdated else now)
        self._carried = Carried(float(self.scanned.stud[2]))
        if outdated:
            moved = pose[:2, 3] - np.array(before.get(block, "x", "y"))
            self._carried.away = moved / (1 - SLIPPED * rng.random() ** 3) + rng.normal(0.0, BESIDE, 2)

    def _scan(self, state: State) -> Scanned:
        """What a scan would tell of `state`, with its errors."""
        box = next(o for o in state.objects if o.type == BOX)
        true = Scanned.of(state, self.start.block, box)
        sigma = {k: np.zeros(len(v)) if self._exact else np.array(v) for k, v in SCAN_SIGMA.items()}
        return Scanned(*(getattr(true, k) + self._scan_rng.normal(0.0, v) for k, v in sigma.items()))

    def _settle(self) -> bool:
        places = {o: b.entity_pose.p.copy() for o, b in self._built.rigid.items() if b is not None}
        for _ in range(self._built.solver.steps(SETTLING)):
            self._built.scene.step()
        return all(np.linalg.norm(self._built.rigid[o].entity_pose.p - p) < MOVED for o, p in places.items())

    def _place_arm(self) -> tuple[np.ndarray, np.ndarray]:
        x, y, z, height = self.start.task.initial.get(self.start.block, "x", "y", "z", "size_z")
        rng = self._rng
        tip = np.array([x, y, z + height / 2 + recovery_policy.STUD + rng.uniform(*START_HEIGHT)])
        tip[:2] += rng.uniform(-START_SPREAD, START_SPREAD, 2)
        q = self._worlds.joints_at(torch.as_tensor(tip, dtype=torch.float32)[None], self._zero)[0]
        self._built.set_torque_limits(RECOVERY_TORQUE)
        self._built.set_configuration(q, 0.0)
        for _ in range(self._built.solver.steps(0.02)):
            self._built.scene.step()
        return tip, q

    def _joints(self) -> np.ndarray:
        return self._built.robot.qpos[self._built.arm_index].astype(np.float64)

    def _tip(self) -> np.ndarray:
        return self._rig.tip_pose(self._joints())[:3, 3].copy()

    def _state(self) -> torch.Tensor:
        pose = self._body.entity_pose
        commanded = torch.as_tensor(self.sent, dtype=torch.float32)[None]
        return self._worlds.states(self._joints()[None], np.concatenate([pose.p, pose.q])[None], commanded, self._zero)

    def _mount(self, camera: CameraRig, still: bool) -> render.RenderCameraComponent:
        rng = self._rng
        error, focal = np.eye(4), 1.0
        if not still:
            turn = rng.normal(0.0, camera.rotation_sigma, 3)
            error = spatial.transform(spatial.rotation_from_vector(turn), rng.normal(0.0, camera.position_sigma, 3))
            focal = 1.0 + rng.normal(0.0, FOCAL_SIGMA)
        self._focal[camera.name] = focal
        return add_camera(
            self._built.scene, self._built.robot, camera, camera.pose @ error, (self._picture, self._picture)
        )

    def _take(self) -> UInt8[np.ndarray, "v p p 3"]:
        """Only the windows are rendered: a fraction of the whole pictures' pixels, and the same rays."""
        q = self._joints()
        tip = self._rig.tip_pose(q)[:3, 3]
        return self._through(lambda camera: camera_view.window_at(camera, self._rig.camera_pose(camera, q), tip))

    def overview(self) -> Seen:
        """As `see`, but the whole pictures, squeezed, of this moment."""
        return Seen(self._through(whole_picture), self._joints(), self._tip(), self._carried.away)

    def _through(self, window_of: Callable[[CameraRig], Window]) -> UInt8[np.ndarray, "v p p 3"]:
        self._built.scene.update_render()
        taken = []
        for name, component in self._cameras.items():
            camera = self._rig.camera(name)
            look_through(component, camera, window_of(camera), self._focal[name])
            component.take_picture()
            taken.append(self._sensors[name].colour(colour_of(component)))
        return np.stack(taken)


def tilted(
    world_T_block: Float[np.ndarray, "4 4"], width: float, height: float, edge: int, angle: float
) -> Float[np.ndarray, "4 4"]:
    """The block turned by `angle` rad over one of its four lower edges; what it stands on is not entered."""
    side = spatial.rotation_about("z", edge * np.pi / 2)
    pivot = side @ np.array([width / 2, 0.0, -height / 2])
    turned = side @ spatial.rotation_about("y", angle) @ side.T
    return world_T_block @ spatial.transform(turned, pivot - turned @ pivot)
