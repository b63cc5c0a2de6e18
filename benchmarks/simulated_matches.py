"""Matches of a simulated room in two moving eyes, without images, for self-calibration."""

from __future__ import annotations

import numpy as np

from vergence.arrays import Array
from vergence.geometry import se3
from vergence.geometry.camera import project, unproject
from vergence.geometry.eye_motion import eye_poses
from vergence.geometry.head import HeadCalibration
from vergence.geometry.lens import reach
from vergence.geometry.parameters import boxminus, change_named
from vergence.geometry.projection import project_point
from vergence.geometry.se3 import inverse, transform
from vergence.self_calibration.state import FilterState, Keyframe, TrackedFeatures
from vergence.stereo.extrinsics import camera_poses, relative_camera_pose
from vergence.vision.matching.scene_features import Matches

ROOM_M = ((0.5, 4.0), (-2.5, 2.5), (-1.2, 1.2))
"""Where its points are: x ahead, y to the left, z up from the left eye."""


def room(count: int, rng: np.random.Generator) -> Array:
    """Return points (count, 3) [m] that fill the room."""
    return np.stack([rng.uniform(*limits, count) for limits in ROOM_M], axis=1)


def matches(
    truth: HeadCalibration,
    angles: Array,
    points: Array,
    *,
    noise_px: float,
    rng: np.random.Generator,
    outliers: float = 0.0,
    cameras: tuple[str, str] = ("left_wide", "right_wide"),
) -> Matches:
    """Return what two cameras see of points at true angles (r,); a share are wrong by up to 20 px.

    The stated covariance is that of the noise, of 0.02 px at least.
    """
    both = []
    for k, name in enumerate(cameras):
        pixels = project_point(truth, name, angles, points)
        mounted = truth.camera(name)
        camera = mounted.intrinsics
        inside = ((pixels > 0) & (pixels < [camera.width, camera.height])).all(axis=1)
        # Beyond its reach a lens folds back into the image.
        T = eye_poses(truth, angles)[k] @ mounted.T_eye_cam
        T_base_lbase = truth.T_rbase_lbase if mounted.eye == "right" else np.eye(4)
        x, y, z = transform(inverse(T) @ T_base_lbase, points).T
        limit = reach(camera.model, tuple(camera.distortion.tolist()))
        both.append((pixels, inside & (x**2 + y**2 < 0.9 * limit * z**2)))
    seen = both[0][1] & both[1][1]
    left, right = (pixels[seen] for pixels, _ in both)
    right = right + rng.normal(0, noise_px, right.shape)
    wrong = rng.random(len(right)) < outliers
    right[wrong] += rng.uniform(-20, 20, (int(wrong.sum()), 2))
    covariance = np.tile(max(noise_px, 0.02) ** 2 * np.eye(2), (len(left), 1, 1))
    return Matches(left, right, covariance)


def drawn_head(state: FilterState, rng: np.random.Generator) -> HeadCalibration:
    """Return a true head, drawn from what a state believes.

    By the symmetric root of the covariance: other roots hang on the signs of eigenvectors, which
    differ between machines, and Cholesky's asks for more than a covariance that may be singular.
    """
    std = np.sqrt(np.diag(state.covariance))
    unit = np.where(std > 0, std, 1.0)
    values, vectors = np.linalg.eigh(state.covariance / unit / unit[:, None])
    root = vectors * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    return change_named(state.head, state.names, unit * (root @ rng.normal(size=len(unit))))


def turn_error_deg(
    head: HeadCalibration,
    joints: Array,
    truth: HeadCalibration,
    angles: Array,
    cameras: tuple[str, str] | None = None,
) -> float:
    """Return by how much the relative turn of two cameras is wrong [deg], by readings (r,)."""
    T, T_true = (
        relative_camera_pose(each, at, cameras=cameras)
        for each, at in ((head, joints), (truth, angles))
    )
    return float(np.degrees(np.linalg.norm(se3.boxminus(T, T_true)[:3])))


def squared_distance(state: FilterState, truth: HeadCalibration) -> float:
    """Return the squared Mahalanobis distance of what was learned from the true head."""
    difference = boxminus(truth, state.head)
    wrong = np.array([difference[name] for name in state.names])
    return float(wrong @ np.linalg.solve(state.covariance, wrong))


def tracked_features(
    truth: HeadCalibration,
    key: Keyframe,
    *,
    then: Array,
    now: Array,
    points: Array,
    noise_px: float,
    rng: np.random.Generator,
    cameras: tuple[str, str] = ("left_wide", "right_wide"),
) -> TrackedFeatures:
    """Return where the features of a keyframe are, of the same points, at true angles (r,)."""
    found, depths = [], []
    eyes = zip(
        cameras, *(camera_poses(truth, j, cameras=cameras) for j in (then, now)), strict=True
    )
    for k, (name, T_then, T_now) in enumerate(eyes):
        camera, pixels = truth.camera(name).intrinsics, key.pixels[k]
        apart = project_point(truth, name, then, points)[None] - pixels[:, None]
        nearest = np.nan_to_num(np.linalg.norm(apart, axis=2), nan=np.inf).argmin(axis=1)
        depth = transform(inverse(T_then), points[nearest])[:, 2:]
        there = transform(inverse(T_now) @ T_then, unproject(camera, pixels) * depth)
        later = project(camera, there)
        seen = np.flatnonzero(((later > 0) & (later < [camera.width, camera.height])).all(axis=1))
        noise = rng.normal(0, noise_px, (len(seen), 2))
        C = np.tile(max(noise_px, 0.02) ** 2 * np.eye(2), (len(seen), 1, 1))
        found.append(Matches(pixels[seen], later[seen] + noise, C))
        depths.append(key.depths_m[k][seen])
    return TrackedFeatures(key.readings, (found[0], found[1]), (depths[0], depths[1]))
