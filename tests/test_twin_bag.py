"""The twin's bags: the dataset comes back from each storage, and joints at their own rate."""

from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

import vergence as vg
from vergence.data.dataset import Dataset
from vergence.data.reader import load_dataset
from vergence.errors import VergenceError
from vergence.geometry.head import HeadCalibration
from vergence.geometry.parameters import parameter_values
from vergence.recordings.bag import Storage, write_bag
from vergence.recordings.formats import open_recording
from vergence.recordings.import_recording import import_recording
from vergence.recordings.readings import interpolate
from vergence.recordings.recording_map import CameraSource, FrameChoice, RecordingMap
from vergence.recordings.scan import scan
from vergence.twin.bag import BEGIN_NS, IMAGES, JOINTS, LENSES, BagSettings
from vergence.twin.evaluation import load_truth
from vergence.twin.profile import ErrorProfile, Image, Joints, Mounting
from vergence.twin.record import record

PROFILE = ErrorProfile(
    name="test",
    mounting=Mounting(rotation_deg=0.7, translation_mm=2.0),
    image=Image(noise_grey=1.5, blur_px=0.4),
    joints=Joints(noise_deg=0.02, delay_ms=-45),
)
NEAR_S = 0.01
"""Half of the spans [s] that name single frames; they are 0.1 s apart."""


@pytest.fixture(scope="module")
def recorded(tmp_path_factory, opengl: None, coarsely) -> Dataset:
    """A dataset with a bag of the same readings."""
    out = tmp_path_factory.mktemp("twin") / "set"
    with pytest.MonkeyPatch.context() as patch:
        coarsely(patch)
        settings = BagSettings("mcap", lenses=True)
        record(out, profile=PROFILE, seed=1, frames=16, moving=10, bag=settings)
    return load_dataset(out)


def map_back(dataset: Dataset) -> RecordingMap:
    """Make the map by which a bag of the twin becomes its dataset again."""
    stated = dataset.description
    time_s = dataset.time_s - dataset.time_s[0]
    last = np.append(np.flatnonzero(np.diff(dataset.placement)), len(time_s) - 1)
    first = np.append(0, last[:-1] + 1)

    def spans(begin: np.ndarray, end: np.ndarray) -> tuple[tuple[float, float], ...]:
        return tuple(zip((begin - NEAR_S).tolist(), (end + NEAR_S).tolist(), strict=True))

    moving, rest = time_s[dataset.moving], time_s[~dataset.moving]
    return RecordingMap(
        cameras={
            name: CameraSource(camera.eye, IMAGES.format(name))
            for name, camera in stated.cameras.items()
        },
        board=stated.board,
        joints=dict(stated.joints),
        frames=FrameChoice(
            rest=spans(rest, rest),
            moving=spans(moving[:1], moving[-1:]),
            placements=spans(time_s[first], time_s[last]),
        ),
    )


@pytest.mark.slow
@pytest.mark.parametrize("storage", get_args(Storage))
@pytest.mark.usefixtures("two_folds")
def test_each_storage_gives_the_dataset_back(recorded: Dataset, tmp_path: Path, storage: Storage):
    path = recorded.folder / "recording"
    if storage != "mcap":
        copy = tmp_path / ("a.bag" if storage == "ros1" else "a")
        with open_recording(path) as recording:
            write_bag(copy, recording.read(list(recording.channels), None, None), storage=storage)
        path = copy
    back = import_recording(path, map_back(recorded), tmp_path / "back")
    assert_same_dataset(back, recorded)
    if storage == "mcap":
        # As floats, times since 1970 are rounded to 0.2 us, and a motion's velocity by 1e-5.
        back = replace(back, time_s=recorded.time_s, joint_time_s=recorded.joint_time_s)
        assert_same_head(*(vg.calibrate(data).head for data in (back, recorded)))


def assert_same_head(one: HeadCalibration, two: HeadCalibration) -> None:
    np.testing.assert_allclose(one.T_rbase_lbase, two.T_rbase_lbase, rtol=0, atol=1e-9)
    for name, mounted in one.cameras.items():
        other = two.cameras[name].T_eye_cam
        np.testing.assert_allclose(mounted.T_eye_cam, other, rtol=0, atol=1e-9)
    values, others = parameter_values(one), parameter_values(two)
    assert values.keys() == others.keys()
    for name, value in values.items():
        if value is not None:  # a part of a pose
            assert value == pytest.approx(others[name], rel=0, abs=1e-9), name


def assert_same_dataset(back: Dataset, recorded: Dataset) -> None:
    np.testing.assert_allclose(back.time_s - BEGIN_NS * 1e-9, recorded.time_s, rtol=0, atol=1e-6)
    np.testing.assert_allclose(back.eye_angles, recorded.eye_angles, rtol=0, atol=1e-12)
    np.testing.assert_allclose(back.neck_angles, recorded.neck_angles, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(back.moving, recorded.moving)
    same = back.placement[:, None] == back.placement
    np.testing.assert_array_equal(same, recorded.placement[:, None] == recorded.placement)
    for name in recorded.files:
        for row in range(len(recorded)):
            np.testing.assert_array_equal(back.image(name, row), recorded.image(name, row))


def test_lenses_are_those_of_the_truth(recorded: Dataset):
    truth = load_truth(recorded.folder / "truth.json")
    with open_recording(recorded.folder / "recording") as recording:
        lenses = scan(recording).lenses
    for name in recorded.files:
        found, true = lenses[LENSES.format(name)], truth.head.camera(name).intrinsics
        assert (found.size, found.model) == (true.size, true.model)
        np.testing.assert_array_equal(found.matrix, true.matrix)
        np.testing.assert_array_equal(found.distortion, true.distortion)


@pytest.mark.usefixtures("coarse_images")
@pytest.mark.render
def test_joints_have_their_own_rate_and_lose_messages(tmp_path: Path):
    settings = BagSettings("ros2", joint_rate_hz=97, missing=0.1)
    exact = ErrorProfile(joints=Joints(delay_ms=30))
    record(tmp_path / "set", profile=exact, frames=12, moving=10, bag=settings)
    dataset = load_dataset(tmp_path / "set")
    with open_recording(tmp_path / "set" / "recording") as recording:
        tracks = scan(recording, [JOINTS]).joints
    track = tracks[JOINTS, "left_pan"]
    steps = np.diff(track.stamp_ns)
    period = 1e9 / 97
    np.testing.assert_allclose(steps, np.round(steps / period) * period, atol=2)
    lost = 1 - len(steps) / (np.ptp(track.stamp_ns) / period)
    assert 0.05 < lost < 0.15
    at_ns = BEGIN_NS + np.round(dataset.time_s[dataset.moving] * 1e9).astype(int)
    read = interpolate(track, at_ns, max_gap_s=0.1)
    known = np.isfinite(read)
    assert known.sum() >= 9
    # Between readings 10 to 30 ms apart a path that bends is not a line.
    np.testing.assert_allclose(read[known], dataset.eye_angles[dataset.moving, 0][known], atol=1e-4)


@pytest.mark.parametrize(
    ("rate", "missing"), [(-1, 0.0), (1e5, 0.0), (97, 1.0), (97, float("nan"))]
)
def test_impossible_streams_are_refused(rate: float, missing: float):
    with pytest.raises(VergenceError, match="at 0 to 1000 Hz, and 0 to below 1"):
        BagSettings("mcap", rate, missing)
