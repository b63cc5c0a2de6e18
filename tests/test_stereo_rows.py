"""Rows of a dataset in which both eyes see, at the moments of their images."""

from dataclasses import replace

import numpy as np

from recordings import CHESSBOARD
from simulated_head import plain_head
from test_timing import turning
from vergence.data.dataset import Frame, stereo_rows
from vergence.data.description import DatasetCamera, Description
from vergence.data.reader import load_dataset
from vergence.data.writer import DatasetRow, write_dataset
from vergence.geometry.kinematics import EYES
from vergence.geometry.se3 import boxminus


def test_measured_poses_are_moved_to_the_moments_of_the_images(tmp_path):
    time_s, late_s = np.arange(40) / 30, 0.03
    image = np.zeros((480, 640), np.uint8)
    cameras = {f"{eye}_wide": DatasetCamera(eye=eye, width=640, height=480) for eye in EYES}
    rows = [
        DatasetRow(
            Frame(t, t, np.zeros(4), np.zeros(3), dict.fromkeys(cameras, image)),
            placement=0,
            moving=True,
            T_base_eye=T,
        )
        for t, T in zip(time_s, turning(time_s), strict=True)
    ]
    described = Description(cameras=cameras, board=CHESSBOARD, eye_motion="poses")
    write_dataset(tmp_path / "set", described, rows)
    head = replace(plain_head(0.09, 280.0), time_offset_s=late_s)
    found = stereo_rows(load_dataset(tmp_path / "set"), head)
    off = boxminus(found.joints, turning(time_s + late_s))
    assert np.abs(off[8:-8]).max() < 1e-6
    assert np.abs(boxminus(turning(time_s), turning(time_s + late_s))).max() > 1e-3
    assert found.frame(3).eye_angles.shape == (4,)
    assert np.isnan(found.frame(3).eye_angles).all()
