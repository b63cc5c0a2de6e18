"""The Kalman filter of a moving point: exact on exact data, and consistent with its covariance."""

import numpy as np
import pytest

from vergence.gaze.kalman import (
    InnovationRatio,
    MotionModel,
    Track,
    begin,
    fuse,
    nis,
    predict,
    update,
    update_ratio,
)  # fmt: skip

R = np.diag([4e-5, 1e-6, 1e-6])  # long along the line of sight
LEANING_R = np.array([[4e-5, 1e-5, 0], [1e-5, 6e-6, 0], [0, 0, 1e-6]])
JERK = 0.2
STEP_S = 1 / 30


def filtered(points: np.ndarray, *, jerk: float = JERK, R: np.ndarray = R) -> list[Track]:
    """Return the track after each of the measurements (N, 3)."""
    tracks = [begin(0.0, points[0], R, MotionModel(acceleration_std_m_s2=0.5))]
    for k, point in enumerate(points[1:], start=1):
        ahead = predict(tracks[-1], k * STEP_S, jerk_density=jerk)
        tracks.append(update(ahead, point, R))
    return tracks


def wandering(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a path (n, 9) by the filter's own model, and measurements (n, 3) of it."""
    dt = STEP_S
    G = np.array([[dt**5 / 20, dt**4 / 8, dt**3 / 6], [0, dt**3 / 3, dt**2 / 2], [0, 0, dt]])
    growth = G + np.triu(G, 1).T
    root = np.linalg.cholesky(JERK * np.kron(growth, np.eye(3)))
    state = np.concatenate([[0.6, 0, 0], rng.normal(0, 0.3, 3), rng.normal(0, 0.5, 3)])
    path = [state]
    for _ in range(n - 1):
        p, v, a = state.reshape(3, 3)
        state = np.concatenate([p + dt * v + dt**2 / 2 * a, v + dt * a, a]) + root @ rng.normal(
            size=9
        )
        path.append(state)
    path = np.array(path)
    return path, path[:, :3] + rng.normal(size=(n, 3)) * np.sqrt(np.diag(R))


@pytest.mark.parametrize("acceleration", [(0.0, 0.0, 0.0), (0.4, -0.2, 0.1)])
def test_exact_measurements_of_a_parabola_give_it_exactly(acceleration: tuple[float, ...]):
    times = np.arange(90)[:, None] * STEP_S
    begun, turn = np.array([0.1, -0.2, 0.05]), np.array(acceleration)
    points = np.array([0.6, 0, 0]) + begun * times + turn * times**2 / 2
    last = filtered(points, jerk=0.0, R=1e-12 * np.eye(3))[-1]
    np.testing.assert_allclose(last.position, points[-1], atol=1e-9)
    np.testing.assert_allclose(last.velocity, begun + turn * times[-1], atol=1e-6)
    np.testing.assert_allclose(last.mean[6:], turn, atol=1e-6)


def test_the_estimate_is_better_than_a_single_measurement_and_as_good_as_it_says():
    squared, single, fused = [], [], []
    for seed in range(60):
        path, points = wandering(np.random.default_rng(seed), 60)
        last = filtered(points)[-1]
        error = last.mean - path[-1]
        squared.append(error @ np.linalg.solve(last.covariance, error))
        single.append(np.sum((points[-1] - path[-1, :3]) ** 2))
        fused.append(np.sum(error[:3] ** 2))
    assert np.sum(fused) < 0.8 * np.sum(single)
    assert 7.5 < np.mean(squared) < 10.5  # 9 +- 2.7 standard deviations of the mean


def test_the_normalised_innovation_squared_is_chi_squared():
    _, points = wandering(np.random.default_rng(0), 400)
    tracks = filtered(points)
    found = [
        nis(predict(track, track.time_s + STEP_S, jerk_density=JERK), point, R)
        for track, point in zip(tracks[20:-1], points[21:], strict=True)
    ]
    assert 2.6 < np.mean(found) < 3.4
    far = tracks[-1].position + np.array([0, 0.05, 0])
    assert nis(tracks[-1], far, R) > 100


def test_the_covariance_stays_symmetric_and_positive_for_long():
    _, points = wandering(np.random.default_rng(1), 2000)
    P = filtered(points)[-1].covariance
    np.testing.assert_allclose(P, P.T, atol=1e-18)
    assert np.linalg.eigvalsh(P).min() > 0


def ratio_after(points: np.ndarray, times: np.ndarray) -> InnovationRatio:
    ratio = InnovationRatio()
    for time_s, point in zip(times, points, strict=True):
        ratio = update_ratio(ratio, float(time_s), point, LEANING_R)
    return ratio


def moving(times: np.ndarray) -> np.ndarray:
    """Return a smooth path (N, 3): 0.2 m/s on a circle of 8 cm."""
    return np.stack([0.6 + 0 * times, 0.08 * np.sin(2.5 * times), 0.08 * np.cos(2.5 * times)], -1)


@pytest.mark.parametrize("ratio", [0.01, 0.3, 1.0, 4.0])
def test_the_innovation_ratio_is_estimated_while_the_object_moves(ratio: float):
    rng = np.random.default_rng(1)
    times = np.cumsum(rng.choice([STEP_S, 2 * STEP_S], 400, p=[0.8, 0.2]))  # with missing frames
    noise = rng.multivariate_normal(np.zeros(3), ratio * LEANING_R, len(times), method="cholesky")
    shared = np.array([0.01, -0.004, 0.002])  # a systematic error
    found = ratio_after(moving(times) + shared + noise, times).value
    assert found == pytest.approx(ratio, rel=0.35)


def test_the_innovation_ratio_is_one_at_first_and_a_gap_does_not_raise_it():
    times = np.concatenate([STEP_S * np.arange(30), 3 + STEP_S * np.arange(30)])
    points = moving(times) + np.where(times[:, None] > 2, 0.2, 0.0)
    assert ratio_after(points[:3], times[:3]).value == 1.0
    assert ratio_after(points, times).value < 0.1


def test_a_filter_with_the_innovation_ratio_beats_single_frames_that_share_an_error():
    """As with a wrong calibration: the stated variance is far above that between frames."""
    rng = np.random.default_rng(3)
    times = STEP_S * np.arange(900)
    truth = moving(times)
    shared = np.array([5e-4, 2e-4, -1e-4]) * (1 + 3 * (truth[:, 1:2] + truth[:, 2:3]))
    points = (
        truth
        + shared
        + rng.multivariate_normal(np.zeros(3), 0.002 * LEANING_R, len(times), method="cholesky")
    )
    track, fused = None, []
    for time_s, point in zip(times, points, strict=True):
        track = fuse(track, float(time_s), point, LEANING_R, motion=MotionModel(), gate_chi2=np.inf)
        fused.append(track.position)
    tracked, single = (np.mean((each - truth)[30:] ** 2) for each in (np.array(fused), points))
    assert tracked < single


def test_a_measurement_beyond_the_gate_begins_a_new_track():
    track = filtered(np.tile([0.6, 0.0, 0.0], (30, 1)))[-1]
    far = track.position + np.array([0.0, 0.05, 0.0])
    kept, begun = (
        fuse(track, track.time_s + STEP_S, far, R, motion=MotionModel(), gate_chi2=gate)
        for gate in (np.inf, 60.0)
    )
    assert 0 < kept.position[1] < 0.05
    np.testing.assert_array_equal(begun.position, far)
    np.testing.assert_array_equal(begun.covariance[:3, :3], R)
