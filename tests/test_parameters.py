"""A head as a vector: what increments change, and what their covariance says of points."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter

from simulated_head import plain_head, skewed_head
from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.geometry.head import (
    HeadCalibration,
    camera_pose_in_base,
    parameter_names,
    without_accuracy,
)
from vergence.geometry.head_accuracy import Accuracy
from vergence.geometry.parameters import (
    boxminus,
    boxplus,
    change_named,
    parameter_values,
    without_offsets,
)
from vergence.geometry.projection import project_point
from vergence.stereo.triangulation import triangulate_at
from vergence.stereo.uncertainty import locate

HEAD = plain_head(0.075, 280.0, camera_m=((0.02, 0, 0), (0.02, 0, 0)))
seeds = st.integers(0, 2**32 - 1)


def stated(head: HeadCalibration, rng: np.random.Generator) -> HeadCalibration:
    """Return a head that states a correlated covariance of plausible size."""
    names = parameter_names(head)
    chosen = tuple(n for n in names if n.endswith((".fx", "rx", "ry", "rz", "tx", "ty", "tz")))
    scale = [0.3 if n.endswith("fx") else 1e-3 if n[-2] == "r" else 2e-4 for n in chosen]
    A = np.eye(len(chosen)) + 0.2 * rng.normal(size=(len(chosen),) * 2)
    accuracy = Accuracy(
        method="bundle",
        parameters=chosen,
        covariance=scale * (A @ A.T) * np.array(scale)[:, None],
        pixel_std_px=0.1,
        joint_std=(1e-3,),
    )
    return replace(head, accuracy=accuracy)


def sight(head: HeadCalibration) -> dict[str, Array]:
    """Return pixels of a point at six postures, as locate takes them."""
    joints = np.random.default_rng(2).uniform(-0.2, 0.2, (6, 4))
    pixels = {
        eye: project_point(head, f"{eye}_wide", joints, np.array([0.5, 0.03, 0.02]))
        for eye in ("left", "right")
    }
    return {**pixels, "joints": joints}


@given(seeds)
def test_boxminus_is_the_increment_that_boxplus_makes(seed: int):
    rng = np.random.default_rng(seed)
    head = without_offsets(skewed_head(rng))
    names = parameter_names(head)
    change = rng.normal(0, 1e-3, len(names)) * [not n.endswith("offset_rad") for n in names]
    off = boxminus(boxplus(head, change), head)
    assert tuple(off) == names
    np.testing.assert_allclose(list(off.values()), change, atol=1e-12)


@given(seeds)
def test_a_changed_head_is_valid_though_it_is_not_checked_anew(seed: int):
    """Checked anew it is the same, with nothing left of the joints that it had before."""
    rng = np.random.default_rng(seed)
    head = skewed_head(rng)
    assert head.kinematics.chains  # is remembered
    changed = boxplus(head, rng.normal(0, 1e-3, len(parameter_names(head))))
    adapter = TypeAdapter(HeadCalibration)
    checked = adapter.validate_json(adapter.dump_json(changed))
    angles = rng.normal(0, 0.2, (3, 4))
    for name, mounted in changed.cameras.items():
        one, other = (
            camera_pose_in_base(changed, name, angles),
            camera_pose_in_base(checked, name, angles),
        )
        np.testing.assert_array_equal(one, other)
        assert not mounted.T_eye_cam.flags.writeable


@pytest.mark.parametrize(
    ("name", "size", "says"),
    [
        ("left_wide.fx", -1e4, "focal lengths are positive"),
        ("left.pan_gain", -1e4, "change by 1000 at most"),
        ("right_wide.T_eye_cam.ty", 1e7, "translations are at most 1e\\+06 m"),
        ("T_rbase_lbase.tx", -1e7, "translations are at most 1e\\+06 m"),
        ("left_wide.k1", 1e13, "matrix and distortion are below"),
        ("right_wide.T_eye_cam.tx", np.nan, "found NaN or infinity"),
        ("left.pan_gain", np.inf, "found NaN or infinity"),
    ],
)
def test_a_change_that_leaves_no_possible_head_is_refused(name: str, size: float, says: str):
    with pytest.raises(ValueError, match=says):
        change_named(HEAD, [name], np.array([size]))


def test_values_change_by_what_is_added_to_them():
    rng = np.random.default_rng(1)
    head = skewed_head(rng)
    change = rng.normal(0, 1e-3, len(parameter_names(head)))
    before, after = parameter_values(head), parameter_values(boxplus(head, change))
    for k, (name, value) in enumerate(before.items()):
        there = after[name]
        assert (value is None) == (there is None) == (".T_eye_cam." in name or "T_rbase" in name)
        if value is not None and there is not None:
            assert there - value == pytest.approx(change[k], abs=1e-12)


def test_named_parameters_change_alone():
    names = ("right_wide.cx", "T_rbase_lbase.ty", "left.pan_gain", "time_offset_s")
    change = (1.5, 1e-3, 0.01, 0.02)
    changed = boxminus(change_named(HEAD, names, np.array(change)), HEAD)
    moved = {name: value for name, value in changed.items() if abs(value) > 1e-15}
    assert moved == pytest.approx(dict(zip(names, change, strict=True)))
    with pytest.raises(VergenceError, match=r"no parameter 'left_wide\.focal'"):
        change_named(HEAD, ["left_wide.focal"], np.ones(1))


@given(seeds)
def test_a_head_without_offsets_sees_the_same(seed: int):
    rng = np.random.default_rng(seed)
    head = skewed_head(rng)
    plain = without_offsets(head)
    angles = rng.normal(0, 0.2, (10, 4))
    for name, mounted in head.cameras.items():
        one, other = (
            camera_pose_in_base(head, name, angles),
            camera_pose_in_base(plain, name, angles),
        )
        turn = one[0] @ np.linalg.inv(other[0])
        np.testing.assert_allclose(one, turn @ other, atol=1e-12)
        assert turn[2, 2] == pytest.approx(1)  # about the pan axis alone
        offset = head.kinematics.eyes[mounted.eye][0].offset_rad
        assert offset == pytest.approx(np.arctan2(turn[1, 0], turn[0, 0]))


# What a covariance of these increments says of points


def test_a_row_of_the_covariance_moves_points_as_the_covariance_of_points_says():
    """To first order, cov(point) = J C J^T, with J by differences of whole heads."""
    head = stated(HEAD, np.random.default_rng(3))
    assert head.accuracy is not None
    names, seen = parameter_names(head), sight(head)
    rows = [names.index(name) for name in head.accuracy.parameters]
    root = np.linalg.cholesky(head.accuracy.covariance)
    total = np.zeros((6, 3, 3))
    for column in root.T:
        change = np.zeros(len(names))
        change[rows] = 1e-3 * column
        perturbed = boxplus(head, change)
        off = boxminus(perturbed, head)
        np.testing.assert_allclose([off[name] for name in names], change, atol=1e-12)
        moved = (triangulate_at(perturbed, **seen)[0] - triangulate_at(head, **seen)[0]) / 1e-3
        total += moved[:, :, None] * moved[:, None, :]
    found = locate(head, **seen).calibration_covariance
    np.testing.assert_allclose(found, total, atol=2e-3 * np.abs(total).max())


def test_noise_and_calibration_add_up_to_what_locate_states():
    head = stated(HEAD, np.random.default_rng(3))
    seen = sight(head)
    exact = without_accuracy(head)
    by_noise = locate(exact, **seen, pixel_std_px=0.1, reading_std=1e-3)
    whole = by_noise.covariance + locate(head, **seen).calibration_covariance
    np.testing.assert_allclose(locate(head, **seen).covariance, whole, rtol=1e-12)
    given = locate(head, **seen, pixel_std_px=0.0, reading_std=0.0).covariance
    np.testing.assert_allclose(given, locate(head, **seen).calibration_covariance, rtol=1e-12)
