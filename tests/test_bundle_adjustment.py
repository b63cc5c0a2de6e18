"""Bundle adjustment of a whole head: exact data give no error, noise the stated one."""

import re
from dataclasses import replace

import numpy as np
import pytest

from simulated_head import probability, random_head, rough_start, skewed_head
from simulated_recording import (
    EXACT,
    POINTS,
    Noise,
    moving_recording,
    still_recording,
    two_boards,
)
from texts import texts
from vergence.arrays import Array
from vergence.calibration.bundle_adjustment import (
    BundleEstimate,
    NoiseModel,
    bundle_adjust,
    covariance_of,
    fixed_by_default,
)
from vergence.calibration.observations import Observations
from vergence.errors import VergenceError
from vergence.estimation import adjustment
from vergence.estimation.least_squares import least_squares
from vergence.geometry.head import HeadCalibration, parameter_names, pixel_stds
from vergence.geometry.parameters import boxminus, without_offsets
from vergence.vision.board_pose import board_poses

NOISY = Noise(pixel_px=0.1, joint_rad=1e-3)
OFFSET_S = 0.015


def simulated(
    seed: int, noise: Noise = EXACT, time_offset_s: float | None = None
) -> tuple[HeadCalibration, Observations, HeadCalibration]:
    """Return a head, what it observes, and a start."""
    rng = np.random.default_rng(seed)
    head = without_offsets(skewed_head(rng))
    observed = two_boards(head, rng, noise=noise, time_offset_s=time_offset_s)
    if time_offset_s is not None:
        head = replace(head, time_offset_s=time_offset_s)
    return head, observed, replace(rough_start(head, rng), time_offset_s=0.0)


def errors(found: BundleEstimate, head: HeadCalibration) -> Array:
    """Return (c,) in the order of BundleEstimate.parameters."""
    return np.array(list(boxminus(found.head, head).values()))


def stated_std(found: BundleEstimate) -> Array:
    return np.sqrt(np.diag(found.covariance))


def assert_within_stated(found: BundleEstimate, head: HeadCalibration) -> None:
    assert (np.abs(errors(found, head)) <= 4.5 * stated_std(found)).all()


@pytest.mark.parametrize("given", [(), ("left_wide", "right_wide")])
def test_an_exact_recording_gives_the_head_exactly(given: tuple[str, ...]):
    """The poses of boards may be given by camera; they are no more than a start."""
    head, observed, start = simulated(20, time_offset_s=0.02)
    poses = {
        name: board_poses(start.cameras[name].intrinsics, observed.corners[name], POINTS)
        for name in given
    }
    found = bundle_adjust(start, observed, T_cam_target=poses)
    assert np.abs(errors(found, head)).max() < 1e-7  # the largest are of pixels
    assert not texts(found.findings)


@pytest.fixture(scope="module")
def noisy_heads(slow_setup: None) -> list[tuple[HeadCalibration, BundleEstimate]]:
    """Four heads with joint noise of 0.05 degrees, 0.1 px, and images 15 ms late."""
    noise, results = Noise(pixel_px=0.1, joint_rad=np.radians(0.05)), []
    for seed in range(100, 104):
        head, observed, start = simulated(seed, noise, OFFSET_S)
        results.append((head, bundle_adjust(start, observed)))
    return results


def test_every_parameter_of_a_head_is_found_within_its_stated_accuracy(noisy_heads):
    for head, found in noisy_heads:
        assert_within_stated(found, head)
        assert np.count_nonzero(stated_std(found)) >= 60
        assert not texts(found.findings)
        assert abs(found.head.time_offset_s - OFFSET_S) < 1e-3
        assert found.pixel_std_px == pytest.approx(0.1, rel=0.05)


def test_regions_of_the_parts_of_a_head_hold_the_truth(noisy_heads):
    p = []
    for head, found in noisy_heads:
        off = errors(found, head)
        for part in ("T_rbase_lbase", *(f"{camera}.T_eye_cam" for camera in head.cameras)):
            chosen = [name.rpartition(".")[0] == part for name in found.parameters]
            p.append(probability(off[chosen], covariance_of(found, part)))
    # The five regions of a head err together: one head in four may well have all of them outside.
    assert np.mean(np.array(p) < 0.95) > 0.7
    assert max(p) < 0.9999


def test_what_is_fixed_keeps_its_start_and_has_no_variance():
    _, observed, start = simulated(21, Noise(pixel_px=0.1))
    observed = observed.take(np.arange(0, 40, 2))
    fixed = fixed_by_default(start, timed=False) | {"left_wide.fx", "left_wide.fy"}
    found = bundle_adjust(start, observed, fixed=fixed)
    matrix = found.head.cameras["left_wide"].intrinsics.matrix
    assert matrix[0, 0] == start.cameras["left_wide"].intrinsics.matrix[0, 0]
    assert covariance_of(found, "left_wide.fx") == 0
    assert covariance_of(found, "left_wide.cx") > 0
    assert covariance_of(found, "left_wide").shape == (9, 9)
    for name in ("left.pan_offset_rad", "right.tilt_offset_rad", "left_wide.k3", "time_offset_s"):
        assert covariance_of(found, name) == 0


def test_a_camera_that_sees_no_board_is_named_and_left_alone():
    _, observed, start = simulated(23, NOISY)
    observed = observed.take(np.arange(0, 40, 2))
    nothing = np.full_like(observed.corners["left_narrow"], np.nan)
    blind = replace(observed, corners={**observed.corners, "left_narrow": nothing})
    found = bundle_adjust(start, blind)
    assert "left_narrow sees no board, and keeps its start." in texts(found.findings)
    kept, was = (h.cameras["left_narrow"] for h in (found.head, start))
    np.testing.assert_array_equal(kept.intrinsics.matrix, was.intrinsics.matrix)
    np.testing.assert_array_equal(kept.T_eye_cam, was.T_eye_cam)
    assert found.parameters == parameter_names(start)
    assert "left_narrow" not in found.residuals_px
    assert not any(name.startswith("left_narrow") for name in found.accuracy.parameters)


def test_eyes_that_never_see_the_same_board_leave_their_pose_open():
    _, observed, start = simulated(24, NOISY)
    left = np.arange(40) % 4 < 2  # of either board before moving eyes
    corners = {
        name: np.where((left == name.startswith("left"))[:, None, None], pixels, np.nan)
        for name, pixels in observed.corners.items()
    }
    apart = replace(observed, corners=corners, placement=observed.placement + 100 * ~left)
    text = " ".join(texts(bundle_adjust(start, apart).findings))
    assert "T_rbase_lbase rotation about x" in text
    assert "no board stands where both eyes see it" in text


def test_images_that_show_too_little_of_a_board_or_number_it_otherwise_are_left_out_and_named():
    head, observed, start = simulated(29, NOISY)
    corners = observed.corners["left_wide"]
    whole = np.isfinite(corners).all(axis=(1, 2)) & (observed.placement >= 12)
    view = int(np.flatnonzero(whole)[3])
    corners[view] = corners[view, ::-1]
    for pixels in observed.corners.values():
        pixels[5, 9:] = np.nan  # one row: all corners in line
    found = bundle_adjust(start, observed)
    assert_within_stated(found, head)
    assert np.isnan(found.T_base_eye[5]).all()
    assert {each.where for each in found.findings} == {"view 5", f"view {view}"}
    assert {each.severity for each in found.findings} == {"note"}
    assert found.left_out["left_wide"][view].all()
    assert not found.left_out["right_wide"][view].all()


def test_a_missing_reading_and_a_name_that_is_no_parameter_are_refused():
    head, observed, _ = simulated(27)
    with pytest.raises(VergenceError, match=r"no parameter 'left_wide\.focal'"):
        bundle_adjust(head, observed, fixed={"left_wide.focal"})
    observed.eye_angles[7, 3] = np.nan
    with pytest.raises(VergenceError, match="right eye sees a board in view 7"):
        bundle_adjust(head, observed)


def test_a_reading_that_contradicts_its_image_is_named_with_by_how_much():
    head, observed, start = simulated(31, NOISY)
    observed.eye_angles[20, 2] += np.radians(4)
    found = bundle_adjust(start, observed)
    (said,) = texts(found.findings, "note")
    assert re.fullmatch(
        r"View 20 was left out: right_pan is off by (3\.9|4(\.[01])?) degrees.", said
    )
    assert found.left_out["right_wide"][20].all()
    assert_within_stated(found, head)


def test_a_view_in_which_the_board_moved_is_named():
    _, observed, start = simulated(31, NOISY)
    turned = np.array([[1.0, 0.03], [-0.03, 1.0]])
    for corners in observed.corners.values():
        middle = corners[20].mean(axis=0)
        corners[20] = (corners[20] - middle) @ turned + middle + [5, -8]
    found = bundle_adjust(start, observed, noise=NoiseModel(0.1, 1e-3))
    (said,) = texts(found.findings, "note")
    assert re.match(r"View 20 was left out: .* and right_wide cannot show the board as", said)


def test_noise_that_is_given_may_be_far_below_the_errors_of_the_start():
    """As that of a part of the views, which starts with boards where single readings put them."""
    noise = Noise(pixel_px=0.01, joint_rad=0.01)
    head, observed, start = simulated(34, noise)
    observed = observed.take(np.arange(12, 40))  # two boards, each in many views
    found = bundle_adjust(start, observed, noise=NoiseModel(0.01, 0.01))
    assert not texts(found.findings, "void")
    assert_within_stated(found, head)


def test_cameras_that_differ_in_noise_have_levels_of_their_own():
    _, observed, start = simulated(36, NOISY)
    rng = np.random.default_rng(0)
    corners = dict(observed.corners)
    for name in ("right_wide", "right_narrow"):
        corners[name] = corners[name] + rng.normal(0, 0.4, corners[name].shape)
    found = bundle_adjust(start, replace(observed, corners=corners))
    for name, expected in (("left_wide", 0.1), ("right_wide", np.hypot(0.1, 0.4))):
        assert found.camera_std_px[name] == pytest.approx(expected, rel=0.1)
    stated = replace(found.head, accuracy=found.accuracy)
    std = pixel_stds(stated, ("left_wide", "right_wide"))
    np.testing.assert_allclose(std, np.repeat([0.1, np.hypot(0.1, 0.4)], 2), rtol=0.1)
    assert 0.1 < found.pixel_std_px < 0.4


@pytest.mark.slow
def test_a_board_that_moving_eyes_see_now_and_then_tells_the_time_offset():
    rng = np.random.default_rng(1)
    head = random_head(rng, lenses=("wide",))
    times_s = np.arange(150) / 30
    phase = rng.uniform(0, 2 * np.pi, 4)

    def gaze(time_s: Array) -> Array:
        return 0.2 * np.sin(np.multiply.outer(time_s, [3.0, 4.1, 3.3, 4.6]) + phase)

    still = still_recording(
        head, rng, NOISY, wide_views=12, narrow_views=0, orientations=20, spread_rad=0.25
    )
    observed = moving_recording(
        head, rng, NOISY, still, times_s=times_s, gaze=gaze, time_offset_s=0.02
    )
    hidden = np.arange(150) % 30 >= 2  # two rows a second show the board
    for corners in observed.corners.values():
        corners[-150:][hidden] = np.nan
    found = bundle_adjust(rough_start(head, rng), observed)
    row = found.parameters.index("time_offset_s")
    std = float(stated_std(found)[row])
    assert std < 2e-3
    assert abs(found.head.time_offset_s - 0.02) < 3.5 * std
    assert max(found.joint_std) < 1.3 * NOISY.joint_rad


@pytest.mark.parametrize(("apart_s", "late"), [(0.0, ""), (-0.01, "left"), (0.01, "right")])
def test_images_of_both_eyes_that_are_not_of_one_moment_are_noticed(apart_s: float, late: str):
    head, observed, _ = simulated(35, NOISY, OFFSET_S)
    _, other, _ = simulated(35, NOISY, OFFSET_S + apart_s)
    pair = {"left_wide": observed, "right_wide": other}
    head = replace(head, cameras={name: head.cameras[name] for name in pair})
    seen = replace(observed, corners={name: each.corners[name] for name, each in pair.items()})
    fixed = set(parameter_names(head)) - {"time_offset_s"}
    found = bundle_adjust(replace(head, time_offset_s=0.0), seen, fixed=fixed)
    said = [each for each in texts(found.findings) if each.startswith("Images of the")]
    assert len(said) == (late != "")
    for sentence in said:
        match = re.match(rf"Images of the {late} eye lag .* by about ([\d.]+) ms more", sentence)
        assert match is not None
        assert float(match[1]) == pytest.approx(10, abs=1.5)


def test_an_estimate_without_a_minimum_ends_after_some_rounds_and_says_so(monkeypatch):
    rounds = []

    def lost(residuals, x, **options):
        rounds.append(x)
        found = least_squares(residuals, x, **options)
        first = next(each for each in rounds if each.size == x.size)
        return replace(found, x=found.x if len(rounds) % 2 else first, converged=False)

    monkeypatch.setattr(adjustment, "least_squares", lost)
    monkeypatch.setattr(adjustment, "FAILURES", 2)  # to save time
    _, observed, start = simulated(33, NOISY)
    (said,) = texts(bundle_adjust(start, observed).findings, "void")
    assert len(rounds) <= 2 * adjustment.FAILURES + 1  # also with boards that may have moved
    assert said.startswith("The estimate did not converge, as where no head of this description")
