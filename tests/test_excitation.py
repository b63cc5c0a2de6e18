"""Poor recordings are refused or doubted, whichever method is asked for, with what they lack."""

from dataclasses import replace

import numpy as np
import pytest

from simulated_head import random_head
from simulated_recording import POINTS, Noise, Recording, record
from test_other_heads import recorded
from texts import texts
from vergence.calibration.calibrate import Method, calibrate
from vergence.calibration.intrinsics import lenses_of_the_paper
from vergence.calibration.observations import Observations
from vergence.errors import VergenceError
from vergence.geometry.camera import project
from vergence.geometry.se3 import pose, rotation, transform
from vergence.vision.board_pose import board_poses

# Whole calibrations, by both methods.
pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("two_folds")]


@pytest.fixture(params=["bundle", "paper"])
def method(request: pytest.FixtureRequest) -> Method:
    return request.param


def sentences(given: Observations | Recording, method: Method) -> str:
    """Return the refusal, or else the warnings: a recording that is not in order must get some."""
    observations = recorded(0, how=given)[1] if isinstance(given, Recording) else given
    try:
        lens = lenses_of_the_paper(observations)
        return " ".join(texts(calibrate(observations, method=method, lens=lens).findings))
    except VergenceError as refusal:
        return str(refusal)


def with_corners(observations: Observations, name: str, corners: np.ndarray) -> Observations:
    return replace(observations, corners={**observations.corners, name: corners})


def test_a_good_recording_is_not_doubted(method: Method):
    assert sentences(Recording(reach_rad=(0.3, 0.3)), method) == ""


@pytest.mark.parametrize(
    ("reach", "hidden", "cause", "advice"),
    [
        ((0.25, 0), "rotation about z and translation along z", "tilt of the {} eye moves by 0.00",
         "move tilt by at least 0.1 rad"),
        ((0, 0.25), "rotation about y and translation along y", "pan of the {} eye moves by 0.00",
         "move pan by at least 0.1 rad"),
        ((0.0087, 0.0087), "rotation and translation", "the {} eye turns by 0.00",
         "move pan and tilt by at least 0.1 rad"),
    ],
    ids=["pan only", "tilt only", "too little"],
)  # fmt: skip
def test_motion_that_leaves_a_direction_open_is_refused(reach, hidden, cause, advice, method):
    noisy = Recording(reach_rad=reach, noise=Noise(0.1, np.radians(0.3)))
    said = sentences(noisy, method)
    for eye in ("left", "right"):
        assert f"{eye}_wide.T_eye_cam {hidden}: not observable; {cause.format(eye)}" in said
    assert advice in said


def test_readings_of_an_eye_without_a_camera_change_no_sentence(method: Method):
    """They may be missing."""
    reach = Recording(reach_rad=(0, 0.25), noise=Noise(0.1, np.radians(0.3)))
    seen = recorded(0, how=reach)[1]
    one = {name: each for name, each in seen.corners.items() if name.startswith("left")}
    sizes = {name: seen.sizes[name] for name in one}
    angles = seen.eye_angles.copy()
    angles[:, 2:] = np.nan
    said = sentences(replace(seen, corners=one, sizes=sizes, eye_angles=angles), method)
    assert "pan of the left eye moves by 0.00" in said


def test_pan_and_tilt_that_move_together_are_refused(method: Method):
    said = sentences(Recording(together=True), method)
    assert "rotation and translation along one axis: not observable; pan and tilt of" in said
    assert "move one without the other" in said


@pytest.mark.parametrize("slant", [(0.0, 0.0), (0.5, 0.2)])
def test_boards_at_one_angle_are_doubted(slant: tuple[float, float], method: Method):
    said = sentences(Recording(slant_rad=slant), method)
    assert "left_wide.fx and fy, right_wide.fx and fy: hardly observable, all boards stand" in said
    assert "slant the board by 20 to 40 degrees" in said


def test_a_camera_that_sees_boards_at_one_angle_from_one_side_is_refused(method: Method):
    rng = np.random.default_rng(3)
    truth = random_head(rng, perfect_axes=True)
    observed = record(truth, rng)
    # Boards that face the narrow camera squarely, at several distances.
    lens = truth.cameras["left_narrow"].intrinsics
    turn = np.arange(8)[:, None] * [0, 0, 0.05]
    T = pose(rotation(turn), [[-0.1, -0.07, distance] for distance in np.linspace(0.7, 1.1, 8)])
    corners = np.full_like(observed.corners["left_narrow"], np.nan)
    corners[:8] = project(lens, transform(T[:, None], POINTS)) + rng.normal(0, 0.1, (8, 54, 2))
    assert np.isfinite(board_poses(lens, corners[:8], POINTS)).all()
    said = sentences(with_corners(observed, "left_narrow", corners), method)
    assert said.startswith("left_narrow: The focal lengths fx and fy are not observable")
    assert "slant the board" in said


@pytest.mark.parametrize(("straight", "orientations"), [(1, 1), (2, 0)])
def test_two_views_are_refused(straight: int, orientations: int, method: Method):
    said = sentences(Recording(straight=straight, orientations=orientations), method)
    assert said.startswith("left_wide shows the board in 2 images at rest: fx, fy and T_eye")
    assert "record at least 3, better 10, at different distances and slants" in said


def test_eyes_that_never_move_are_refused(method: Method):
    said = sentences(Recording(orientations=0), method)
    assert "left_wide.T_eye_cam rotation and translation: not observable" in said
    assert "sees a board at rest in one view only" in said


def test_views_that_all_have_a_placement_of_their_own_are_told_what_to_share(method: Method):
    _, observed = recorded(0, how=Recording())
    each = replace(observed, placement=np.arange(len(observed.placement)))
    said = sentences(each, method)
    assert "give the views of a board that stands still one number in `placement`" in said


def test_a_camera_that_never_finds_the_board_is_refused(method: Method):
    _, observed = recorded(0, how=Recording())
    nothing = np.full_like(observed.corners["right_wide"], np.nan)
    said = sentences(with_corners(observed, "right_wide", nothing), method)
    assert said.startswith("right_wide shows the board in 0 images at rest: fx, fy and T_eye_cam")
