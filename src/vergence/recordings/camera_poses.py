"""Where the cameras of a calibrated head were when they took the images of a recording.

The joint readings of an image are those of its moment: they are interpolated between the readings
around it, by the time stamps and the calibrated time offset.
"""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path

import numpy as np

from vergence.arrays import Array
from vergence.data.dataset import (
    Dataset,
    check_readings_match,
    readings_at_images,
    runs,
    time_offset,
)
from vergence.data.description import Description
from vergence.errors import VergenceError
from vergence.geometry.camera import check_image_fits
from vergence.geometry.eye_motion import camera_motion, measured
from vergence.geometry.head import (
    HeadCalibration,
    base_pose,
    parameter_names,
    reading_stds,
    stated_covariance,
    states_covariance,
)
from vergence.geometry.kinematics import EYES
from vergence.geometry.parameters import named_columns
from vergence.geometry.se3 import POSE, boxminus, hat
from vergence.progress import Progress, silent
from vergence.recordings.formats import open_recording
from vergence.recordings.mapped_scan import on_the_clock, scan_mapped
from vergence.recordings.moments import readings_at
from vergence.recordings.pose_tracks import eye_poses
from vergence.recordings.recording_map import RecordingMap
from vergence.recordings.scan import Scan

_STEP_S = 1e-3
"""Half of the time [s] between readings of which the difference gives the rate; joints are read
every few milliseconds."""


@dataclass(frozen=True, eq=False)
class CameraPoses:
    """Poses of the cameras of a head in N images; camera by camera, in order of the recording."""

    head: HeadCalibration
    camera: np.ndarray
    """(N,) of str: which camera took the image."""
    image: np.ndarray
    """(N,) of str: file of a dataset, or channel of a recording."""
    index: np.ndarray
    """(N,) of int: row of a dataset, or number of the image in its channel, from 0."""
    stamp_ns: np.ndarray
    """(N,) of int: time stamp of the image [ns]."""
    readings: Array
    """(N, r) [rad] as used, in the order of head.kinematics.readings; NaN for those that do not
    move the camera. (N, 0) where poses of the eyes were measured."""
    T_head_cam: Array
    """(N, 4, 4)."""
    position_std_m: Array
    """(N,) root mean square length of the error of the position, by the covariance of the
    calibration and the noise of the readings; NaN where the head does not state them."""
    angle_std_rad: Array
    """(N,) the same of the rotation."""
    left_out: Mapping[str, int]
    """By camera the number of images without readings at their moments."""


@dataclass(frozen=True, eq=False)
class _Taken:
    """M images of one camera."""

    camera: str
    image: np.ndarray
    index: np.ndarray
    stamp_ns: np.ndarray
    joints: Callable[[float], Array]
    """Readings (M, r), or poses of the eyes (M, 2, 4, 4), some seconds after the images; NaN: not
    known."""


def dataset_poses(
    dataset: Dataset, head: HeadCalibration, *, progress: Progress = silent
) -> CameraPoses:
    """Compute the poses of the cameras in all images of a dataset.

    VergenceError if its cameras or readings are not those of the head.
    """
    _check(head, dataset.description, str(dataset.folder))
    known = ~_beyond_readings(dataset, time_offset(dataset, head))

    def joints(rows: np.ndarray, later_s: float) -> Array:
        found = readings_at_images(dataset, head, later_s)[rows]
        return np.where(known[rows].reshape(-1, *[1] * (found.ndim - 1)), found, np.nan)

    taken = []
    for name, files in dataset.files.items():
        rows = np.array([k for k, file in enumerate(files) if file is not None], dtype=np.intp)
        stamp_ns = np.round(dataset.time_s[rows] * 1e9).astype(np.int64)
        images = np.array([files[k] for k in rows], dtype=str)
        taken.append(_Taken(name, images, rows, stamp_ns, partial(joints, rows)))
    return _joined([_camera_poses(head, each, progress) for each in taken])


def recording_poses(
    path: Path | str, mapped: RecordingMap, head: HeadCalibration, *, progress: Progress = silent
) -> CameraPoses:
    """Compute the poses of the cameras in all images of a recording.

    VergenceError if the recording is damaged, does not have what the map names, or its cameras or
    readings are not those of the head.
    """
    with open_recording(path) as recording:
        found = scan_mapped(on_the_clock(recording, mapped), mapped, progress=progress)
    return scanned_poses(*found, mapped, head, progress=progress)


def scanned_poses(
    scanned: Scan,
    description: Description,
    mapped: RecordingMap,
    head: HeadCalibration,
    *,
    progress: Progress = silent,
) -> CameraPoses:
    """Compute the poses of the cameras in all images of a scanned recording.

    VergenceError if its cameras or readings are not those of the head.
    """
    _check(head, description, "the recording")
    names = description.head_kinematics.readings

    def joints(stamp_ns: np.ndarray, later_s: float) -> Array:
        at_ns = stamp_ns + round((head.time_offset_s + later_s) * 1e9)
        if mapped.poses:
            return eye_poses(scanned.poses, mapped.poses, at_ns, max_gap_s=mapped.max_gap_s)
        read = readings_at(scanned, mapped, description, at_ns)
        return np.array([read[name] for name in names]).reshape(len(names), len(at_ns)).T

    taken = []
    for name, source in mapped.cameras.items():
        stamp_ns = scanned.images[source.images].stamp_ns
        channel, index = np.full(len(stamp_ns), source.images), np.arange(len(stamp_ns))
        taken.append(_Taken(name, channel, index, stamp_ns, partial(joints, stamp_ns)))
    return _joined([_camera_poses(head, each, progress) for each in taken])


def _check(head: HeadCalibration, description: Description, where: str) -> None:
    """Raise VergenceError if cameras or readings of a recording are not those of a head."""
    for name, camera in description.cameras.items():
        if head.camera(name).eye != camera.eye:
            raise VergenceError(
                f"{name} is in the {head.camera(name).eye} eye of the calibration, but in the "
                f"{camera.eye} eye of {where}."
            )
        shape = camera.height, camera.width
        check_image_fits(name, head.camera(name).intrinsics, shape, whose=f"those of {where}")
    if description.eye_motion != "poses":
        check_readings_match(description, head, where)


def _beyond_readings(dataset: Dataset, offset_s: float) -> np.ndarray:
    """Find the rows (M,) of bool whose image was taken before or after the readings of a motion."""
    run, at_s = runs(dataset), dataset.joint_time_s + offset_s
    if dataset.stream is not None:
        read_s = dataset.stream.time_s
        return (run > 0) & ((at_s < read_s[0]) | (at_s > read_s[-1]))
    beyond = np.zeros(len(run), bool)
    for number in np.unique(run[run > 0]):
        own = run == number
        read_s = dataset.joint_time_s[own]
        beyond[own] = (at_s[own] < read_s.min()) | (at_s[own] > read_s.max())
    return beyond


def _joined(parts: Sequence[CameraPoses]) -> CameraPoses:
    """Join the poses of several cameras; VergenceError if there are none."""
    head, left_out = parts[0].head, ChainMap(*(dict(part.left_out) for part in parts))
    if not any(len(part.camera) for part in parts):
        raise VergenceError(
            f"None of {sum(left_out.values())} images has joint readings at its moment: check the "
            f"time stamps, and the time offset of the calibration, {head.time_offset_s:g} s."
        )
    names = [each.name for each in fields(CameraPoses) if each.name not in ("head", "left_out")]
    columns = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    return CameraPoses(head=head, left_out=dict(left_out), **columns)


def _camera_poses(head: HeadCalibration, taken: _Taken, progress: Progress) -> CameraPoses:
    """Compute the poses of one camera in its images."""
    eye, read = head.camera(taken.camera).eye, taken.joints(0.0)
    moves = np.zeros(read.shape[1], bool)  # the camera: one of two eyes, or some of the readings
    moves[EYES.index(eye) if measured(read) else head.kinematics.used(eye)] = True
    rows = np.flatnonzero(np.isfinite(read[:, moves]).all(axis=tuple(range(1, read.ndim))))
    own, others = (moves[:, None, None], np.eye(4)) if measured(read) else (moves, 0.0)
    before, now, after = (
        np.where(own, taken.joints(seconds)[rows], others) for seconds in (-_STEP_S, 0.0, _STEP_S)
    )
    before, after = (np.where(np.isfinite(each), each, now) for each in (before, after))
    rates = _difference(after, before) / (2 * _STEP_S)
    T_head_cam, stds = np.empty((len(rows), 4, 4)), np.empty((len(rows), 2))
    for k, joints in enumerate(now):
        T_head_cam[k], stds[k] = _pose_and_deviations(head, taken.camera, joints, rates[k])
        if k % 100 == 99 or k + 1 == len(rows):
            progress(f"computing poses of {taken.camera}", k + 1, len(rows))
    return CameraPoses(
        head=head,
        camera=np.full(len(rows), taken.camera),
        image=taken.image[rows],
        index=taken.index[rows],
        stamp_ns=taken.stamp_ns[rows],
        readings=np.empty((len(rows), 0)) if measured(now) else np.where(moves, now, np.nan),
        T_head_cam=T_head_cam,
        angle_std_rad=stds[:, 0],
        position_std_m=stds[:, 1],
        left_out={taken.camera: len(taken.index) - len(rows)},
    )


def _difference(later: Array, earlier: Array) -> Array:
    """Compute the increments (M, r) of readings, or (M, 12) of poses of the eyes."""
    if measured(later):
        return boxminus(later, earlier).reshape(len(later), -1)
    return later - earlier


def _pose_and_deviations(
    head: HeadCalibration, camera: str, joints: Array, rate: Array
) -> tuple[Array, tuple[float, float]]:
    """Compute T_head_cam (4, 4), and the deviations of its turn [rad] and its shift [m].

    At readings (r,) that change by a rate (r,) [1/s], or at poses (2, 4, 4) of the eyes.
    """
    motion = camera_motion(head, camera, joints)
    T_head_cam = base_pose(head, "left") @ motion.T_lbase_cam
    if not states_covariance(head):
        return T_head_cam, (np.nan, np.nan)
    names, by_parameters = parameter_names(head), motion.by_parameters.copy()
    # The origin of frame head is half way to the right eye, at R^T t / 2 of T_rbase_lbase.
    R_T, t = head.T_rbase_lbase[:3, :3].T, head.T_rbase_lbase[:3, 3]
    between = named_columns(head, [f"T_rbase_lbase.{name}" for name in POSE])
    by_parameters[3:, between] += np.concatenate([-R_T @ hat(t), R_T], axis=1) / 2
    by_parameters[:, names.index("time_offset_s")] += motion.by_readings @ rate
    stated, covariance = stated_covariance(head, names)
    J = by_parameters[:, stated]
    noise = motion.by_readings * _reading_noise(head, measured(joints))
    variances = np.einsum("ij,jk,ik->i", J, covariance, J) + (noise**2).sum(axis=1)
    turn, shift = np.sqrt(variances.reshape(2, 3).sum(axis=1)).tolist()
    return T_head_cam, (turn, shift)


def _reading_noise(head: HeadCalibration, poses: bool) -> Array:
    """Look up the stated noise of readings (r,) [rad], or of poses of both eyes (12,) [rad, m]."""
    if not poses:
        return reading_stds(head)
    stated = head.accuracy.joint_std if head.accuracy is not None else ()
    turn, shift = stated if len(stated) == 2 else (0.0, 0.0)
    return np.tile(np.repeat([turn, shift], 3), 2)
