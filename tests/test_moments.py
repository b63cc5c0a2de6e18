"""Images and joint readings are brought together by their stamps, or one sentence says why not."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from vergence.data.description import DatasetJoint, Description
from vergence.errors import VergenceError
from vergence.findings import Finding
from vergence.geometry.kinematics import EYES, Side
from vergence.geometry.se3 import inverse, pose
from vergence.recordings.frame_choice import join_at_rest
from vergence.recordings.moments import Moments, check_moments, find_moments
from vergence.recordings.readings import interpolate
from vergence.recordings.recording_map import CameraSource, PoseSource, RecordingMap, describe
from vergence.recordings.scan import Scan, Track

START = 1_700_000_000_123_456_789
JOINTS = "left_pan", "left_tilt", "right_pan", "right_tilt"
MS = 10**6


def mapped(**fields: Any) -> RecordingMap:
    cameras = {
        "left_wide": CameraSource(eye="left", images="/l"),
        "right_wide": CameraSource(eye="right", images="/r"),
    }
    joints = {name: DatasetJoint(column=name, unit="rad") for name in JOINTS}
    stated: dict[str, Any] = {"joints": joints} | fields
    return RecordingMap(cameras=cameras, **stated)


def scanned(
    images: Mapping[str, np.ndarray],
    at_ns: np.ndarray,
    angles: np.ndarray,
    *,
    poses: Mapping[tuple[str, str], Track] | None = None,
) -> Scan:
    """Return images at times and readings, all joints the same, at others [ns] after START."""
    tracks = {name: track_of(START + at, np.zeros(len(at))) for name, at in images.items()}
    track = track_of(START + at_ns, angles)
    joints = {("/joints", name): track for name in JOINTS}
    return Scan(tracks, dict.fromkeys(images, (32, 24)), joints, {}, poses or {})


def track_of(stamp_ns: np.ndarray, values: np.ndarray) -> Track:
    return Track(stamp_ns, stamp_ns, values)


def moments_of(found: Scan, described: RecordingMap) -> tuple[Moments, Description]:
    description = describe(described, {"/l": (32, 24), "/r": (32, 24)}, {})
    return find_moments(found, described, description), description


def checked(found: Scan, **fields: Any) -> tuple[Finding, ...]:
    described = mapped(**fields)
    moments, description = moments_of(found, described)
    return check_moments(moments, found, described, description)


@given(
    times=st.lists(st.integers(0, 10**10), min_size=2, max_size=30, unique=True),
    at=st.lists(st.integers(-(10**9), 11 * 10**9), min_size=1, max_size=30),
    rate=st.floats(-2, 2),
    seed=st.integers(0, 99),
)
def test_linear_motion_is_interpolated_exactly_and_never_extrapolated(times, at, rate, seed):
    order = np.random.default_rng(seed).permutation(len(times))
    stamps, at_ns = np.array(times)[order], np.array(at)
    track = track_of(START + stamps, 0.3 + rate * stamps * 1e-9)
    found = interpolate(track, START + at_ns, max_gap_s=100.0)
    inside = (at_ns >= min(times)) & (at_ns <= max(times))
    np.testing.assert_array_equal(np.isfinite(found), inside)
    np.testing.assert_allclose(found[inside], 0.3 + rate * at_ns[inside] * 1e-9, atol=1e-9)


def test_gaps_are_not_bridged_but_their_ends_are_known():
    track = track_of(np.array([0, 100, 400, 450]) * MS, np.array([0.0, 1, 4, 4.5]))
    found = interpolate(track, np.array([50, 100, 200, 400, 425]) * MS, max_gap_s=0.1)
    np.testing.assert_allclose(found, [0.5, 1, np.nan, 4, 4.25])
    assert np.isnan(interpolate(track_of(np.array([5]), np.ones(1)), np.array([5, 6]),
                                max_gap_s=1)).any()  # fmt: skip


@pytest.mark.parametrize("noise_rad", [0.0, 0.005])  # the larger of hobby servos
def test_cameras_that_are_not_synchronised_share_moments_at_rest_only(noise_rad: float):
    at = np.arange(0, 4000) * MS
    angles = np.clip(at * 1e-9 - 1.0, 0, 1.0)  # at rest, one second of motion, at rest
    images = {"/l": np.arange(0, 3900, 100) * MS, "/r": np.arange(40, 3900, 100) * MS}
    noise = np.random.default_rng(1).normal(0, noise_rad, len(at))
    moments = join_at_rest(moments_of(scanned(images, at, angles + noise), mapped())[0])
    both = (moments.images["left_wide"] >= 0) & (moments.images["right_wide"] >= 0)
    t = (moments.time_ns - START) * 1e-9
    assert both[t < 0.7].all()  # up to a window before the motion
    assert both[t > 2.2].all()
    assert not both[(t > 1) & (t < 2)].any()
    assert (np.diff(moments.time_ns) > 0).all()
    for name, rows in moments.images.items():  # each image is used once
        assert sorted(rows[rows >= 0]) == list(range(len(images["/" + name[0]])))
    away = np.abs(moments.eye_angles[:, 0] - np.clip(t - 1, 0, 1)).max()
    assert away < 1e-9 + 4 * noise_rad


STEADY = np.arange(0, 3000, 100) * MS


def test_sound_stamps_have_no_findings():
    assert checked(scanned({"/l": STEADY, "/r": STEADY}, STEADY, 0.0 * STEADY)) == ()


def test_repeated_and_backward_stamps_are_named_and_put_in_order():
    odd = STEADY.copy()
    odd[[5, 8, 9]] = odd[4], odd[9], odd[8]
    found = scanned({"/l": odd, "/r": STEADY}, odd, 0.0 * STEADY)
    findings = checked(found, max_gap_s=0.3)
    assert {each.code for each in findings} == {"stamps-out-of-order"}
    assert {each.where for each in findings} == {"/l", *JOINTS}
    assert "up to 0.1 s earlier" in "".join(each.sentence for each in findings)
    moments, _ = moments_of(found, mapped())
    assert (np.diff(moments.time_ns) > 0).all()
    assert len(moments) == len(STEADY)


def test_clocks_that_differ_while_their_stamps_overlap_are_named():
    found = scanned({"/l": STEADY, "/r": STEADY}, STEADY, 0.0 * STEADY)
    late = {
        name: replace(track, received_ns=track.stamp_ns + 2500 * MS)
        for name, track in found.joints.items()
    }
    findings = checked(replace(found, joints=late))
    assert {each.code for each in findings} == {"two-clocks"}
    assert "2.50 s; set stamps = " in findings[0].sentence


@pytest.mark.parametrize(
    ("images", "joints", "sentence"),
    [
        (0 * STEADY, STEADY, "29 of 30 stamps of /l repeat the one before"),
        (STEADY, STEADY // 10**9, "stamps of left_pan repeat the one before"),
        (STEADY, STEADY + 10**12, "30 of 30 images have no joint readings around them"),
    ],
)
def test_stamps_that_cannot_be_right_end_in_one_sentence_with_a_way_out(images, joints, sentence):
    found = scanned({"/l": images, "/r": images}, joints, 0.0 * joints)
    with pytest.raises(VergenceError, match=sentence) as refused:
        checked(found)
    assert str(refused.value).endswith(
        'set stamps = "received" in the map if the recorder has one clock.'
    )


@pytest.mark.parametrize(
    ("columns", "sentence"),
    [
        (("left_pan", "nosuch"), "'nosuch'; the recording has none of"),
        (("left_pan", "jaw"), "'jaw'; the recording has /a:jaw, /b:jaw of"),
    ],
)
def test_joints_are_named_clearly(columns, sentence):
    found = scanned({"/l": STEADY, "/r": STEADY}, STEADY, 0.0 * STEADY)
    twice = {(channel, "jaw"): found.joints["/joints", "left_pan"] for channel in ("/a", "/b")}
    found = replace(found, joints={**found.joints, **twice})
    names = dict(zip(JOINTS, (*columns, "right_pan", "right_tilt"), strict=True))
    joints = {name: DatasetJoint(column=column, unit="rad") for name, column in names.items()}
    with pytest.raises(VergenceError, match=sentence):
        moments_of(found, mapped(joints=joints))


def test_poses_of_eyes_come_from_a_tree_of_frames():
    """The base is a brother of the eye's parent; one edge is fixed and sent once."""
    T_head_base, T_head_mount = pose(t=[0.1, 0, 0]), pose(t=[0, 0.2, 0])
    turn = 0.5 * STEADY * 1e-9
    T_mount_eye = pose(Rotation.from_rotvec(np.outer(turn, [0, 0, 1])).as_matrix())
    tracks = {
        ("head", "base"): track_of(np.array([7]), T_head_base[None]),
        ("head", "mount"): track_of(START + STEADY, np.tile(T_head_mount, (len(STEADY), 1, 1))),
        ("mount", "eye"): track_of(START + STEADY, T_mount_eye),
    }
    sources: dict[Side, PoseSource] = {side: PoseSource(base="base", eye="eye") for side in EYES}
    images = {name: STEADY[:-1] + 30 * MS for name in ("/l", "/r")}
    found = scanned(images, STEADY, 0.0 * STEADY, poses=tracks)
    moments, _ = moments_of(found, mapped(joints={}, poses=sources))
    assert moments.T_base_eye is not None
    angle = 0.5 * (moments.time_ns - START) * 1e-9
    T_mount_eye = pose(Rotation.from_rotvec(np.outer(angle, [0, 0, 1])).as_matrix())
    expected = inverse(T_head_base) @ T_head_mount @ T_mount_eye
    np.testing.assert_allclose(moments.T_base_eye[:, 1], expected, atol=1e-9)

    sources = {side: PoseSource(base="base", eye="ear") for side in EYES}
    with pytest.raises(VergenceError, match="does not connect the frames base and ear"):
        moments_of(found, mapped(joints={}, poses=sources))


def test_degrees_that_are_taken_for_radians_are_refused():
    found = scanned({"/l": STEADY, "/r": STEADY}, STEADY, np.linspace(-17, 17, len(STEADY)))
    with pytest.raises(
        VergenceError, match="more than a turn; if they are in degrees, set its unit"
    ):
        checked(found)
