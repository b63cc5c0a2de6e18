"""Corners that are not where their neighbours say are found, and no others."""

from dataclasses import replace

import numpy as np
import pytest

from head_kinds import lens_head, recording
from simulated_head import random_head
from simulated_recording import Noise, Recording, record
from texts import texts
from vergence.calibration.calibrate import calibrate
from vergence.calibration.intrinsics import calibrate_intrinsics
from vergence.calibration.lens_choice import choose_lenses
from vergence.calibration.observations import Observations
from vergence.calibration.outliers import without_strays
from vergence.geometry.camera import pinhole

SHARE = 0.02


def recorded(*, fisheye: bool = False) -> Observations:
    rng = np.random.default_rng(3)
    head = random_head(rng, lenses=("wide",))
    if fisheye:
        lens = pinhole(640, 480, 640 / np.radians(160), model="fisheye")
        cameras = {name: replace(m, intrinsics=lens) for name, m in head.cameras.items()}
        head = replace(head, cameras=cameras)
    return record(head, rng, Recording(noise=Noise(pixel_px=0.3)))


@pytest.mark.parametrize("fisheye", [False, True])
def test_good_corners_stay(fisheye: bool):
    seen = recorded(fisheye=fisheye)
    assert without_strays(seen) is seen


def test_the_bent_corners_at_the_edge_of_an_image_stay():
    rng = np.random.default_rng(2)
    seen = recording(lens_head("k3", rng), rng)
    assert without_strays(seen) is seen


def test_stray_corners_are_left_out_before_they_spoil_the_lens():
    seen, rng = recorded(), np.random.default_rng(0)
    spoilt = {name: corners.copy() for name, corners in seen.corners.items()}
    for corners in spoilt.values():
        stray = rng.random(corners.shape[:2]) < SHARE
        corners[stray] += rng.choice([-30, 30], (stray.sum(), 2))
    found = without_strays(replace(seen, corners=spoilt))
    for name, corners in seen.corners.items():
        good = (spoilt[name] == corners).all(axis=-1)
        assert np.isfinite(found.corners[name][good]).all()
    (said,) = texts(found.findings, "note")
    assert said.startswith("Corners not where their neighbours say, and left out: ")
    assert {each.model for each in choose_lenses(found).values()} == {"radial-tangential"}
    lenses = calibrate_intrinsics(found)
    assert all(each.rms_px < 1 for each in lenses.values())


@pytest.mark.usefixtures("two_folds")
def test_outliers_that_are_no_strays_do_not_make_held_out_points_wrong():
    """They are nearer to where their neighbours say than a third of a square."""
    seen, rng = recorded(), np.random.default_rng(1)
    spoilt = {name: corners.copy() for name, corners in seen.corners.items()}
    for corners in spoilt.values():
        wrong = rng.random(corners.shape[:2]) < SHARE
        corners[wrong] += rng.choice([-4, 4], (wrong.sum(), 2))
    found = calibrate(replace(seen, corners=spoilt), lens="radial-tangential")
    held_out = found.accuracy.held_out
    assert held_out is not None
    assert held_out.point_mm is not None
    assert held_out.expected_mm is not None
    assert not found.accuracy.void
    assert held_out.point_mm < 1.2 * held_out.expected_mm
