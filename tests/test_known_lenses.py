"""Lenses that were known before a calibration: kept, corrected, or contradicted by the images."""

from dataclasses import replace

import numpy as np
import pytest

from simulated_head import random_head
from simulated_recording import POINTS, Noise, Recording, record, still_recording
from vergence.arrays import Array
from vergence.calibration.bundle_adjustment import bundle_adjust
from vergence.calibration.calibrate import calibrate
from vergence.calibration.intrinsics import calibrate_camera, correct_camera
from vergence.calibration.known_lenses import contradicted_lenses
from vergence.calibration.lens_choice import choose_lenses
from vergence.calibration.lenses import free_intrinsics
from vergence.calibration.observations import KnownLens, Observations
from vergence.calibration.priors import known_lens_std
from vergence.data.description import DatasetCamera, Description
from vergence.errors import VergenceError
from vergence.geometry.camera import Camera
from vergence.geometry.head import HeadCalibration
from vergence.geometry.parameters import boxminus, lens_of_vector, lens_vector


def other_lens(lens: Camera, rng: np.random.Generator, percent: float) -> KnownLens:
    """Return a lens as it may be known by its stated deviation; k3 stays zero."""
    error = rng.normal(size=9) * known_lens_std(lens, percent) * (np.arange(9) < 8)
    return KnownLens(lens_of_vector(lens, lens_vector(lens) + error), percent)


def recorded(seed: int, **how) -> tuple[HeadCalibration, Observations, np.random.Generator]:
    rng = np.random.default_rng([63, seed])
    truth = random_head(rng, lenses=("wide",))
    return truth, record(truth, rng, Recording(**how)), rng


def test_a_known_lens_and_the_images_count_as_two_measurements():
    truth, seen, rng = recorded(0, noise=Noise(0.02, 0.0))
    lens, corners = truth.cameras["left_wide"].intrinsics, seen.corners["left_wide"]
    known, free = other_lens(lens, rng, 0.05), free_intrinsics("radial-tangential")
    alone = calibrate_camera(corners, POINTS, size=lens.size, lens_model="radial-tangential")
    both = correct_camera(known, corners, POINTS, lens_model="radial-tangential")
    std = known_lens_std(known.camera, known.std_percent)[free]

    def values(camera: Camera) -> Array:
        return lens_vector(camera)[free]

    # By the covariance of the corners' noise alone, which what was known does not make larger.
    by_noise = alone.covariance * alone.focal_std_px[0] ** 2 / alone.covariance[0, 0]
    by_images = np.linalg.inv(by_noise)
    C = np.linalg.inv(by_images + np.diag(1 / std**2))
    mean = C @ (by_images @ values(alone.camera) + values(known.camera) / std**2)
    shift = (values(both.camera) - mean) / np.sqrt(np.diag(C))
    assert np.abs(shift).max() < 0.1
    assert (np.sqrt(np.diag(both.covariance)) < 1.1 * np.minimum(
        std, np.sqrt(np.diag(alone.covariance))
    )).all()  # fmt: skip


@pytest.mark.slow
def test_a_lens_that_is_known_exactly_is_kept_and_two_views_place_its_camera():
    rng = np.random.default_rng(5)
    truth = random_head(rng)
    noise = Noise(pixel_px=0.05, joint_rad=1e-4)
    how = {"wide_views": 4, "narrow_views": 2, "orientations": 12, "spread_rad": 0.25}
    seen = still_recording(truth, rng, noise, **how)
    with pytest.raises(VergenceError, match="narrow shows the board in 2 images at rest"):
        calibrate(seen)
    narrow = {n: m.intrinsics for n, m in truth.cameras.items() if n.endswith("narrow")}
    known = {name: KnownLens(lens, 0.0) for name, lens in narrow.items()}
    found = calibrate(replace(seen, known_lenses=known))
    for name, lens in narrow.items():
        kept = found.head.cameras[name].intrinsics
        np.testing.assert_array_equal(lens_vector(kept), lens_vector(lens))
        assert f"{name}.fx" not in found.accuracy.parameters
    error, accuracy = boxminus(found.head, truth), found.accuracy
    off = np.array([error[name] for name in accuracy.parameters])
    chi2 = off @ np.linalg.pinv(accuracy.covariance) @ off
    assert chi2 / len(off) < 2


@pytest.mark.slow
def test_stated_deviations_hold_where_boards_of_one_slant_leave_the_lens_to_what_is_known():
    squares, tighter = [], []
    for seed in range(3):
        truth, seen, rng = recorded(seed, straight=4, orientations=16, slant_rad=(0.1, 0.1))
        known = {n: other_lens(m.intrinsics, rng, 0.2) for n, m in truth.cameras.items()}
        start = replace(truth, cameras={
            n: replace(m, intrinsics=known[n].camera) for n, m in truth.cameras.items()
        })  # fmt: skip
        found = bundle_adjust(start, replace(seen, known_lenses=known))
        row = found.parameters.index("left_wide.fx")
        std = np.sqrt(found.covariance[row, row])
        squares.append((boxminus(found.head, truth)["left_wide.fx"] / std) ** 2)
        tighter.append(std / truth.cameras["left_wide"].intrinsics.matrix[0, 0])
    assert max(tighter) < 0.0021
    assert np.mean(squares) < 4


def test_images_that_contradict_a_known_lens_are_reported():
    truth, seen, _ = recorded(1)
    lens = truth.cameras["left_wide"].intrinsics
    longer = replace(lens, matrix=lens.matrix * [[1.02, 1, 1], [1, 1.02, 1], [1, 1, 1]])
    for percent, expected in ((0.0, 1), (0.2, 1), (2.0, 0)):
        known = {"left_wide": KnownLens(longer, percent), "right_wide": KnownLens(
            truth.cameras["right_wide"].intrinsics, percent
        )}  # fmt: skip
        found = contradicted_lenses(replace(seen, known_lenses=known))
        assert [each.where for each in found] == ["left_wide"] * expected


def test_another_model_than_that_of_a_known_lens_is_refused():
    truth, seen, _ = recorded(1)
    known = {"left_wide": KnownLens(truth.cameras["left_wide"].intrinsics, 1.0)}
    seen = replace(seen, known_lenses=known)
    with pytest.raises(VergenceError, match="left_wide has a known lens of the model radial"):
        choose_lenses(seen, "fisheye")
    assert choose_lenses(seen, {"right_wide": "k1"})["left_wide"].model == "radial-tangential"


def test_a_stated_deviation_needs_intrinsics_of_the_images():
    truth, seen, _ = recorded(1)
    for lens, width in ((None, 640), (truth.cameras["left_wide"].intrinsics, 320)):
        camera = DatasetCamera("left", width, 480, lens, intrinsics_std_percent=1.0)
        with pytest.raises(ValueError, match="intrinsics_std_percent needs intrinsics for images"):
            Description(cameras={"left_wide": camera}, board=seen.board)
