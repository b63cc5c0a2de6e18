"""Lenses that were known before a calibration: kept, corrected, or contradicted by the images."""

from dataclasses import replace

import numpy as np
import pytest

from simulated_head import random_head
from simulated_recording import BOARD, Noise, Recording, record, still_recording
from vergence.calibration.bundle_adjustment import bundle_adjust
from vergence.calibration.calibrate import calibrate
from vergence.calibration.priors import known_lens_std
from vergence.data.description import DatasetCamera, Description
from vergence.errors import VergenceError
from vergence.geometry.camera import Camera
from vergence.geometry.parameters import boxminus, lens_of_vector, lens_vector


def other_lens(lens: Camera, rng: np.random.Generator, percent: float) -> tuple[Camera, float]:
    """Return a lens as it may be known by its stated deviation; k3 stays zero."""
    error = rng.normal(size=9) * known_lens_std(lens, percent) * (np.arange(9) < 8)
    return lens_of_vector(lens, lens_vector(lens) + error), percent


@pytest.mark.slow
def test_a_lens_that_is_known_exactly_is_kept_and_two_views_place_its_camera():
    rng = np.random.default_rng(5)
    truth = random_head(rng)
    noise = Noise(pixel_px=0.05, joint_rad=1e-4)
    how = {"wide_views": 4, "narrow_views": 2, "orientations": 12, "spread_rad": 0.25}
    seen = still_recording(truth, rng, noise, **how)
    with pytest.raises(VergenceError, match="narrow: Intrinsics need at least 3 views"):
        calibrate(seen)
    narrow = {n: m.intrinsics for n, m in truth.cameras.items() if n.endswith("narrow")}
    known = {name: (lens, 0.0) for name, lens in narrow.items()}
    found = calibrate(replace(seen, known_lenses=known))
    for name, lens in narrow.items():
        kept = found.head.cameras[name].intrinsics
        np.testing.assert_array_equal(lens_vector(kept), lens_vector(lens))
        assert f"{name}.fx" not in found.accuracy.parameters
    error, accuracy = boxminus(found.head, truth), found.accuracy
    off = np.array([error[name] for name in accuracy.parameters])
    chi2 = off @ np.linalg.pinv(accuracy.covariance) @ off
    assert chi2 / len(off) < 2


def test_a_camera_of_a_known_lens_that_sees_no_board_is_named():
    rng = np.random.default_rng(5)
    truth = random_head(rng, lenses=("wide",))
    seen = record(truth, rng, Recording(straight=4, orientations=4))
    corners = {**seen.corners, "right_wide": np.full_like(seen.corners["right_wide"], np.nan)}
    known = {"right_wide": (truth.cameras["right_wide"].intrinsics, 0.0)}
    with pytest.raises(VergenceError, match=r"right_wide: .* views of the board, found 0"):
        calibrate(replace(seen, corners=corners, known_lenses=known), lens="radial-tangential")


@pytest.mark.slow
def test_stated_deviations_hold_where_boards_of_one_slant_leave_the_lens_to_what_is_known():
    squares, tighter = [], []
    for seed in range(3):
        rng = np.random.default_rng([63, seed])
        truth = random_head(rng, lenses=("wide",))
        how = Recording(straight=4, orientations=16, slant_rad=(0.1, 0.1))
        seen = record(truth, rng, how)
        known = {n: other_lens(m.intrinsics, rng, 0.2) for n, m in truth.cameras.items()}
        found = bundle_adjust(truth, replace(seen, known_lenses=known))
        row = found.parameters.index("left_wide.fx")
        std = np.sqrt(found.covariance[row, row])
        squares.append((boxminus(found.head, truth)["left_wide.fx"] / std) ** 2)
        tighter.append(std / truth.cameras["left_wide"].intrinsics.matrix[0, 0])
    assert max(tighter) < 0.0021
    assert np.mean(squares) < 4


def test_a_stated_deviation_needs_intrinsics_of_the_images():
    head = random_head(np.random.default_rng(1))
    for lens, width in ((None, 640), (head.cameras["left_wide"].intrinsics, 320)):
        camera = DatasetCamera("left", width, 480, lens, intrinsics_std_percent=1.0)
        with pytest.raises(ValueError, match="intrinsics_std_percent needs intrinsics of that"):
            Description(cameras={"left_wide": camera}, board=BOARD)
