"""The filter of a moving point: exact where it must be, and as sure as it says."""

import numpy as np

from vergence.gaze.kalman import Track, begin, predict, surprise, update

R = np.diag([4e-5, 1e-6, 1e-6])  # long along the line of sight
JERK = 0.2
STEP_S = 1 / 30


def filtered(points: np.ndarray, *, jerk: float = JERK, R: np.ndarray = R) -> list[Track]:
    """Return the tracks after each of the measurements (N, 3)."""
    tracks = [begin(0.0, points[0], R, speed_std_m_s=0.3, acceleration_std_m_s2=0.5)]
    for k, point in enumerate(points[1:], start=1):
        ahead = predict(tracks[-1], k * STEP_S, jerk_density=jerk)
        tracks.append(update(ahead, point, R))
    return tracks


def wandering(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a path (n, 9) that moves as the filter expects, and measurements (n, 3) of it."""
    dt = STEP_S
    growth = np.array(
        [
            [dt**5 / 20, dt**4 / 8, dt**3 / 6],
            [dt**4 / 8, dt**3 / 3, dt**2 / 2],
            [dt**3 / 6, dt**2 / 2, dt],
        ]
    )
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


def test_exact_measurements_of_constant_velocity_give_it_exactly():
    velocity = np.array([0.1, -0.2, 0.05])
    points = np.array([0.6, 0, 0]) + np.arange(60)[:, None] * STEP_S * velocity
    last = filtered(points, jerk=0.0, R=1e-12 * np.eye(3))[-1]
    np.testing.assert_allclose(last.position, points[-1], atol=1e-9)
    np.testing.assert_allclose(last.velocity, velocity, atol=1e-6)


def test_exact_measurements_of_a_parabola_give_it_exactly():
    acceleration = np.array([0.4, -0.2, 0.1])
    times = np.arange(90)[:, None] * STEP_S
    points = np.array([0.6, 0, 0]) + acceleration * times**2 / 2
    last = filtered(points, jerk=0.0, R=1e-12 * np.eye(3))[-1]
    np.testing.assert_allclose(last.velocity, acceleration * times[-1], atol=1e-6)
    np.testing.assert_allclose(last.mean[6:], acceleration, atol=1e-6)


def test_without_acceleration_it_is_the_filter_of_constant_velocity():
    dt, density = 0.5, 0.05
    track = begin(0.0, np.zeros(3), R, speed_std_m_s=0.3)
    ahead = predict(track, dt, acceleration_density=density)
    np.testing.assert_array_equal(ahead.covariance[6:], 0)
    variance = 0.09 * dt**2 + density * dt**3 / 3 + np.diag(R)
    np.testing.assert_allclose(np.diag(ahead.covariance)[:3], variance)
    after = update(ahead, np.array([0.1, 0, 0]), R)
    np.testing.assert_array_equal(after.mean[6:], 0)


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


def test_measurements_are_as_surprising_as_chance_would_have_it():
    _, points = wandering(np.random.default_rng(0), 400)
    tracks = filtered(points)
    found = [
        surprise(predict(track, track.time_s + STEP_S, jerk_density=JERK), point, R)
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
    later = predict(last, last.time_s + 0.5, jerk_density=JERK)
    np.testing.assert_allclose(
        later.position, last.position + 0.5 * last.velocity + last.mean[6:] / 8
    )
    assert (np.diag(later.covariance) > np.diag(last.covariance)).all()
