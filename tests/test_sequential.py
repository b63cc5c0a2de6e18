"""The whole chain: exact on exact data; on clean renders, as exact as corners can be found."""

from dataclasses import replace

import numpy as np
import pytest

from vergence.calibration.sequential.intrinsics import calibrate_intrinsics
from vergence.calibration.sequential.sequential import Views, calibrate
from vergence.errors import VergenceError
from vergence.geometry.board import corner_points
from vergence.geometry.head import HeadCalibration
from vergence.geometry.kinematics import T_base_eye
from vergence.paper.figures import FIGURES
from vergence.paper.replay import estimate, observe_points
from vergence.paper.trajectories import PERIOD_S
from vergence.twin.calibration_sequence import (
    BOARD,
    board_as_given,
    capture_views,
    plan,
    simulate_views,
)
from vergence.twin.head import Twin
from vergence.twin.model import as_built_head, nominal_head
from vergence.twin.profile import CalibrationMade, ErrorProfile, Lens, Mounting, Optics

AS_BUILT = ErrorProfile(
    mounting=Mounting(
        rotation_deg=1.5, translation_mm=2, base_rotation_deg=0.5, base_translation_mm=1
    ),
    optics=Optics(focal_percent=1, principal_px=4),
)
"""Everything that the calibration is there to find, and nothing that spoils it."""


def exact_views(lens: Lens, profile: ErrorProfile, seed: int) -> tuple[HeadCalibration, Views]:
    nominal = nominal_head(lens)
    truth = as_built_head(nominal, AS_BUILT, seed)
    shots, rng = plan(nominal, seed), np.random.default_rng(seed)
    return truth, simulate_views(truth, profile, shots, pixel_noise=0.0, rng=rng)


def assert_same(a: object, b: object, tolerance: float = 1e-9) -> None:
    np.testing.assert_allclose(np.asarray(a), np.asarray(b), rtol=0, atol=tolerance)


@pytest.mark.parametrize(("lens", "seed"), [("2.8mm", 0), ("4.0mm", 1)])
def test_without_imperfection_the_whole_chain_returns_the_truth(lens: Lens, seed: int):
    """Eqs. 1-12, 22-23: corners to calibration to points, each to 1e-9."""
    truth, views = exact_views(lens, ErrorProfile(), seed)
    found = calibrate(views, neck=truth.neck)
    for name, mounted in truth.cameras.items():
        camera = found.head.cameras[name]
        assert_same(camera.intrinsics.matrix, mounted.intrinsics.matrix)
        assert_same(camera.intrinsics.distortion, mounted.intrinsics.distortion)
        assert_same(camera.T_eye_cam, mounted.T_eye_cam)
        assert found.intrinsics[name].rms_px < 1e-9
    assert_same(found.head.T_rbase_lbase, truth.T_rbase_lbase)
    assert found.stereo_rms_px < 1e-9
    for figure in FIGURES.values():
        if figure.lens == lens:
            times = np.linspace(0, PERIOD_S[figure.motion], 500)
            rng = np.random.default_rng(0)
            seen = observe_points(truth, ErrorProfile(), figure, times, rng=rng)
            replayed = estimate(found.head, figure, np.array(figure.mean_m), seen)
            assert replayed.statistics.dropped == 0
            assert_same(replayed.points, np.tile(figure.mean_m, (500, 1)))


def test_a_board_that_is_larger_than_told_makes_a_smaller_world():
    profile = ErrorProfile(calibration=CalibrationMade(square_percent=1.0))
    truth, views = exact_views("2.8mm", profile, 0)
    found = calibrate(views)
    assert board_as_given(profile).square_m == pytest.approx(BOARD.square_m / 1.01)
    assert_same(
        found.head.cameras["left_wide"].intrinsics.matrix[0],
        truth.cameras["left_wide"].intrinsics.matrix[0],
    )
    baseline, true = (np.linalg.norm(h.T_rbase_lbase[:3, 3]) for h in (found.head, truth))
    assert baseline == pytest.approx(true / 1.01, rel=1e-3)


def test_a_lens_model_without_distortion_leaves_what_it_cannot_say():
    _, views = exact_views("2.8mm", ErrorProfile(), 0)
    found = calibrate(views, wide_lens="none")
    assert not found.head.cameras["left_wide"].intrinsics.distortion.any()
    assert found.intrinsics["left_wide"].rms_px > 0.3
    assert found.intrinsics["left_narrow"].rms_px < 1e-9


def test_a_head_without_narrow_cameras_is_calibrated_as_well():
    truth, views = exact_views("2.8mm", ErrorProfile(), 0)
    wide = {name: c for name, c in views.corners.items() if name.endswith("wide")}
    found = calibrate(replace(views, corners=wide))
    assert sorted(found.head.cameras) == ["left_wide", "right_wide"]
    assert_same(found.head.T_rbase_lbase, truth.T_rbase_lbase)


def test_without_straight_gaze_the_eyes_are_related_by_what_both_see():
    truth, views = exact_views("2.8mm", ErrorProfile(), 0)
    moved = (np.abs(views.eye_angles) > 0.05).any(axis=1)
    wide = {name: c[moved] for name, c in views.corners.items() if name.endswith("wide")}
    found = calibrate(
        replace(
            views,
            placement=views.placement[moved],
            eye_angles=views.eye_angles[moved],
            corners=wide,
        )
    )
    assert found.stereo_rms_px is None
    assert_same(found.head.T_rbase_lbase, truth.T_rbase_lbase, 1e-8)


def test_eye_poses_take_the_place_of_angles():
    truth, views = exact_views("2.8mm", ErrorProfile(), 0)
    angles = views.eye_angles
    poses = np.stack([T_base_eye(angles[:, :2]), T_base_eye(angles[:, 2:])], axis=1)
    unknown = replace(views, eye_angles=np.full_like(angles, np.nan))
    found = calibrate(unknown, eye_poses_read=poses)
    assert_same(found.head.T_rbase_lbase, truth.T_rbase_lbase)
    for name, mounted in truth.cameras.items():
        assert_same(found.head.cameras[name].T_eye_cam, mounted.T_eye_cam)


def test_cameras_may_have_any_names_and_an_eye_several():
    truth, views = exact_views("2.8mm", ErrorProfile(), 0)
    names = {"left_wide": "port", "left_narrow": "far", "right_wide": "starboard"}
    named = replace(
        views,
        corners={new: views.corners[old] for old, new in names.items()},
        sizes={new: views.sizes[old] for old, new in names.items()},
        eyes={"port": "left", "far": "left", "starboard": "right"},
    )
    found = calibrate(named)
    for old, new in names.items():
        assert found.head.cameras[new].eye == truth.cameras[old].eye
        assert_same(found.head.cameras[new].T_eye_cam, truth.cameras[old].T_eye_cam, 1e-8)
    with pytest.raises(VergenceError, match="Which eye does port sit in"):
        calibrate(replace(named, eyes={}))


def test_a_head_may_have_one_eye():
    truth, views = exact_views("2.8mm", ErrorProfile(), 0)
    left = {name: c for name, c in views.corners.items() if name.startswith("left")}
    found = calibrate(replace(views, corners=left))
    assert_same(found.head.cameras["left_wide"].T_eye_cam, truth.cameras["left_wide"].T_eye_cam)
    assert_same(found.head.T_rbase_lbase, np.eye(4))


def test_without_moving_eyes_there_is_no_eye_camera_pose():
    _, views = exact_views("2.8mm", ErrorProfile(), 0)
    with pytest.raises(VergenceError, match=r"share one axis|at least 3 views"):
        calibrate(replace(views, eye_angles=0 * views.eye_angles))


def test_a_camera_that_never_saw_the_board_is_an_error():
    _, views = exact_views("2.8mm", ErrorProfile(), 0)
    corners = dict(views.corners)
    corners["right_wide"] = np.full_like(corners["right_wide"], np.nan)
    with pytest.raises(VergenceError, match="at least 3 views"):
        calibrate(replace(views, corners=corners))


# On clean renders


@pytest.fixture(scope="module")
def rendered(opengl: None) -> tuple[HeadCalibration, Views, Views]:
    """The true head, corners found in some clean renders of the sequence, and the true ones."""
    with Twin(AS_BUILT, seed=0) as twin:
        shots = plan(twin.nominal, 0)
        straight = [shot for shot in shots if not shot.eye_angles.any()]
        chosen = [shot for shot in straight if not any("narrow" in c for c in shot.cameras)][:8]
        for eye in ("left", "right"):
            chosen += [shot for shot in straight if f"{eye}_narrow" in shot.cameras][:4]
        chosen += [shot for shot in shots if shot.eye_angles.any()][::8]
        found = capture_views(twin, chosen)
        # The servos sag by thousandths of a degree; without sensor errors the readings show it.
        stood = [
            replace(shot, eye_angles=angles)
            for shot, angles in zip(chosen, found.eye_angles, strict=True)
        ]
        rng = np.random.default_rng(0)
        true = simulate_views(twin.truth, ErrorProfile(), stood, pixel_noise=0.0, rng=rng)
        return twin.truth, found, true


def test_corners_of_clean_renders_have_no_bias(rendered: tuple[HeadCalibration, Views, Views]):
    """Below 0.02 px on average, and 0.05 px of scatter."""
    _, found, true = rendered
    for name, corners in found.corners.items():
        error = corners - true.corners[name]
        assert np.isfinite(error).all(axis=(1, 2)).sum() >= 4
        assert np.abs(np.nanmean(error, axis=(0, 1))).max() < 0.02
        assert np.sqrt(np.nanmean(error**2)) < 0.05


def test_focal_length_and_principal_point_of_clean_renders_are_mujocos(
    rendered: tuple[HeadCalibration, Views, Views],
):
    """With the board's poses given, corners tell them apart from the truth by below 0.05 px.

    In pixels at the edge of the image, where the focal length's error is largest.
    """
    truth, found, true = rendered
    for name, mounted in truth.cameras.items():
        A = mounted.intrinsics.matrix
        seen = np.isfinite(found.corners[name]) & np.isfinite(true.corners[name])
        for axis, size in ((0, 640), (1, 480)):
            ok = seen[..., axis]
            slope, at = A[axis, axis], A[axis, 2]
            design = (true.corners[name][ok][:, axis] - at) / slope
            focal, centre = np.polyfit(design, found.corners[name][ok][:, axis], 1)
            assert abs(centre - at) < 0.05
            assert abs(focal / slope - 1) * size / 2 < 0.05
            if name.endswith("wide"):
                assert abs(focal - slope) < 0.05


def test_zhangs_method_on_clean_renders_finds_the_rays(
    rendered: tuple[HeadCalibration, Views, Views],
):
    """Without given poses, the same corners leave the focal length open to a few tenths of a
    pixel, along with the poses."""
    truth, found, _ = rendered
    for name in ("left_wide", "right_wide"):
        fit = calibrate_intrinsics(
            found.corners[name],
            corner_points(BOARD),
            size=(640, 480),
            lens_model="radial-tangential",
        )
        difference = fit.camera.matrix - truth.cameras[name].intrinsics.matrix
        assert np.abs(difference).max() < 0.5
        assert fit.rms_px < 0.06


@pytest.mark.slow
def test_the_same_corners_give_the_same_digits():
    """OpenCV's own sums differ from run to run in their last digits when it uses threads."""
    profile = ErrorProfile()
    nominal = nominal_head("2.8mm")
    rng = np.random.default_rng(0)
    views = simulate_views(nominal, profile, plan(nominal, 0), pixel_noise=0.03, rng=rng)
    runs = [calibrate(views).head for _ in range(4)]
    for run in runs[1:]:
        assert run.T_rbase_lbase.tobytes() == runs[0].T_rbase_lbase.tobytes()
        for name, mounted in run.cameras.items():
            first = runs[0].cameras[name]
            assert mounted.intrinsics.matrix.tobytes() == first.intrinsics.matrix.tobytes()
            assert mounted.T_eye_cam.tobytes() == first.T_eye_cam.tobytes()
