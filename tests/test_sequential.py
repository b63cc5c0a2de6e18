"""The paper's steps on exact data give the truth, whatever the head, as far as OpenCV can tell."""

from dataclasses import replace

import numpy as np
import pytest

from simulated_head import random_head
from simulated_recording import EXACT, Noise, Recording, as_poses, record, still_recording
from test_intrinsics import SINGLE_PRECISION_LENS, SINGLE_PRECISION_POSE, SINGLE_PRECISION_PX
from vergence.calibration.initial import calibrate_sequentially
from vergence.calibration.observations import Observations
from vergence.errors import VergenceError
from vergence.geometry.head import HeadCalibration
from vergence.geometry.kinematics import EYES, Side
from vergence.geometry.projection import project_point
from vergence.stereo.triangulation import Status, triangulate_at

NARROW = 10.0
"""Mountings of narrow cameras rest on few views of far boards: so many times less certain."""


def recorded(noise: Noise = EXACT, seed: int = 0) -> tuple[HeadCalibration, Observations]:
    """Return a head with perfect axes, which this method assumes, and what it observes."""
    rng = np.random.default_rng(seed)
    truth = random_head(rng, perfect_axes=True)
    counts = {"wide_views": 12, "narrow_views": 8, "orientations": 20}
    return truth, still_recording(truth, rng, noise, **counts, spread_rad=0.25)


@pytest.fixture(scope="module")
def exact() -> tuple[HeadCalibration, Observations]:
    return recorded()


def some_cameras(
    observations: Observations, names: dict[str, str], eyes: dict[str, Side] | None = None
) -> Observations:
    """Return what some cameras saw, under other names."""
    return replace(
        observations,
        corners={new: observations.corners[old] for old, new in names.items()},
        sizes={new: observations.sizes[old] for old, new in names.items()},
        eyes=eyes or {},
    )


def only(observations: Observations, *names: str) -> Observations:
    return some_cameras(observations, dict(zip(names, names, strict=True)))


def assert_same(a: object, b: object, tolerance: float = SINGLE_PRECISION_POSE) -> None:
    np.testing.assert_allclose(np.asarray(a), np.asarray(b), rtol=0, atol=tolerance)


@pytest.mark.parametrize("as_measured_poses", [False, True])
def test_exact_data_give_the_head(exact, as_measured_poses: bool):
    """Eqs. 1-2 and 5-11: corners to cameras, mountings, and the pose between the eyes."""
    truth, observed = exact
    found = calibrate_sequentially(as_poses(observed) if as_measured_poses else observed)
    for name, mounted in truth.cameras.items():
        camera, loose = found.head.cameras[name], NARROW if "narrow" in name else 1.0
        lens, true = camera.intrinsics, mounted.intrinsics
        assert_same(lens.matrix, true.matrix, loose * SINGLE_PRECISION_LENS)
        assert_same(lens.distortion, true.distortion, 1e-5)
        assert_same(camera.T_eye_cam, mounted.T_eye_cam, loose * SINGLE_PRECISION_POSE)
        assert found.intrinsics[name].rms_px < SINGLE_PRECISION_PX
    assert_same(found.head.T_rbase_lbase, truth.T_rbase_lbase)
    if not as_measured_poses:
        assert found.stereo_rms_px is not None
        assert found.stereo_rms_px < SINGLE_PRECISION_PX
        assert found.stereo_views == 28
    assert found.eye_views == {"left": 20, "right": 20}
    assert found.accuracy.parameters == ()
    assert found.accuracy.lenses == {n: each.accuracy for n, each in found.intrinsics.items()}
    assert max(each.focal for each in found.accuracy.lenses.values()) < 1e-6


def test_one_wild_reading_does_not_spoil_where_a_camera_sits(exact):
    truth, observed = exact
    angles = observed.eye_angles.copy()
    angles[-3, 1] = 2.5
    found = calibrate_sequentially(only(replace(observed, eye_angles=angles), "left_wide"))
    assert_same(found.head.cameras["left_wide"].T_eye_cam, truth.cameras["left_wide"].T_eye_cam)


def test_a_head_from_exact_data_locates_points_exactly(exact):
    """Eqs. 1-11 together: corners and readings to points."""
    truth, observed = exact
    found = calibrate_sequentially(observed).head
    rng = np.random.default_rng(3)
    points = rng.uniform([0.3, -0.1, -0.1], [0.8, 0.1, 0.1], (20, 3))
    joints = rng.uniform(-0.2, 0.2, (20, 4))
    left, right = (project_point(truth, f"{eye}_wide", joints, points) for eye in EYES)
    located, status = triangulate_at(found, left=left, right=right, joints=joints)
    assert (status == Status.OK).all()
    assert_same(located, points, 1e-5)  # depth errs most: 0.8 m / 0.06 m times as much as poses


def test_without_straight_gaze_the_eyes_are_related_by_boards_that_both_see():
    rng = np.random.default_rng(2)
    truth = random_head(rng, lenses=("wide",), perfect_axes=True)
    observed = record(truth, rng, Recording(gaze_rad=(0.1, -0.08), noise=EXACT))
    found = calibrate_sequentially(observed)
    assert sorted(found.head.cameras) == ["left_wide", "right_wide"]
    assert found.stereo_rms_px is None
    assert_same(found.head.T_rbase_lbase, truth.T_rbase_lbase)


def test_eyes_that_see_a_board_at_rest_one_after_the_other_are_related_by_it():
    rng = np.random.default_rng(2)
    truth = random_head(rng, lenses=("wide",), perfect_axes=True)
    observed = record(truth, rng, Recording(gaze_rad=(0.1, -0.08), noise=EXACT))
    observed.corners["left_wide"][::2] = np.nan
    observed.corners["right_wide"][1::2] = np.nan
    found = calibrate_sequentially(observed)
    assert_same(found.head.T_rbase_lbase, truth.T_rbase_lbase)
    apart = 2 * observed.placement + np.arange(len(observed.placement)) % 2
    with pytest.raises(VergenceError, match="no placement of the board is seen by both left_wide"):
        calibrate_sequentially(replace(observed, placement=apart))


def test_cameras_may_have_any_names_and_an_eye_several(exact):
    truth, observed = exact
    names = {"left_wide": "port", "left_narrow": "far", "right_wide": "starboard"}
    eyes: dict[str, Side] = {"port": "left", "far": "left", "starboard": "right"}
    found = calibrate_sequentially(some_cameras(observed, names, eyes))
    for old, new in names.items():
        camera, mounted = found.head.cameras[new], truth.cameras[old]
        assert camera.eye == mounted.eye
        assert_same(camera.T_eye_cam, mounted.T_eye_cam, NARROW * SINGLE_PRECISION_POSE)
    with pytest.raises(VergenceError, match="Which eye does port sit in"):
        calibrate_sequentially(some_cameras(observed, names))


def test_a_head_may_have_one_eye(exact):
    truth, observed = exact
    found = calibrate_sequentially(only(observed, "right_wide", "right_narrow"))
    assert_same(found.head.cameras["right_wide"].T_eye_cam, truth.cameras["right_wide"].T_eye_cam)
    np.testing.assert_array_equal(found.head.T_rbase_lbase, np.eye(4))


def test_a_camera_that_never_saw_the_board_is_an_error(exact):
    nothing = np.full_like(exact[1].corners["right_wide"], np.nan)
    blind = replace(exact[1], corners={**exact[1].corners, "right_wide": nothing})
    with pytest.raises(VergenceError, match=r"right_wide: .*at least 3 views"):
        calibrate_sequentially(blind)
