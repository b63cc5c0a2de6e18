"""Refinement: exact data give no error, noise gives the stated error, poor data give words."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial.chebyshev import chebval
from scipy.stats import chi2

from heads import R_EYE_CAM, random_head, random_pose
from vergence.arrays import Array
from vergence.calibration.assembly import whole_head
from vergence.calibration.derivatives import jacobians
from vergence.calibration.pipeline import Views
from vergence.calibration.problem import (
    PER_CAMERA,
    Problem,
    State,
    advance,
    axes_row,
    calibration_names,
    corner_errors,
    lens_vector,
    moved,
    pose_difference,
)
from vergence.calibration.refine import (
    EyeCamera,
    Refined,
    covariance_of,
    held_by_default,
    refine,
    refine_eye_camera,
)
from vergence.calibration.target import Chessboard, corner_points
from vergence.calibration.timing import Timing
from vergence.camera import Camera, pinhole, project
from vergence.errors import VergenceError
from vergence.geometry import inverse, pose, rotation, transform
from vergence.head import HeadCalibration, MountedCamera, T_base_cam
from vergence.kinematics import T_base_eye

BOARD = Chessboard(columns=9, rows=6, square_m=0.03)
POINTS = corner_points(BOARD)
LENS = pinhole(640, 480, 280.0)


# One eye before a board at rest.


@dataclass(frozen=True, eq=False)
class Recording:
    T_eye_cam: Array
    readings: Array
    pixels: Array


def record(
    seed: int,
    *,
    joint_std: float = 0.0,
    pixel_std_px: float = 0.0,
    views: int = 20,
    reach: tuple[float, float] = (0.25, 0.25),
) -> Recording:
    rng = np.random.default_rng(seed)
    T_eye_cam = random_pose(rng, 0.04, 0.004) @ pose(R_EYE_CAM, [0.02, 0, 0])
    angles = rng.uniform(-1, 1, (views, 2)) * reach
    pixels = see(T_eye_cam, T_base_eye(angles), rng)
    return Recording(
        T_eye_cam,
        angles + rng.normal(0, joint_std, angles.shape),
        pixels + rng.normal(0, pixel_std_px, pixels.shape),
    )


def see(T_eye_cam: Array, eye_poses: Array, rng: np.random.Generator) -> Array:
    R = R_EYE_CAM @ rotation(rng.normal(0, 0.3, 3))
    T_base_target = pose(R, [0.4, 0, 0] - R @ POINTS.mean(axis=0))
    T_cam_target = inverse(eye_poses @ T_eye_cam) @ T_base_target
    return project(LENS, transform(T_cam_target[:, None], POINTS))


def solve(recording: Recording, **options) -> EyeCamera:
    return refine_eye_camera(recording.readings, recording.pixels, POINTS, LENS, **options)


def size(T: Array, truth: Array) -> Array:
    """Return degrees and millimetres."""
    off = pose_difference(T, truth)
    return np.array([np.degrees(np.linalg.norm(off[:3])), 1e3 * np.linalg.norm(off[3:])])


def probability(off: Array, covariance: Array) -> float:
    """Return the stated probability of a smaller error."""
    return float(chi2.cdf(off @ np.linalg.solve(covariance, off), len(off)))


@given(st.integers(0, 10**6))
@settings(max_examples=10)
def test_an_exact_recording_gives_the_mounting_exactly(seed: int):
    recording = record(seed)
    found = solve(recording)
    np.testing.assert_allclose(found.T_eye_cam, recording.T_eye_cam, atol=1e-9)
    np.testing.assert_allclose(found.T_base_eye, T_base_eye(recording.readings), atol=1e-9)
    assert np.abs(found.residuals_px).max() < 1e-8
    assert not found.warnings


@pytest.fixture(scope="module")
def trials() -> list[tuple[Recording, EyeCamera, EyeCamera]]:
    """Thirty recordings with 0.1 degrees and 0.1 px, refined with latent and with exact joints."""
    recordings = [record(k, joint_std=np.radians(0.1), pixel_std_px=0.1) for k in range(30)]
    # Without robustness: exact joints would take half of the views for outliers.
    return [(r, solve(r), solve(r, joint_std=0, outlier=np.inf)) for r in recordings]


def test_latent_joints_err_a_fifth_of_what_exact_joints_do(trials):
    latent = np.median([size(found.T_eye_cam, r.T_eye_cam) for r, found, _ in trials], axis=0)
    exact = np.median([size(found.T_eye_cam, r.T_eye_cam) for r, _, found in trials], axis=0)
    assert (latent < [0.12, 0.5]).all()
    assert (latent < exact / 3.5).all()


def test_stated_regions_hold_the_truth(trials):
    p = [
        probability(pose_difference(found.T_eye_cam, r.T_eye_cam), found.covariance)
        for r, found, _ in trials
    ]
    # Of 30, between 25 and 30 are expected in the 95 % region, and 6 to 24 in the 50 % one.
    assert np.count_nonzero(np.array(p) < 0.95) >= 25
    assert 6 <= np.count_nonzero(np.array(p) < 0.5) <= 24


def test_both_levels_of_noise_are_found(trials):
    pixel = np.mean([found.pixel_std_px for _, found, _ in trials])
    joint = np.mean([found.joint_std[0] for _, found, _ in trials])
    assert pixel == pytest.approx(0.1, rel=0.02)
    assert joint == pytest.approx(np.radians(0.1), rel=0.08)


def test_good_recordings_give_no_warnings(trials):
    assert not any(found.warnings for _, found, _ in trials)


def test_without_joint_noise_the_result_is_that_of_exact_joints():
    recordings = [record(k, pixel_std_px=0.1) for k in range(12)]
    latent = [size(solve(r).T_eye_cam, r.T_eye_cam) for r in recordings]
    exact = [size(solve(r, joint_std=0).T_eye_cam, r.T_eye_cam) for r in recordings]
    assert (np.mean(latent, axis=0) < 1.05 * np.mean(exact, axis=0)).all()


def test_noise_that_is_told_is_used():
    found = solve(record(1, joint_std=0.002, pixel_std_px=0.1), joint_std=0.004, pixel_std_px=0.3)
    assert found.joint_std == pytest.approx((0.004,))
    assert found.pixel_std_px == pytest.approx(0.3)


def test_wild_corners_and_a_wild_reading_do_little_harm():
    recording = record(2, joint_std=0.001, pixel_std_px=0.1)
    rng = np.random.default_rng(2)
    wild = rng.random(recording.pixels.shape[:2]) < 0.03
    recording.pixels[wild] += rng.normal(0, 8, (np.count_nonzero(wild), 2))
    recording.readings[3, 0] += 0.1
    found = solve(recording)
    off = pose_difference(found.T_eye_cam, recording.T_eye_cam)
    assert (np.abs(off) < 4 * np.sqrt(np.diag(found.covariance))).all()
    assert found.joint_std[0] < 0.002
    assert any("corners lie beyond 4 standard deviations" in text for text in found.warnings)


def test_corners_may_be_missing():
    recording = record(3)
    recording.pixels[0] = np.nan
    recording.pixels[1:, ::2] = np.nan
    found = solve(recording)
    np.testing.assert_allclose(found.T_eye_cam, recording.T_eye_cam, atol=1e-9)
    np.testing.assert_array_equal(np.isnan(found.residuals_px), np.isnan(recording.pixels))


@pytest.mark.parametrize("flips", [1, 6])
def test_boards_numbered_from_the_wrong_end_are_left_out_and_named(flips: int):
    recording = record(40, joint_std=0.001, pixel_std_px=0.1)
    recording.pixels[:flips] = recording.pixels[:flips, ::-1]
    found = solve(recording)
    off = pose_difference(found.T_eye_cam, recording.T_eye_cam)
    assert (np.abs(off) < 4 * np.sqrt(np.diag(found.covariance))).all()
    numbers = ", ".join(map(str, range(flips)))
    assert found.warnings[0].startswith(f"Views {numbers} were left out")
    assert len(found.warnings) == 1


# Eye poses that are no pan and tilt.


def record_poses(seed: int, std: tuple[float, float], pixel_std_px: float) -> Recording:
    rng = np.random.default_rng(seed)
    T_eye_cam = random_pose(rng, 0.04, 0.004) @ pose(R_EYE_CAM, [0.02, 0, 0])
    poses = pose(rotation(rng.uniform(-0.25, 0.25, (25, 3))), rng.normal(0, 0.02, (25, 3)))
    pixels = see(T_eye_cam, poses, rng)
    noise = rng.normal(size=(25, 6)) * np.repeat(std, 3)
    pixels = pixels + rng.normal(0, pixel_std_px, pixels.shape)
    return Recording(T_eye_cam, moved(poses, noise), pixels)


def test_exact_general_eye_poses_give_the_mounting_exactly():
    recording = record_poses(4, (0.0, 0.0), 0.0)
    np.testing.assert_allclose(solve(recording).T_eye_cam, recording.T_eye_cam, atol=1e-9)


def test_general_eye_poses_have_noise_in_rotation_and_translation():
    recordings = [record_poses(k, (0.002, 0.0005), 0.1) for k in range(10)]
    found = [solve(recording) for recording in recordings]
    levels = np.mean([f.joint_std for f in found], axis=0)
    np.testing.assert_allclose(levels, [0.002, 0.0005], rtol=0.1)
    p = [
        probability(pose_difference(f.T_eye_cam, r.T_eye_cam), f.covariance)
        for f, r in zip(found, recordings, strict=True)
    ]
    assert max(p) < 0.9999
    assert np.count_nonzero(np.array(p) < 0.95) >= 7


def test_poses_of_pan_and_tilt_are_taken_as_pan_and_tilt():
    recording = record(5, joint_std=0.002, pixel_std_px=0.1)
    poses = replace(recording, readings=T_base_eye(recording.readings))
    np.testing.assert_allclose(solve(poses).T_eye_cam, solve(recording).T_eye_cam, atol=1e-9)


# Recordings that cannot support the answer.


@pytest.mark.parametrize(
    ("reach", "words"),
    [
        ((0.25, 0), ["T_eye_cam rotation about z and translation along z", "all tilt motion"]),
        ((0, 0.25), ["T_eye_cam rotation about y and translation along y", "all pan motion"]),
        ((0, 0), ["rotation about x", "rotation about z", "translation along y", "move pan"]),
    ],
)
def test_an_axis_that_does_not_move_is_named_with_what_it_hides(
    reach: tuple[float, float], words: list[str]
):
    recording = record(6, joint_std=0.002, pixel_std_px=0.1, reach=reach)
    found = solve(recording, start=recording.T_eye_cam)
    text = " ".join(found.warnings)
    assert "not observable" in text
    assert "is no larger than its noise (0.00" in text
    assert all(word in text for word in words)
    assert "by at least 0.1 rad" in text


def test_an_unobservable_direction_stays_at_its_start():
    recording = record(6, joint_std=0.002, pixel_std_px=0.1, reach=(0.25, 0))
    start = moved(recording.T_eye_cam, np.array([0.01, 0, 0.02, 0, 0.002, 0.004]))
    off = pose_difference(solve(recording, start=start).T_eye_cam, recording.T_eye_cam)
    assert off[2] == pytest.approx(0.02, abs=2e-3)
    assert off[5] == pytest.approx(0.004, abs=1e-3)
    assert abs(off[0]) < 0.008


def test_a_motion_that_is_small_but_seen_leaves_a_large_stated_error():
    recording = record(7, joint_std=0.001, pixel_std_px=0.1, reach=(0.25, 0.005))
    found = solve(recording)
    off = pose_difference(found.T_eye_cam, recording.T_eye_cam)
    assert probability(off, found.covariance) < 0.99
    assert any("tilt of the eye moves by 0.0" in text for text in found.warnings)


def test_pan_and_tilt_that_move_together_are_named():
    recording = record(8)
    angles = np.repeat(recording.readings[:, :1], 2, axis=1)
    rng = np.random.default_rng(8)
    pixels = see(recording.T_eye_cam, T_base_eye(angles), rng)
    together = Recording(
        recording.T_eye_cam,
        angles + rng.normal(0, 0.002, angles.shape),
        pixels + rng.normal(0, 0.1, pixels.shape),
    )
    text = " ".join(solve(together, start=recording.T_eye_cam).warnings)
    assert "observable" in text
    assert "pan and tilt of the eye move together" in text


def test_two_views_are_too_few_and_said_so():
    recording = record(9, joint_std=0.002, pixel_std_px=0.1, views=2)
    text = " ".join(solve(recording, start=recording.T_eye_cam).warnings)
    assert "not observable" in text
    assert "noise of the joint readings cannot be told" in text


def test_general_poses_about_one_axis_are_named():
    rng = np.random.default_rng(10)
    T_eye_cam = pose(R_EYE_CAM, [0.02, 0, 0])
    turns = rng.uniform(-0.25, 0.25, (20, 1)) * [1, 0, 0]
    poses = pose(rotation(turns), np.full((20, 3), 0.01))
    found = solve(Recording(T_eye_cam, poses, see(T_eye_cam, poses, rng)), start=T_eye_cam)
    text = " ".join(found.warnings)
    assert "rotation about x and translation along x: not observable" in text
    assert "share one axis" in text


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"readings": np.zeros((20, 3))}, "found \\(20, 3\\)"),
        ({"readings": np.full((20, 2), np.nan)}, "finite readings"),
        ({"pixels": np.zeros((19, 54, 2))}, "for 20 views of 54 points"),
        ({"pixels": np.full((20, 54, 2), np.nan)}, "at least 3 views"),
    ],
)
def test_data_that_do_not_fit_are_refused(changes: dict, message: str):
    with pytest.raises(VergenceError, match=message):
        solve(replace(record(11), **changes))


# The whole head.


def views_of(
    head: HeadCalibration,
    rng: np.random.Generator,
    *,
    joint_std: float = 0.0,
    pixel_std_px: float = 0.0,
) -> Views:
    """Return 12 boards before eyes at rest, then two boards before eyes at 28 random angles."""
    angles = np.concatenate([np.zeros((12, 4)), rng.uniform(-0.25, 0.25, (28, 4))])
    return seen_at(head, rng, angles, angles, joint_std=joint_std, pixel_std_px=pixel_std_px)


def timed_views_of(
    head: HeadCalibration,
    rng: np.random.Generator,
    *,
    time_offset_s: float,
    joint_std: float = 0.0,
    pixel_std_px: float = 0.0,
) -> tuple[Views, Timing]:
    """Return the same, but for the eyes: they move, along cubics, while they are read at 30 Hz."""
    time_s = np.arange(40) / 30
    run = (np.arange(40) >= 12).astype(int)
    course = rng.permuted(np.tile([0.05, 0.1, -0.2, 0.15], (4, 1)), axis=1).T

    def angles(t: Array) -> Array:
        return run[:, None] * chebval((t - time_s[26]) / 0.45, course).T

    read, seen = angles(time_s), angles(time_s + time_offset_s)
    views = seen_at(head, rng, read, seen, joint_std=joint_std, pixel_std_px=pixel_std_px)
    return views, Timing(time_s, run)


def seen_at(
    head: HeadCalibration,
    rng: np.random.Generator,
    readings: Array,
    angles: Array,
    *,
    joint_std: float,
    pixel_std_px: float,
) -> Views:
    """Return views of 14 boards with noise, of eyes that read (40, 4) and stand at (40, 4)."""
    placement = np.concatenate([np.arange(12), 12 + np.arange(28) % 2])
    turned = R_EYE_CAM @ rotation(rng.uniform(-0.5, 0.5, (14, 3)))
    distance = np.concatenate([rng.uniform(0.35, 0.9, 12), [0.5, 0.8]])[:, None]
    centre = distance * np.concatenate([np.ones((14, 1)), rng.uniform(-0.2, 0.2, (14, 2))], axis=1)
    T_lbase_target = pose(turned, centre - turned @ POINTS.mean(axis=0))[placement]
    corners = {}
    for name, mounted in head.cameras.items():
        mine = angles[:, :2] if mounted.eye == "left" else angles[:, 2:]
        T_base_lbase = np.eye(4) if mounted.eye == "left" else head.T_rbase_lbase
        T_cam_target = inverse(T_base_cam(head, name, mine)) @ T_base_lbase @ T_lbase_target
        pixels = project(mounted.intrinsics, transform(T_cam_target[:, None], POINTS))
        pixels = pixels + rng.normal(0, pixel_std_px, pixels.shape)
        inside = ((pixels > 0) & (pixels < [639, 479])).all(axis=-1, keepdims=True)
        corners[name] = np.where(inside, pixels, np.nan)
    readings = readings + rng.normal(0, joint_std, readings.shape)
    sizes = {name: (640, 480) for name in corners}
    return Views(BOARD, placement, readings, corners, sizes)


def spoilt(head: HeadCalibration, rng: np.random.Generator) -> HeadCalibration:
    """Return a start: the head about as wrong as the paper's method leaves it, perfect gains."""
    cameras = {}
    for name, mounted in head.cameras.items():
        lens = mounted.intrinsics
        matrix = lens.matrix + np.diag([3.0, 3.0, 0.0]) + [[0, 0, 2], [0, 0, -2], [0, 0, 0]]
        cameras[name] = MountedCamera(
            eye=mounted.eye,
            intrinsics=Camera(
                width=640, height=480, matrix=matrix, distortion=0.9 * lens.distortion
            ),
            T_eye_cam=moved(mounted.T_eye_cam, rng.normal(0, 0.003, 6)),
        )
    return replace(
        head,
        cameras=cameras,
        T_rbase_lbase=moved(head.T_rbase_lbase, rng.normal(0, 0.003, 6)),
        axes={
            eye: replace(axes, pan_gain=1.0, tilt_gain=1.0, nonorthogonality_rad=0.0)
            for eye, axes in head.axes.items()
        },
    )


def errors(found: Refined, head: HeadCalibration, time_offset_s: float = 0.0) -> Array:
    """Return (c,) in the order of Refined.parameters."""
    parts = []
    for name in head.cameras:
        if f"{name}.fx" in found.parameters:
            mine, truth = found.head.cameras[name], head.cameras[name]
            parts.append(lens_vector(mine.intrinsics) - lens_vector(truth.intrinsics))
            parts.append(pose_difference(mine.T_eye_cam, truth.T_eye_cam))
    parts.append(pose_difference(found.head.T_rbase_lbase, head.T_rbase_lbase))
    for eye, axes in head.axes.items():
        parts.append(np.subtract(axes_row(found.head.axes[eye]), axes_row(axes)))
    return np.concatenate([*parts, [found.time_offset_s - time_offset_s]])


def stated_std(found: Refined) -> Array:
    return np.sqrt(np.diag(found.covariance))


def test_an_exact_recording_gives_the_head_exactly():
    rng = np.random.default_rng(20)
    head = random_head(rng)
    views, timing = timed_views_of(head, rng, time_offset_s=0.02)
    found = refine(spoilt(head, rng), views, timing=timing)
    assert np.abs(errors(found, head, 0.02)).max() < 1e-7  # the largest are of pixels
    assert not found.warnings


@pytest.fixture(scope="module")
def noisy_heads() -> list[tuple[HeadCalibration, Refined]]:
    """Six heads with joint noise of 0.05 degrees, 0.1 px, and images 15 ms late."""
    results = []
    for seed in range(6):
        rng = np.random.default_rng(100 + seed)
        head = random_head(rng)
        views, timing = timed_views_of(
            head, rng, joint_std=np.radians(0.05), pixel_std_px=0.1, time_offset_s=0.015
        )
        results.append((head, refine(spoilt(head, rng), views, timing=timing)))
    return results


def test_every_parameter_of_a_head_is_found_within_its_stated_accuracy(noisy_heads):
    for head, found in noisy_heads:
        off, std = errors(found, head, 0.015), stated_std(found)
        assert (np.abs(off) <= 4.5 * std).all()
        assert np.count_nonzero(std) >= 60
        assert not found.warnings


def test_regions_of_the_parts_of_a_head_hold_the_truth(noisy_heads):
    p = []
    for head, found in noisy_heads:
        off = errors(found, head, 0.015)
        parts = ["T_rbase_lbase"]
        for camera in head.cameras:
            parts.append(f"{camera}.T_eye_cam")
        for part in parts:
            chosen = [name.rpartition(".")[0] == part for name in found.parameters]
            p.append(probability(off[chosen], covariance_of(found, part)))
    # The five regions of a head err together: one head in six may well have all of them outside.
    assert np.mean(np.array(p) < 0.95) > 0.7
    assert max(p) < 0.9999


def test_the_time_offset_is_found_within_a_millisecond(noisy_heads):
    for _, found in noisy_heads:
        assert abs(found.time_offset_s - 0.015) < 1e-3


def test_the_noise_of_a_head_is_found(noisy_heads):
    assert np.mean([found.pixel_std_px for _, found in noisy_heads]) == pytest.approx(0.1, rel=0.02)
    joint = np.mean([found.joint_std for _, found in noisy_heads], axis=0)
    np.testing.assert_allclose(joint, np.radians(0.05), rtol=0.1)  # pan and tilt apart


def test_what_is_held_keeps_its_start_and_has_no_variance():
    rng = np.random.default_rng(21)
    head = random_head(rng)
    views = views_of(head, rng, pixel_std_px=0.1)
    start = spoilt(head, rng)
    hold = held_by_default(start, timed=False) | {"left_wide.fx", "left_wide.fy"}
    found = refine(start, views, hold=hold)
    matrix = found.head.cameras["left_wide"].intrinsics.matrix
    assert matrix[0, 0] == start.cameras["left_wide"].intrinsics.matrix[0, 0]
    assert covariance_of(found, "left_wide.fx") == 0
    assert covariance_of(found, "left_wide.cx") > 0
    assert covariance_of(found, "left_wide").shape == (9, 9)
    for name in ("left.pan_offset_rad", "right.tilt_offset_rad", "left_wide.k3", "time_offset_s"):
        assert covariance_of(found, name) == 0


def test_general_eye_poses_calibrate_a_whole_head():
    rng = np.random.default_rng(22)
    head = random_head(rng)
    views = views_of(head, rng)
    both = [
        T_base_eye(views.eye_angles[:, s], head.axes[eye])
        for eye, s in (("left", slice(2)), ("right", slice(2, 4)))
    ]
    found = refine(spoilt(head, rng), views, eye_poses_read=np.stack(both, axis=1))
    off = errors(found, head)
    poses = [i for i, name in enumerate(found.parameters) if "T_" in name]
    assert np.abs(off[poses]).max() < 1e-8


def test_a_camera_that_sees_no_board_is_named_and_left_alone():
    rng = np.random.default_rng(23)
    head = random_head(rng)
    views = views_of(head, rng, joint_std=1e-3, pixel_std_px=0.1)
    blind = {**views.corners, "left_narrow": np.full_like(views.corners["left_narrow"], np.nan)}
    start = spoilt(head, rng)
    found = refine(start, replace(views, corners=blind))
    assert "left_narrow sees no board, and stays at its start." in found.warnings
    assert found.head.cameras["left_narrow"] is start.cameras["left_narrow"]
    assert len(found.parameters) == 3 * PER_CAMERA + 19


def test_eyes_that_never_see_the_same_board_leave_their_pose_open():
    rng = np.random.default_rng(24)
    head = random_head(rng)
    views = views_of(head, rng, joint_std=1e-3, pixel_std_px=0.1)
    left = np.arange(len(views.placement)) % 4 < 2  # of either board before moving eyes
    corners = {
        name: np.where((left == name.startswith("left"))[:, None, None], pixels, np.nan)
        for name, pixels in views.corners.items()
    }
    apart = replace(views, corners=corners, placement=views.placement + 100 * ~left)
    text = " ".join(refine(spoilt(head, rng), apart).warnings)
    assert "T_rbase_lbase rotation about x" in text
    assert "no board stands where both eyes see it" in text


def one_placement_a_view(seed: int) -> tuple[HeadCalibration, HeadCalibration, Views]:
    """Return a head, its start, and views of boards that were moved between all of them."""
    rng = np.random.default_rng(seed)
    head = random_head(rng)
    views = views_of(head, rng, joint_std=1e-3, pixel_std_px=0.1)
    return head, spoilt(head, rng), replace(views, placement=np.arange(len(views.placement)))


def test_one_eye_that_sees_each_board_once_leaves_its_mountings_open():
    _, start, views = one_placement_a_view(25)
    left = {name: pixels for name, pixels in views.corners.items() if name.startswith("left")}
    found = refine(start, replace(views, corners=left))
    text = " ".join(found.warnings)
    assert "left_wide.T_eye_cam" in text
    assert "left_narrow.T_eye_cam" in text
    assert "not observable" in text
    assert "sees each board in one view only" in text
    assert "right_wide sees no board" in text


def test_two_eyes_that_see_the_same_boards_need_no_board_at_rest():
    head, start, views = one_placement_a_view(26)
    found = refine(start, views)
    assert not found.warnings
    assert (np.abs(errors(found, head)) <= 4.5 * stated_std(found)).all()


def test_images_that_show_too_little_of_a_board_are_named():
    rng = np.random.default_rng(26)
    head = random_head(rng)
    views = views_of(head, rng, joint_std=1e-3, pixel_std_px=0.1)
    corners = {name: pixels.copy() for name, pixels in views.corners.items()}
    for pixels in corners.values():
        pixels[5, 9:] = np.nan  # one row: all corners in line
    found = refine(spoilt(head, rng), replace(views, corners=corners))
    assert any(text.startswith("Views 5 were left out") for text in found.warnings)
    assert np.isnan(found.T_base_eye[5]).all()


def test_a_board_that_one_camera_numbers_from_the_wrong_end_is_left_out_and_named():
    rng = np.random.default_rng(29)
    head = random_head(rng)
    views = views_of(head, rng, joint_std=1e-3, pixel_std_px=0.1)
    whole = np.isfinite(views.corners["left_wide"]).all(axis=(1, 2)) & (views.placement >= 12)
    view = int(np.flatnonzero(whole)[3])
    views.corners["left_wide"][view] = views.corners["left_wide"][view, ::-1]
    found = refine(spoilt(head, rng), views)
    assert (np.abs(errors(found, head)) <= 4.5 * stated_std(found)).all()
    assert found.warnings[0].startswith(f"Views {view} of left_wide were left out")


def test_a_missing_reading_is_refused_with_its_view():
    rng = np.random.default_rng(27)
    head = random_head(rng)
    views = views_of(head, rng)
    views.eye_angles[7, 3] = np.nan
    with pytest.raises(VergenceError, match="right eye sees a board in view 7"):
        refine(head, views)


def test_a_name_that_is_no_parameter_is_refused():
    rng = np.random.default_rng(28)
    head = random_head(rng)
    views = views_of(head, rng)
    with pytest.raises(VergenceError, match=r"no parameter 'left_wide\.focal'"):
        refine(head, views, hold={"left_wide.focal"})
    with pytest.raises(VergenceError, match="time_s of shape"):
        refine(head, views, timing=Timing(np.zeros(3), np.zeros(3, dtype=int)))


# The derivatives.


def numeric(problem: Problem, state: State, step: float = 1e-6) -> tuple[Array, Array]:
    """Return derivatives (M, K, 2, G) and (M, K, 2, n) of corner_errors by central differences."""
    G, (B, n) = len(problem.free), problem.reading.shape

    def slope(shared: Array, latent: Array) -> Array:
        ahead = corner_errors(problem, advance(problem, state, shared, latent))
        behind = corner_errors(problem, advance(problem, state, -shared, -latent))
        return (ahead - behind) / (2 * step)

    by_shared = [slope(step * row, np.zeros((B, n))) for row in np.eye(G)]
    by_latent = [slope(np.zeros(G), np.tile(step * row, (B, 1))) for row in np.eye(n)]
    return np.stack(by_shared, axis=-1), np.stack(by_latent, axis=-1)


@pytest.mark.parametrize("general", [False, True])
def test_analytic_derivatives_agree_with_differences(general: bool):
    rng = np.random.default_rng(30)
    head = random_head(rng)
    views = views_of(head, rng)
    keep = [0, 1, 12, 13, 14, 15]
    few = Views(
        BOARD,
        views.placement[keep],
        views.eye_angles[keep],
        {name: pixels[keep] for name, pixels in views.corners.items()},
        views.sizes,
    )
    poses = None
    if general:
        eyes = np.stack([T_base_eye(few.eye_angles[:, s]) for s in (slice(2), slice(2, 4))], 1)
        poses = moved(eyes, rng.normal(0, 0.01, (6, 2, 6)))
    problem, state, _ = whole_head(head, few, timing=None, poses=poses, hold=())
    # Away from the optimum, where the errors of general poses are not small.
    state = advance(
        problem,
        state,
        rng.normal(0, 1e-3, len(problem.free)),
        rng.normal(0, 0.05, problem.reading.shape),
    )
    expected_shared, expected_latent = numeric(problem, state)
    shared, index, latent = jacobians(problem, state)
    dense = np.zeros_like(expected_shared)
    for m, columns in enumerate(index):
        dense[m][..., columns] = shared[m]
    names = np.array(calibration_names(problem.cameras))
    joint = np.isin([name.rpartition(".")[2] for name in names], ["pan_gain", "time_offset_s"])
    assert joint.sum() == 3
    scale = np.abs(expected_shared).max(axis=(0, 1, 2)) + 1.0
    np.testing.assert_allclose(dense / scale, expected_shared / scale, atol=1e-6)
    np.testing.assert_allclose(latent, expected_latent, atol=1e-4, rtol=1e-6)


@given(st.integers(0, 10**6))
def test_a_difference_of_poses_leads_from_one_to_the_other(seed: int):
    rng = np.random.default_rng(seed)
    a, b = random_pose(rng), random_pose(rng)
    np.testing.assert_allclose(moved(b, pose_difference(a, b)), a, atol=1e-12)
