"""What self-calibration takes to be wrong with a head before its eyes have looked."""

from dataclasses import replace

import numpy as np
import pytest

from head_kinds import KINDS
from head_kinds import head_of as head_of_kind
from simulated_frames import CAMERAS, begin, head_of
from vergence.errors import VergenceError
from vergence.findings import void
from vergence.geometry.camera import normalise, project
from vergence.geometry.head_accuracy import Accuracy, LensAccuracy
from vergence.geometry.kinematics import EYES, straight_gaze
from vergence.geometry.lens import COEFFICIENTS
from vergence.geometry.parameters import change_named
from vergence.geometry.projection import project_point
from vergence.geometry.se3 import transform
from vergence.self_calibration.prior import initial_state
from vergence.self_calibration.residuals import epipolar_residuals
from vergence.self_calibration.state import FilterState
from vergence.stereo.extrinsics import camera_poses, relative_camera_pose


@pytest.mark.parametrize("kind", ["pan, tilt", "k3", "rational", "fisheye"])
def test_lenses_without_a_stated_covariance_err_by_a_tenth_of_a_pixel(kind):
    """Root mean square over the image; the coefficients trade off against each other."""
    head = head_of_kind(kind, np.random.default_rng(0))
    state, rng = initial_state(head), np.random.default_rng(1)
    camera = head.camera(state.cameras[0]).intrinsics
    lens = [
        k
        for k, name in enumerate(state.names)
        if name.removeprefix(f"{state.cameras[0]}.") in COEFFICIENTS[camera.model]
    ]
    u, v = np.meshgrid(np.arange(4.5, camera.width, 9), np.arange(4.5, camera.height, 9))
    xy = normalise(camera, np.column_stack([u.ravel(), v.ravel()]))
    rays = np.column_stack([xy, np.ones(len(xy))])
    C = state.covariance[np.ix_(lens, lens)]
    squares = []
    for change in rng.multivariate_normal(np.zeros(len(lens)), C, 100, method="cholesky"):
        changed = replace(camera, distortion=camera.distortion + change)
        squares.append(((project(changed, rays) - project(camera, rays)) ** 2).sum(axis=1).mean())
    assert 0.05 < np.sqrt(np.mean(squares)) < 0.12


def test_both_eyes_of_a_calibration_without_covariance_are_taken_to_err_alike_in_part():
    state = begin(head_of(0))
    std = np.sqrt(np.diag(state.covariance))
    correlation = state.covariance / np.outer(std, std)

    def of_both_eyes(name: str) -> float:
        left, right = (state.names.index(f"{eye}{name}") for eye in EYES)
        return correlation[left, right]

    for name in ("_wide.k1", "_wide.T_eye_cam.tz", ".pan_gain"):
        assert of_both_eyes(name) == pytest.approx(0.5, abs=0.02)
    # Lenses that err differently would displace points from their epipolar lines.
    assert 0.85 < of_both_eyes("_wide.fx") < 0.99
    assert np.linalg.eigvalsh(correlation)[0] > 0


def fitted(*focal: float, centre_px: float = 0.1, distortion_px: float = 0.05) -> FilterState:
    """Return what is known of a head whose lenses were fitted so well, the left one first."""
    lenses = {
        name: LensAccuracy(focal=each, centre_px=centre_px, distortion_px=distortion_px)
        for name, each in zip(CAMERAS, focal, strict=False)
    }
    head = replace(head_of(0), accuracy=Accuracy(method="paper", lenses=lenses))
    state = initial_state(head, changed="nothing")
    assert np.linalg.eigvalsh(state.covariance)[0] > 0
    return state


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "one eye"])
def test_of_a_head_that_may_have_changed_no_stated_accuracy_holds(kind):
    """It starts as one that states none, but for the noise of its readings and pixels."""
    head = head_of_kind(kind, np.random.default_rng(0))
    none = initial_state(replace(head, accuracy=None))
    stated = Accuracy(
        method="bundle",
        parameters=none.names[:-1],
        covariance=1e-4 * none.covariance[:-1, :-1],
        joint_std=(1e-3,),
        findings=(void("not-converged", "For a reason."),),
    )
    changed = initial_state(replace(head, accuracy=stated), changed="anything")
    assert changed.names == none.names
    np.testing.assert_array_equal(changed.covariance, none.covariance)
    accuracy = changed.head.accuracy
    assert accuracy is not None
    assert (accuracy.void, accuracy.joint_std) == (stated.void, stated.joint_std)
    little = initial_state(replace(head, accuracy=stated))
    assert little.covariance[0, 0] < none.covariance[0, 0]


def test_another_word_for_what_may_have_changed_is_refused():
    with pytest.raises(VergenceError, match="nothing or little or anything, found 'much'"):
        initial_state(head_of(0), changed="much")  # pyright: ignore


def test_the_ratio_of_focal_lengths_errs_by_twice_what_their_fits_state():
    def ratio_std(*focal: float) -> float:
        state = fitted(*focal)
        both = np.zeros(len(state.names))
        for name, sign in zip(CAMERAS, (1, -1), strict=True):
            of_fx = state.names.index(f"{name}.fx")
            both[of_fx] = sign / state.head.camera(name).intrinsics.matrix[0, 0]
        alike = np.abs(both) / 2
        assert np.sqrt(alike @ state.covariance @ alike) > 0.005  # still unknown
        return float(np.sqrt(both @ state.covariance @ both))

    assert ratio_std(3e-5, 6e-5) == pytest.approx(2 * np.hypot(3e-5, 6e-5), rel=0.03)
    assert 0 < ratio_std(0.0, 0.0) < 1e-5
    # What nobody states, or what says little, leaves what epipolar lines tell.
    assert ratio_std(0.01, 0.01) == pytest.approx(ratio_std(), rel=5e-3)
    assert ratio_std(1e-4) == ratio_std()


def test_lenses_err_by_twice_what_their_fits_state():
    def std(state: FilterState, name: str) -> float:
        k = state.names.index(name)
        return float(np.sqrt(state.covariance[k, k]))

    usual = fitted()
    well = fitted(0.01, 0.01, centre_px=0.03, distortion_px=0.015)
    assert std(well, "left_wide.cx") == pytest.approx(0.06, rel=0.05)
    assert std(usual, "left_wide.cx") == pytest.approx(0.2, rel=0.05)
    # A third of the usual tenth of a pixel.
    assert std(well, "right_wide.k1") < 0.4 * std(usual, "right_wide.k1")
    assert std(well, "left_wide.fx") == pytest.approx(std(usual, "left_wide.fx"), rel=0.05)
    badly = fitted(0.1, 0.1, centre_px=0.3, distortion_px=0.25)
    assert std(badly, "left_wide.cx") == pytest.approx(0.6, rel=0.05)
    # Epipolar lines at straight gaze tell the rest.
    assert std(badly, "left_wide.fx") > 1.3 * std(usual, "left_wide.fx")
    # None was fitted, or one that is more exact than any board shows.
    undistorted = fitted(0.01, 0.01, centre_px=0.03, distortion_px=0.0)
    assert std(undistorted, "right_wide.k1") == pytest.approx(std(usual, "right_wide.k1"), rel=0.1)
    exact = fitted(0.0, 0.0, centre_px=0.0, distortion_px=1e-12)
    assert 1e-4 < std(exact, "left_wide.cx") < 2e-3
    one = fitted(0.01, centre_px=0.03, distortion_px=0.015)
    assert std(one, "right_wide.k1") == pytest.approx(std(usual, "right_wide.k1"), rel=0.01)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "one eye"])
def test_epipolar_lines_of_a_calibration_without_covariance_fit_to_a_third_of_a_pixel(kind):
    """At straight gaze, root mean square over the image.

    Approximately: seen are points at other depths, and lenses of some kinds show a little more than
    the four errors that are counted.
    """
    head = head_of_kind(kind, np.random.default_rng(0))
    state, rng = initial_state(head, changed="nothing"), np.random.default_rng(1)
    straight = straight_gaze(head.kinematics)
    T_left, T_right = camera_poses(head, straight, cameras=state.cameras)
    baseline = np.linalg.norm(T_right[:3, 3] - T_left[:3, 3])
    x, y = rng.uniform(-1.5, 1.5, (2, 2000))
    points = transform(T_left, np.column_stack([x, y, np.ones(2000)]) * 10 * baseline)
    seen = [project_point(head, name, straight, points) for name in state.cameras]
    inside = np.ones(len(points), bool)
    for pixels, name in zip(seen, state.cameras, strict=True):
        lens = head.camera(name).intrinsics
        inside &= ((pixels > 0) & (pixels < [lens.width - 1, lens.height - 1])).all(axis=1)
    assert inside.sum() > 100
    left, right = (pixels[inside] for pixels in seen)
    squares = []
    for change in rng.multivariate_normal(
        np.zeros(len(state.names)), state.covariance, 100, method="cholesky"
    ):
        changed = change_named(head, state.names, change)
        lenses = tuple(changed.camera(name).intrinsics for name in state.cameras)
        T = relative_camera_pose(changed, straight, cameras=state.cameras)
        found = epipolar_residuals(lenses, T, left, right)
        squares.append((found.residuals**2).mean())
    assert np.sqrt(np.mean(squares)) == pytest.approx(0.3, rel=0.3)


@pytest.mark.parametrize(("stated_deg", "taken_deg"), [(0.0, 0.2), (0.01, 0.05), (0.1, 0.1)])
def test_readings_of_moving_eyes_err_by_more_than_a_recording_at_rest_may_state(
    stated_deg, taken_deg
):
    accuracy = Accuracy("bundle", joint_std=(np.radians(stated_deg),))
    state = initial_state(replace(head_of(0), accuracy=accuracy))
    assert state.reading_std == pytest.approx(np.radians(taken_deg))
