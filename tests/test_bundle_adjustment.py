"""Refinement of a whole head: exact data give no error, noise the stated one."""

from dataclasses import replace

import numpy as np
import pytest
from heads import random_head
from refining import probability, spoilt, timed_views_of, views_of
from vergence.calibration.bundle.refine import Refined, covariance_of, held_by_default, refine

from vergence.arrays import Array
from vergence.calibration.bundle.problem import PER_CAMERA, axes_row, lens_vector, pose_difference
from vergence.calibration.sequential.sequential import Views
from vergence.data.timing import Timing
from vergence.errors import VergenceError
from vergence.geometry.head import HeadCalibration
from vergence.geometry.kinematics import T_base_eye


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
def noisy_heads(slow_setup: None) -> list[tuple[HeadCalibration, Refined]]:
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
