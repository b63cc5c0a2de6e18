"""Poor recordings are refused or doubted, whichever method is asked for, with what they lack."""

from dataclasses import replace

import numpy as np
import pytest

from simulated_head import random_head
from simulated_recording import POINTS, Noise, Recording, record
from test_other_heads import recorded
from texts import texts
from vergence.calibration.calibrate import calibrate
from vergence.calibration.intrinsics import lenses_of_the_paper
from vergence.calibration.observations import Observations
from vergence.errors import VergenceError
from vergence.geometry.camera import project
from vergence.geometry.se3 import pose, rotation, transform
from vergence.vision.board_pose import board_poses

NOISE = Noise(0.1, np.radians(0.3))


def said_of(given: Observations | Recording) -> str:
    """Return the refusal, or else the warnings."""
    observations = recorded(0, how=given)[1] if isinstance(given, Recording) else given
    lens = lenses_of_the_paper(observations)
    try:
        return " ".join(texts(calibrate(observations, method="paper", lens=lens).findings))
    except VergenceError as refusal:
        return str(refusal)


def with_corners(observations: Observations, name: str, corners: np.ndarray) -> Observations:
    return replace(observations, corners={**observations.corners, name: corners})


def own_placements() -> Observations:
    _, seen = recorded(0, how=Recording())
    return replace(seen, placement=np.arange(len(seen.placement)))


def blind() -> Observations:
    _, seen = recorded(0, how=Recording())
    return with_corners(seen, "right_wide", np.full_like(seen.corners["right_wide"], np.nan))


NOT_OBSERVABLE = "left_wide.T_eye_cam is not observable"
TWICE = "left_wide: Intrinsics need at least 3 views of the board, found 2"
POOR = [
    (Recording(reach_rad=(0.25, 0), noise=NOISE), (NOT_OBSERVABLE, "by 0.00", "0.1 rad")),
    (Recording(reach_rad=(0, 0.25), noise=NOISE), (NOT_OBSERVABLE, "by 0.00", "0.1 rad")),
    (Recording(reach_rad=(0.0087, 0.0087), noise=NOISE), (NOT_OBSERVABLE, "about one axis")),
    (Recording(together=True), (NOT_OBSERVABLE, "by 0.0")),
    (Recording(orientations=0), (NOT_OBSERVABLE, "in 1 view")),
    (own_placements(), ("in 1 view", "share its number in `placement`")),
    (
        Recording(slant_rad=(0.0, 0.0), reach_rad=(0.16, 0.16)),
        ("left_wide.fx and fy are known to 0.8 % only", "slant the board"),
    ),
    (Recording(straight=1, orientations=1), (TWICE, "at different angles")),
    (blind(), ("right_wide: Intrinsics need at least 3 views of the board, found 0",)),
]


@pytest.mark.parametrize(("given", "words"), POOR)
def test_what_a_poor_recording_lacks_is_named(given: Recording | Observations, words):
    said = said_of(given)
    assert [word for word in words if word not in said] == [], said


def test_a_good_recording_is_not_doubted():
    of_the_method = "the paper's method states no accuracy; calibrate with --method bundle."
    assert said_of(Recording(reach_rad=(0.3, 0.3))) == of_the_method


def test_a_camera_that_sees_boards_at_one_angle_from_one_side_is_refused():
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
    said = said_of(with_corners(observed, "left_narrow", corners))
    assert said.startswith("left_narrow: The focal lengths fx and fy are not observable")
    assert "slant the board" in said
