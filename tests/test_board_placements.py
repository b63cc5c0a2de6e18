"""Frames at rest and placements of a moved board, found in recordings of points and readings."""

from dataclasses import replace

import numpy as np
import pytest

from board_sessions import random_session
from simulated_head import random_head
from simulated_moments import Found, Imperfections, find_frames, observe_moments
from simulated_recording import BOARD
from vergence.geometry.se3 import boxplus
from vergence.recordings.frame_choice import choose_frames
from vergence.recordings.recording_map import FrameChoice

HOW = {
    "as usual": Imperfections(),
    "backlash and latency": Imperfections(
        backlash_rad=np.radians(1), noise_rad=np.radians(0.15), latency_s=0.15
    ),
    "wrong signs": Imperfections(signs=(-1, 1, 1, -1)),
    "exact": Imperfections(noise_rad=0, gains=0, corner_px=0.01, change_px=0),
    "slow images": Imperfections(rate_hz=10, latency_s=-0.1),
}


def recorded(seed: int, how: Imperfections, *, eyes: str = "both", poses: bool = False) -> Found:
    rng = np.random.default_rng(seed)
    head = random_head(rng, lenses=("wide",))
    if eyes != "both":
        own = {name: each for name, each in head.cameras.items() if each.eye == eyes}
        head = replace(head, cameras=own)
    session = random_session(head, BOARD, rng, moves=4, rests=20)
    return find_frames(head, session, rng, how, poses=poses)


@pytest.mark.parametrize("how", HOW)
def test_rests_and_placements_are_those_of_the_session(how):
    assert not recorded(3, HOW[how]).mistakes


def test_one_camera_and_measured_poses_are_enough():
    assert not recorded(4, Imperfections(), eyes="right").mistakes
    assert not recorded(5, Imperfections(), poses=True).mistakes


def test_motions_are_kept_with_the_placement_of_the_board_around_them():
    found = recorded(6, Imperfections())
    kept = found.moving & (found.number >= 0)
    assert kept.sum() > 100
    for t, number in zip(found.time_s[kept], found.number[kept], strict=True):
        rest = np.flatnonzero(~found.moving & (found.number >= 0))
        k = np.searchsorted(found.time_s[rest], t)
        assert number == found.number[rest[k - 1]] == found.number[rest[k]]


@pytest.mark.parametrize("how", [Imperfections(), Imperfections(noise_rad=2e-4, gains=0.01)])
def test_moves_of_three_centimetres_while_the_eyes_turn_are_found(how):
    rng = np.random.default_rng(9)
    head = random_head(rng, lenses=("wide",))
    session = random_session(head, BOARD, rng, moves=3, rests=18, nudge=0)
    hand, T = [], session.T_lbase_target
    for k in (4, 9, 14):
        T = boxplus(T, rng.normal(0, [0.05] * 3 + [0.02] * 3))
        begin, end, _ = session.gaze[k]
        hand.append((begin, max(end, begin + 0.5), T))
    assert not find_frames(head, replace(session, hand=hand), rng, how).mistakes


def test_what_is_stated_is_taken():
    rng = np.random.default_rng(7)
    head = random_head(rng, lenses=("wide",))
    session = random_session(head, BOARD, rng, moves=3, rests=8)
    moments = observe_moments(head, session, rng, Imperfections())
    stated = FrameChoice(rest=((0.99, 1.01), (3.0, 3.5)), moving=((1.5, 2.01),))
    rows, moving = choose_frames(moments, stated)
    time_s = (moments.time_ns[rows] - moments.time_ns[0]) * 1e-9
    np.testing.assert_allclose(time_s[0], 1.0, atol=1e-6)
    assert 3.0 <= time_s[-1] <= 3.5
    assert moving.sum() == len(rows) - 2 == 16


def test_moments_without_readings_are_left_out():
    rng = np.random.default_rng(8)
    head = random_head(rng, lenses=("wide",))
    session = random_session(head, BOARD, rng, moves=3, rests=8)
    moments = observe_moments(head, session, rng, Imperfections())
    moments.eye_angles[100:130, 2] = np.nan
    rows, _ = choose_frames(moments, FrameChoice())
    assert not np.isin(rows, np.arange(100, 130)).any()
