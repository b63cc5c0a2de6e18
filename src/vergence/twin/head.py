"""The twin itself: moves, looks, reads its sensors, and hands out frames as a real head would."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.errors import check_seed
from vergence.geometry.head import HeadCalibration, base_pose
from vergence.geometry.se3 import inverse, pose, transform
from vergence.twin import renderer
from vergence.twin.designed_head import moving_joints
from vergence.twin.head_model import HeadModel, load_head_model
from vergence.twin.model import as_built_head, body_in_room, compile_head, shared_joints
from vergence.twin.model_joints import body_pose
from vergence.twin.profile import ErrorProfile
from vergence.twin.renderer import Negative, Renderer, overscan_sizes
from vergence.twin.scene import PASSER, Scene, passer_position
from vergence.twin.sensors import play, read

_TICK_STEPS = 5
"""Physics steps of 1 ms between two commands and two entries of the joints' history."""
_HISTORY = 64
"""Entries kept: 0.32 s, beyond the longest delay that a profile may have."""
_AWAY = np.array([0.0, 0.0, -10.0])  # below the floor, where no camera looks


@dataclass(frozen=True, eq=False)
class Exposure:
    """A frame before its pictures are developed."""

    frame: Frame
    """Without images."""
    negatives: tuple[Negative, ...]


class Twin:
    """A simulated head in its room. Use it in a `with` block: it holds OpenGL's resources.

    `truth` and names that begin with `true_` are for evaluation only.
    """

    def __init__(
        self,
        profile: ErrorProfile,
        *,
        head: HeadModel | None = None,
        seed: int = 0,
        lens: str | None = None,
        scene: Scene = "room",
        oversampling: float | None = None,
        furnish: Callable[[mujoco.MjSpec], None] | None = None,
    ):
        """Build a head with the imperfections of a profile.

        `head` is one that `load_head_model` reads; None: the default one, with one of its lenses.
        The same seed gives the same errors, whatever the lens. Oversampling is that of images that
        are distorted; None: OVERSAMPLING of the renderer. `furnish` changes the scene, for example
        its board. VergenceError if there is no OpenGL, or the seed is negative.
        """
        check_seed(seed)
        head = load_head_model(lens=lens) if head is None else head
        self.profile, self.head, self.limits = profile, head, head.limits
        self.nominal: HeadCalibration = head.designed.head
        self.truth: HeadCalibration = as_built_head(
            self.nominal, profile, seed, shared=len(shared_joints(head.designed))
        )
        sizes = overscan_sizes(self.truth)
        self.model = compile_head(head, self.truth, sizes, scene=scene, furnish=furnish)
        self._passes = scene == "moving"
        self._data = mujoco.MjData(self.model)
        self._seen = mujoco.MjData(self.model)  # the pose at which pictures are taken
        self._seed = seed
        neck = len(self.truth.neck.axes)
        self._readings = slice(neck, None)  # columns of a posture, behind the neck's
        self._base = body_in_room(self.model, head.designed.base)
        self.watch: Callable[[float, Array], None] | None = None
        """Called with the time [s] and the posture (j,) [rad] on the sensors' side every 5 ms."""
        names = moving_joints(head.designed)
        of_joint = self.model.actuator_trnid[:, 0].tolist()
        self._addresses = [self.model.joint(name).qposadr[0] for name in names]
        self._actuators = [of_joint.index(self.model.joint(name).id) for name in names]
        # Angles of the model's joints by neck joints and readings, and back.
        rows: dict[str, tuple[Array, float]] = {}
        for eye, joints in head.designed.eyes.items():
            found = self.nominal.kinematics.chains[eye]
            rows |= dict(zip(joints, zip(found.mixing, found.offset_rad, strict=True), strict=True))
        eyes = np.array([rows[name][0] for name in names[neck:]])
        self._mixing: Array = np.asarray(block_diag(np.eye(neck), eyes))
        self._offset = np.array([0.0] * neck + [rows[name][1] for name in names[neck:]])
        self._unmixing = np.linalg.pinv(self._mixing)
        # Aliasing matters more where there is less texture to match.
        usual = renderer.OVERSAMPLING * (2 if scene == "sparse" else 1)
        finer = usual if oversampling is None else oversampling
        self._renderer = Renderer(self.model, self.truth, sizes, profile.image, seed, finer)
        self.restart(0)

    def restart(self, run: int) -> None:
        """Go back to time zero at rest, in an empty room; run and seed determine the noise."""
        self._rng = np.random.default_rng([self._seed, 3, run])
        self._renderer.restart(run)
        mujoco.mj_resetData(self.model, self._data)
        self._data.qpos[:] = self.rest_qpos()
        self._data.ctrl[self._actuators] = self._data.qpos[self._addresses]
        mujoco.mj_forward(self.model, self._data)
        self._times = np.full(_HISTORY, 0.0)
        self._true = np.tile(self._posture(), (_HISTORY, 1))
        self._sensed = self._true.copy()
        self.place_board(None)
        self.place_object(None)
        self.place_hand(None)

    def rest(self) -> Array:
        """Compute the posture (j,) [rad] nearest to zero that the limits admit."""
        return np.clip(np.zeros(len(self.limits.joints)), *self.limits.setpoint_range_rad.T)

    def rest_qpos(self) -> Array:
        """Compute the positions of the model's joints at rest."""
        qpos = self.model.qpos0.copy()
        qpos[self._addresses] = self._mixing @ self.rest() + self._offset
        return qpos

    def posture(self, readings: Array) -> Array:
        """Make the command (j,) of readings of the eyes (r,) [rad] with the neck at rest."""
        return np.concatenate([self.rest()[: self._readings.start], readings])

    @property
    def time_s(self) -> float:
        """Simulated time."""
        return float(self._data.time)

    def advance(self, until_s: float, command: Callable[[float], Array] | Array) -> None:
        """Step the physics until a simulated time.

        The command is (j,) wanted angles [rad] of the neck's joints, then the readings, or a
        function of the time that gives them. The function is sampled every 5 ms of simulated time
        and interpolated, so that the motion does not depend on where it stops.
        """
        backlash = np.radians(self.profile.joints.backlash_deg)
        width = backlash / np.append(
            np.ones(self._readings.start), self.truth.kinematics.gear_ratios
        )
        wanted_at = command if callable(command) else lambda _: command
        last: Array | None = None
        model, data, ctrl, driven = self.model, self._data, self._data.ctrl, self._actuators
        while (left := round((until_s - self._data.time) * 1000)) > 0:
            past = round(self._data.time * 1000) % _TICK_STEPS  # [ms] since it was asked
            begin = self._data.time - past / 1000
            first = wanted_at(begin) if last is None else last
            last = wanted_at(begin + _TICK_STEPS / 1000)
            part = np.arange(past, min(past + left, _TICK_STEPS))[:, None] / _TICK_STEPS
            wanted = (1 - part) * first + part * last
            for controls in wanted @ self._mixing.T + self._offset:
                ctrl[driven] = controls
                mujoco.mj_step(model, data)
            angles = self._posture()
            sensed = play(angles[None], width, self._sensed[-1])[0] if backlash else angles
            latest = (self._times, self._data.time), (self._true, angles), (self._sensed, sensed)
            for history, now in latest:
                history[:-1] = history[1:]
                history[-1] = now
            if self.watch is not None:
                self.watch(self.time_s, sensed)

    def settle(self, command: Array, seconds: float = 0.6) -> None:
        """Go to a posture (j,) and wait until the motion has died away."""
        self.advance(self.time_s + seconds, command)

    def _posture(self) -> Array:
        """Compute the neck's angles and the readings without errors, (j,) [rad]."""
        return self._unmixing @ (self._data.qpos[self._addresses] - self._offset)

    def _at(self, history: Array, time_s: float) -> Array:
        return np.array([np.interp(time_s, self._times, column) for column in history.T])

    def _moments(self) -> tuple[float, float]:
        """Compute when image and joints of a frame that is taken now are sampled [s]."""
        delay = self.profile.joints.delay_ms * 1e-3
        return self.time_s - max(0.0, -delay), self.time_s - max(0.0, delay)

    def true_angles(self) -> Array:
        """Interpolate the true angles (j,) to the moment of an image that is taken now."""
        return self._at(self._true, self._moments()[0])

    def true_readings(self) -> Array:
        """Interpolate the true readings (r,) to the moment of an image that is taken now."""
        return self.true_angles()[self._readings]

    def true_object(self) -> Array:
        """Compute the position (3,) [m] of the object in the left eye's base."""
        return transform(inverse(self.T_world_lbase()), self._data.body("object").xpos)

    def expose(self, cameras: Sequence[str] | None = None) -> Exposure:
        """Take a frame: render, and read the sensors; None: of all cameras."""
        cameras = tuple(self.truth.cameras) if cameras is None else cameras
        image_s, joint_s = self._moments()
        self._seen.qpos[:] = self._data.qpos
        self._seen.qpos[self._addresses] = (
            self._mixing @ self._at(self._true, image_s) + self._offset
        )
        self._seen.mocap_pos[:] = self._data.mocap_pos
        self._seen.mocap_quat[:] = self._data.mocap_quat
        if self._passes:
            passer = self.model.body(PASSER).mocapid[0]
            self._seen.mocap_pos[passer] = self._passer(image_s)
        mujoco.mj_kinematics(self.model, self._seen)
        mujoco.mj_camlight(self.model, self._seen)
        negatives = tuple(self._renderer.expose(self._seen, name) for name in cameras)
        sensed = self._at(self._sensed, joint_s)
        sensors, kinematics = self.profile.joints, self.truth.kinematics
        eye_angles = read(sensed[None, self._readings], sensors, self._rng, kinematics)[0]
        neck_angles, now = sensed[: self._readings.start], self.time_s
        return Exposure(Frame(now, now, eye_angles, neck_angles, {}), negatives)

    def _passer(self, time_s: float) -> Array:
        """Compute where the passing object is; it is hidden while a board is shown."""
        board = self._data.mocap_pos[self.model.body("board").mocapid[0]]
        return passer_position(time_s) if (board == _AWAY).all() else _AWAY

    def develop(self, exposure: Exposure) -> Frame:
        """Finish the pictures of an exposure; may run in another thread than expose."""
        images = {n.camera: self._renderer.develop(n) for n in exposure.negatives}
        return replace(exposure.frame, images=images)

    def capture(self, cameras: Sequence[str] | None = None) -> Frame:
        """Take a frame and finish its pictures; None: of all cameras."""
        return self.develop(self.expose(cameras))

    def true_depth(self, camera: str) -> Array:
        """Render the depth (H, W) [m] along the optical axis of a camera at the last exposure."""
        return self._renderer.true_depth(self._seen, camera)

    def T_world_lbase(self) -> Array:
        """Compute the pose (4, 4) of the left eye's base in the world."""
        T_base_head = self.head.designed.T_base_head
        return body_pose(self._data, self._base) @ T_base_head @ base_pose(self.truth, "left")

    def _place(self, body: str, T_lbase_body: Array | None) -> None:
        mocap = self.model.body(body).mocapid[0]
        if T_lbase_body is None:
            self._data.mocap_pos[mocap] = _AWAY
        else:
            T = self.T_world_lbase() @ T_lbase_body
            self._data.mocap_pos[mocap] = T[:3, 3]
            R = Rotation.from_matrix(T[:3, :3])
            self._data.mocap_quat[mocap] = R.as_quat(scalar_first=True)
        mujoco.mj_kinematics(self.model, self._data)

    def place_board(self, T_lbase_target: Array | None) -> None:
        """Put the board at a pose (4, 4) in the left eye's base frame; None takes it away."""
        self._place("board", T_lbase_target)

    def place_object(self, position: Array | None) -> None:
        """Put the object at (3,) [m] in the left eye's base frame; None takes it away."""
        self._place("object", None if position is None else pose(t=position))

    def place_hand(self, T_lbase_hand: Array | None, *, opening_m: float = 0.0) -> None:
        """Put the hand at a pose (4, 4) in the left eye's base frame; None takes it away.

        Its origin is midway between the faces of the fingers, which are `opening_m` apart.
        """
        self._place("hand", T_lbase_hand)
        for side, sign in (("left", 1), ("right", -1)):
            shift = pose(t=[0, sign * opening_m / 2, 0])
            T = None if T_lbase_hand is None else T_lbase_hand @ shift
            self._place(f"hand_{side}_finger", T)

    def true_hand(self) -> Array:
        """Compute the pose (4, 4) of the hand in the left eye's base."""
        return inverse(self.T_world_lbase()) @ body_pose(self._data, "hand")

    def body_poses(self) -> dict[str, Array]:
        """Compute the world pose (4, 4) of every body at the last exposure, by name."""
        names = [self.model.body(b).name for b in range(self.model.nbody)]
        return {name: body_pose(self._seen, name) for name in names}

    def close(self) -> None:
        """Free OpenGL's resources."""
        self._renderer.close()

    def __enter__(self) -> Twin:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
