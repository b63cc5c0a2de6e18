"""Read and check datasets; docs/dataset.md describes the format with an example."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from vergence.arrays import Array
from vergence.data.dataset import LEAST_MOVING, MAX_GAP_S, Dataset
from vergence.data.description import DESCRIPTION, FRAMES, MOVING, STREAM, Description
from vergence.data.table import (
    Table,
    joint_angles,
    measured_eye_poses,
    placements,
    read_stream,
    read_table,
    time_stamps,
)
from vergence.errors import VergenceError
from vergence.files import file_inside, read_json
from vergence.findings import Finding, note
from vergence.geometry.kinematics import EYES, Kinematics, eye_joint_angles

MOVED_RAD = 0.01
"""Smallest turn between rows that counts as motion; above the noise of encoders."""


def load_dataset(folder: str | Path) -> Dataset:
    """Read a dataset and check everything except the images, which are read on demand.

    VergenceError names the file, and the field or line, that is missing or implausible.
    """
    folder = Path(folder)
    description = load_description(folder)
    table = read_table(folder / FRAMES, description.columns, description.optional_columns)
    poses, moving = description.eye_motion == "poses", table.whole_numbers(MOVING, 1) == 1
    time_s, joint_time_s = time_stamps(table)
    kinematics = description.head_kinematics
    eye_angles = joint_angles(description, kinematics.readings, table)
    neck_angles = joint_angles(description, description.neck_joints, table)
    stream = read_stream(folder, description)
    if stream is not None:
        t, at = stream.time_s, joint_time_s[moving]
        after = np.searchsorted(t[1:-1], at) + 1
        if len(t) < 2 or ((at < t[0]) | (at > t[-1]) | (t[after] - t[after - 1] > MAX_GAP_S)).any():
            raise VergenceError(
                f"{folder / STREAM} needs readings before and after each row of {FRAMES} that "
                f"moves, at most {MAX_GAP_S} s apart."
            )
    T_base_eye, findings = None, ()
    if poses:
        T_base_eye, findings = measured_eye_poses(description, table)
    else:
        findings = _unmarked_motion(kinematics, eye_angles, joint_time_s, moving)
    return Dataset(
        folder=folder,
        description=description,
        lines=np.array(table.lines),
        time_s=time_s,
        joint_time_s=joint_time_s,
        eye_angles=np.full_like(eye_angles, np.nan) if poses else eye_angles,
        T_base_eye=T_base_eye,
        neck_angles=neck_angles,
        placement=placements(description.neck_joints, neck_angles, table),
        moving=moving,
        files=_image_files(folder, description, table),
        stream=stream,
        findings=findings,
    )


def load_description(folder: Path) -> Description:
    """Read the dataset.json of a folder; VergenceError if it is missing or invalid."""
    if not os.path.isdir(folder):  # methods of Path raise where a name is too long
        raise VergenceError(
            f"There is no dataset folder {folder}: a dataset is a folder with {DESCRIPTION} and "
            f"{FRAMES}."
        )
    return read_json(folder / DESCRIPTION, Description, "a description of a dataset")


def _image_files(
    folder: Path, description: Description, table: Table
) -> dict[str, tuple[str | None, ...]]:
    """List the N image files of each camera; VergenceError if one is missing or used twice."""
    used: dict[Path, str] = {}
    for k, line in enumerate(table.lines):
        for camera in description.cameras:
            name = table.columns[camera][k]
            if not name:
                continue
            where = f"{table.where(k)}: {camera}: {name[:80]!r}"
            path = file_inside(folder, name, where, of="dataset")
            if path in used:
                raise VergenceError(f"{where} is also the image of {used[path]}.")
            used[path] = f"{camera} in line {line}"
    return {
        camera: tuple(name or None for name in table.columns[camera])
        for camera in description.cameras
    }


def _unmarked_motion(
    kinematics: Kinematics, eye_angles: Array, joint_time_s: Array, moving: np.ndarray
) -> tuple[Finding, ...]:
    """Note rows that are stated to be at rest but belong to a motion."""
    angles = [eye_joint_angles(kinematics, eye, eye_angles) for eye in EYES]
    # Readings of an eye without a camera may be missing.
    steps = np.nan_to_num(np.diff(np.concatenate(angles, axis=1), axis=0))
    steps[(np.diff(joint_time_s) > MAX_GAP_S) | (moving[1:] & moving[:-1])] = 0.0
    # A motion keeps its direction; noise of readings at rest changes it.
    directed = np.minimum(steps[1:], steps[:-1]), np.minimum(-steps[1:], -steps[:-1])
    count = int((np.maximum(*directed) > MOVED_RAD).any(axis=1).sum())
    if count < LEAST_MOVING - 1:  # a row at each end
        return ()
    sentence = (
        f"The eyes turn on in {count} rows that are at most {MAX_GAP_S} s apart, and `moving` is "
        "not 1: if the eyes moved while the images were taken, set it to 1, so that the time of a "
        "reading counts."
    )
    return (note("unmarked-motion", sentence),)
