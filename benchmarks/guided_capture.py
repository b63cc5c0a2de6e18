"""Guided capture on simulated heads, by a person who follows the guide roughly.

    python benchmarks/guided_capture.py --heads 20

States by head: views until the wanted accuracy is reached; those that a plan on paper needs after
the first calibration; those needed if random views take the place of the guide; and the share of
points whose true error is within the stated region. Bars: all heads reach it, 1.3 times the views
of the plan, half of the random ones, 95 % of points.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from typing import Any

import numpy as np
import tyro
from scipy.stats import chi2

from simulated_head import random_head
from simulated_moments import description
from simulated_recording import BOARD, Noise, inside_image
from vergence.accuracy.plan import choose
from vergence.accuracy.plan_information import largest_std, total_information
from vergence.accuracy.plan_views import admissible_views
from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.demos.simulated_person import Person
from vergence.gaze.commands import HeadCommand, hold, setpoint, usual_limits
from vergence.geometry.board import Board, corner_points
from vergence.geometry.head import HeadCalibration, pair_names
from vergence.geometry.parameters import without_offsets
from vergence.geometry.projection import project_point
from vergence.geometry.se3 import transform
from vergence.live.capture import CaptureSettings, CaptureState, begin_capture
from vergence.live.estimate import Estimate, estimate
from vergence.live.kept import Kept
from vergence.live.session import run_capture
from vergence.stereo.triangulation import triangulate_at

DISTANCE_M = 0.5
"""Distance of the points whose accuracy counts [m]."""
MOST_ON_PAPER = 60
"""Longest plan that is tried, in views."""
FRAME_S = 0.2
"""Period of the simulated frames [s]: the guide needs no more than three of a board at rest."""


class AtOnce(Executor):
    """Runs a task while it is submitted, so that results do not depend on the machine."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Run a task."""
        future: Future[Any] = Future()
        future.set_result(fn(*args, **kwargs))
        return future


class HeadWithoutImages:
    """A head before a person: corners are projected instead of rendered."""

    def __init__(self, truth: HeadCalibration, noise: Noise, seed: int):
        """Begin at rest; the seed is that of all noise."""
        self.truth, self.noise, self.rng = truth, noise, np.random.default_rng([seed, 8])
        self.limits, self.person = usual_limits(truth), Person(seed)
        self.time_s, self.joints = 0.0, np.zeros(len(self.limits.joints))
        self.going = hold(self.joints, self.limits, 0.0)
        self.T_lbase_board = self.person.board(0.0)

    def now_s(self) -> float:
        """Read the clock."""
        return self.time_s

    def command(self, command: HeadCommand) -> None:
        """Turn the eyes."""
        self.going = command

    def read(self, cameras: object) -> Frame:
        """Take a frame without images; `detect` finds the board in it."""
        self.time_s = round(self.time_s + FRAME_S, 6)
        self.joints = setpoint(self.going, self.time_s)
        self.T_lbase_board = self.person.board(self.time_s)
        readings = self.joints + self.rng.normal(0, self.noise.joint_rad, self.joints.shape)
        return Frame(self.time_s, self.time_s, readings, np.empty(0), {})

    def detect(self, frame: Frame, board: Board, width_px: float) -> Mapping[str, Array]:
        """Find the board where a camera sees it whole."""
        found, points = {}, transform(self.T_lbase_board, corner_points(board))
        for name in self.truth.cameras:
            uv = project_point(self.truth, name, self.joints, points)
            if inside_image(uv, self.truth.camera(name).intrinsics).all():
                found[name] = uv + self.rng.normal(0, self.noise.pixel_px, uv.shape)
        return found

    def follow(self, state: CaptureState, frame: Frame) -> None:
        """Let the person follow the guide."""
        self.person.follow(state, self.time_s)


@dataclass(frozen=True)
class Captured:
    """Views that a head needed until its accuracy was reached."""

    views: int
    finished: str
    accuracy_mm: float = np.nan
    on_paper: int = 0
    """By a plan that is made after the first calibration and carried out exactly."""
    at_random: int = 0
    """If random views take the place of the guide after the first calibration; at most 3 times."""
    inside: float = np.nan
    """Share of points whose error is within the stated region of 95 %."""


def simulated(seed: int, goal_m: float) -> tuple[HeadWithoutImages, CaptureSettings]:
    """Draw a head with a wide camera in each eye, and its noise."""
    rng = np.random.default_rng([seed, 65])
    truth = random_head(rng, lenses=("wide",))
    noise = Noise(rng.uniform(0.05, 0.2), np.radians(rng.uniform(0.03, 0.2)))
    head = HeadWithoutImages(truth, noise, seed)
    settings = CaptureSettings(description(truth), head.limits, goal_m, DISTANCE_M, seed=seed)
    return head, settings


def capture(seed: int, goal_m: float) -> Captured:
    """Let a person calibrate a head."""
    head, settings = simulated(seed, goal_m)
    begun: list[CaptureState] = []

    def look(state: CaptureState, frame: Frame) -> None:
        if state.outlook is not None and not begun:
            begun.append(state)
        head.follow(state, frame)

    state = run_capture(
        head,
        settings,
        begin_capture(settings),
        lambda rows: None,
        until_s=3600.0,
        detect=head.detect,
        look=look,
        pool=AtOnce(),
    )
    last = state.estimate
    if not begun or last is None or not len(last.accuracy_m):
        return Captured(state.views, state.finished)
    return Captured(
        state.views,
        state.finished,
        accuracy_mm=1e3 * float(last.accuracy_m[0]),
        on_paper=on_paper(begun[0], goal_m),
        at_random=at_random(begun[0], settings, head, 3 * state.views),
        inside=share_inside(last, head.truth),
    )


def share_inside(found: Estimate, truth: HeadCalibration) -> float:
    """Count the points whose error by the calibration is within the stated region."""
    tried, plain = found.candidates, without_offsets(truth)
    assert tried is not None
    places, by, pair = tried.workspace, tried.by_parameters, pair_names(tried.head)
    left, right = (project_point(plain, name, places.joints, places.points) for name in pair)
    points, _ = triangulate_at(
        tried.head, left=left, right=right, joints=places.joints, cameras=pair
    )
    covariance = by @ np.linalg.inv(tried.known) @ np.swapaxes(by, 1, 2)
    error = points - places.points
    squared = np.einsum("wi,wij,wj->w", error, np.linalg.inv(covariance), error)
    return float((squared < chi2(3).ppf(0.95)).mean())


def on_paper(state: CaptureState, goal_m: float) -> int:
    """Count the views that a plan made after the first calibration needs."""
    assert state.outlook is not None
    tried = state.outlook.candidates
    place, by = tried.views.placement, tried.by_parameters
    best = choose(tried.known, tried.information, place, by, MOST_ON_PAPER)
    for n in range(1, MOST_ON_PAPER):
        after = tried.known + total_information(tried.information[best[:n]], place[best[:n]])
        if largest_std(by, np.linalg.inv(after).astype(float)).max() <= goal_m:
            return state.views + n
    return state.views + MOST_ON_PAPER


def at_random(
    state: CaptureState, settings: CaptureSettings, head: HeadWithoutImages, most: int
) -> int:
    """Count the views if all after the first calibration are random."""
    rng, kept = np.random.default_rng([settings.seed, 3]), state.kept
    count = most - state.views
    drawn = admissible_views(head.truth, BOARD, settings.limits_rad, rng, places=count, gazes=1)
    for k in range(count):
        head.T_lbase_board, head.joints = drawn.T_lbase_target[k], drawn.joints[k]
        readings = head.joints + rng.normal(0, head.noise.joint_rad, head.joints.shape)
        frame = Frame(1e4 + k, 1e4 + k, readings, np.empty(0), {})
        corners = head.detect(frame, BOARD, np.inf)
        kept = (*kept, Kept(frame, corners, 1000 + k))
        if k % 4 == 3:
            found = estimate(
                settings.description,
                kept,
                limits_rad=settings.limits_rad,
                distance_m=settings.distance_m,
            )
            if len(found.accuracy_m) and found.accuracy_m[0] <= settings.goal_m:
                return state.views + k + 1
    return most


def main(*, heads: int = 20, first: int = 0, goal_mm: float = 3.0) -> None:
    """Capture with heads drawn by seeds.

    Args:
        heads: Number of heads.
        first: Seed of the first.
        goal_mm: Wanted accuracy.
    """
    for seed in range(first, first + heads):
        print(seed, capture(seed, goal_mm / 1e3), flush=True)


if __name__ == "__main__":
    tyro.cli(main)
