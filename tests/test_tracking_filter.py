"""The filter of a moving point: exact where it must be, and as sure as it says."""

import numpy as np

from vergence.tracking_filter import Track, begin, predict, surprise, update

R = np.diag([4e-5, 1e-6, 1e-6])  # long along the line of sight
DENSITY = 0.05
STEP_S = 1 / 30


def filtered(points: np.ndarray, *, density: float = DENSITY, R: np.ndarray = R) -> list[Track]:
    """Return the tracks after each of the measurements (N, 3)."""
    tracks = [begin(0.0, points[0], R, speed_std_m_s=0.3)]
    for k, point in enumerate(points[1:], start=1):
        ahead = predict(tracks[-1], k * STEP_S, acceleration_density=density)
        tracks.append(update(ahead, point, R))
    return tracks


def wandering(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a path (n, 6) that moves as the filter expects, and measurements (n, 3) of it."""
    growth = np.array([[STEP_S**3 / 3, STEP_S**2 / 2], [STEP_S**2 / 2, STEP_S]])
    root = np.linalg.cholesky(DENSITY * np.kron(growth, np.eye(3)))
    state = np.concatenate([[0.6, 0, 0], rng.normal(0, 0.3, 3)])
    path = [state]
    for _ in range(n - 1):
        state = (
            state + np.concatenate([STEP_S * state[3:], np.zeros(3)]) + root @ rng.normal(size=6)
        )
        path.append(state)
    path = np.array(path)
    return path, path[:, :3] + rng.normal(size=(n, 3)) * np.sqrt(np.diag(R))


def test_exact_measurements_of_constant_velocity_give_it_exactly():
    velocity = np.array([0.1, -0.2, 0.05])
    points = np.array([0.6, 0, 0]) + np.arange(60)[:, None] * STEP_S * velocity
    last = filtered(points, density=0.0, R=1e-12 * np.eye(3))[-1]
    np.testing.assert_allclose(last.position, points[-1], atol=1e-9)
    np.testing.assert_allclose(last.velocity, velocity, atol=1e-6)


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
    assert 4.8 < np.mean(squared) < 7.2  # 6 +- 2.7 standard deviations of the mean


def test_measurements_are_as_surprising_as_chance_would_have_it():
    _, points = wandering(np.random.default_rng(0), 400)
    tracks = filtered(points)
    found = [
        surprise(predict(track, track.time_s + STEP_S, acceleration_density=DENSITY), point, R)
        for track, point in zip(tracks[20:-1], points[21:], strict=True)
    ]
    assert 2.6 < np.mean(found) < 3.4
    far = tracks[-1].position + np.array([0, 0.05, 0])
    assert surprise(tracks[-1], far, R) > 100


def test_the_covariance_stays_symmetric_and_positive_for_long():
    _, points = wandering(np.random.default_rng(1), 2000)
    P = filtered(points)[-1].covariance
    np.testing.assert_allclose(P, P.T, atol=1e-18)
    assert np.linalg.eigvalsh(P).min() > 0


def test_doubt_grows_while_nothing_is_seen():
    _, points = wandering(np.random.default_rng(2), 60)
    last = filtered(points)[-1]
    later = predict(last, last.time_s + 0.5, acceleration_density=DENSITY)
    np.testing.assert_allclose(later.position, last.position + 0.5 * last.velocity)
    assert (np.diag(later.covariance) > np.diag(last.covariance)).all()
