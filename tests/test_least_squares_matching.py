"""Windows of drawn textures, displaced as a surface displaces them, are found where they are."""

import cv2
import numpy as np
import pytest

from vergence.arrays import Array
from vergence.vision.matching.least_squares_matching import Matched, match_windows

SIZE = 240, 320
AT = np.stack(np.meshgrid(np.arange(30.0, 300, 20), np.arange(30.0, 220, 20)), -1).reshape(-1, 2)
ALONG = np.array([0.8, 0.6])
SHIFT = np.array([2.4, -1.3])


def texture(u: Array, v: Array) -> Array:
    """Return grey levels of a smooth random texture at pixels."""
    rng = np.random.default_rng(3)
    grey = np.full(np.shape(u), 128.0)
    for _ in range(60):
        by_u, by_v, phase = *rng.normal(0, 0.25, 2), rng.uniform(0, 2 * np.pi)
        grey += 5 * np.sin(by_u * u + by_v * v + phase)
    return grey


def displaced(places: Array, slopes: Array, larger: float = 0.0) -> Array:
    """Return where places (..., 2) of the left view are in the right one."""
    offset = places - np.array(SIZE[::-1]) / 2
    return places + SHIFT + (offset @ slopes)[..., None] * ALONG + larger * offset


def views(
    slopes: Array, noise: float, rng: np.random.Generator, larger: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Return a left and a right view of a surface; the displacement is linear."""
    pixels = np.stack(np.meshgrid(*(np.arange(float(n)) for n in SIZE[::-1])), -1)
    middle = np.array(SIZE[::-1]) / 2
    back = np.linalg.inv((1 + larger) * np.eye(2) + np.outer(ALONG, slopes))
    in_left = (pixels - SHIFT - middle) @ back.T + middle
    drawn = (texture(p[..., 0], p[..., 1]) for p in (pixels, in_left))
    left, right = (np.round(each + rng.normal(0, noise, SIZE)) for each in drawn)
    return left, right


def match(
    left: np.ndarray, right: np.ndarray, found: Array, larger: float = 0.0, beside_px: float = 0.0
) -> Matched:
    """Return matches with a right image that shows its view farther to the right."""
    v, u = (each.astype(np.float32) for each in np.indices(SIZE))
    u += np.float32(beside_px)
    direction = np.tile(ALONG, (len(AT), 1))
    enlargement = np.full(len(AT), larger)
    return match_windows(
        left, right, (u, v), at=AT, found=found, direction=direction, enlargement=enlargement
    )


@pytest.mark.parametrize(
    ("slopes", "larger"),
    [((0.0, 0.0), 0.0), ((0.1, 0.0), 0.0), ((0.0, 0.1), 0.0), ((-0.08, 0.06), 0.03)],
)
def test_windows_on_an_inclined_surface_are_found(slopes, larger):
    rng, slopes = np.random.default_rng(0), np.array(slopes)
    left, right = views(slopes, 0.0, rng, larger)
    truth = displaced(AT, slopes, larger)
    matched = match(left, right, truth + rng.uniform(-0.3, 0.3, truth.shape), larger)
    assert matched.good.mean() > 0.9
    errors = (matched.pixels - truth)[matched.good]
    # Interpolation between pixels leaves this much, at random.
    assert np.sqrt(np.mean(errors**2)) < 0.02
    assert np.abs(errors.mean(axis=0)).max() < 0.006


def test_errors_are_as_stated_and_grow_with_the_noise():
    """Noise of pixels is independent here: the inflation for correlated errors makes up for two."""
    rng, slopes = np.random.default_rng(1), np.array([0.05, -0.05])
    truth, errors = displaced(AT, slopes), []
    for noise in (2.0, 8.0):
        matched = match(*views(slopes, noise, rng), truth)
        errors.append((matched.pixels - truth)[matched.good])
        root = np.linalg.cholesky(matched.covariance[matched.good])
        stated = np.linalg.solve(root, errors[-1][..., None])
        assert 0.4 < np.sqrt(np.mean(stated**2)) < 1.1
    assert np.std(errors[1]) > 3 * np.std(errors[0])


def test_a_window_on_the_edge_of_a_nearer_thing_is_less_certain():
    """Right of column 152 all is displaced by 2 px more."""
    rng, flat = np.random.default_rng(2), np.zeros(2)
    left, right = views(flat, 1.0, rng)
    nearer = np.roll(right, 2, axis=1)
    right[:, 154:] = nearer[:, 154:]
    matched = match(left, right, displaced(AT, flat))
    spread = np.sqrt(np.trace(matched.covariance, axis1=1, axis2=2))
    at_edge = (np.abs(AT[:, 0] - 152) < 6) & matched.good
    aside = (np.abs(AT[:, 0] - 152) > 30) & matched.good
    assert np.median(spread[at_edge]) > 3 * np.median(spread[aside])


def test_noise_alone_does_not_pass_for_texture():
    left, right = 128.0 + np.random.default_rng(0).normal(0, 2, (2, *SIZE))
    matched = match(left, right, AT)
    std = np.sqrt(np.linalg.eigvalsh(matched.covariance)[:, 1])
    assert (matched.good & (std < 0.5)).mean() < 0.1


def test_windows_that_the_right_image_shows_in_part_are_not_good():
    """Those in its last column, which lie half beyond its edge."""
    left, right = views(np.zeros(2), 0.0, np.random.default_rng(0))
    beside_px = 25
    right = np.roll(right, beside_px, axis=1)
    matched = match(left, right, displaced(AT, np.zeros(2)), beside_px=beside_px)
    partly = AT[:, 0] + SHIFT[0] + beside_px + 7 > SIZE[1] - 1
    assert 0 < partly.sum() < len(AT)
    np.testing.assert_array_equal(matched.good, ~partly)


def test_noise_that_neighbouring_pixels_share_is_allowed_for():
    """As interpolation and blur leave it."""
    rng, flat = np.random.default_rng(3), np.zeros(2)
    noise = np.stack([cv2.GaussianBlur(each, (0, 0), 1.0) for each in rng.normal(0, 1, (2, *SIZE))])
    left, right = views(flat, 0.0, rng)
    left, right = np.round(np.stack([left, right]) + 4 * noise / noise.std())
    matched = match(left, right, displaced(AT, flat))
    assert matched.good.all()
    root = np.linalg.cholesky(matched.covariance)
    stated = np.linalg.solve(root, (matched.pixels - displaced(AT, flat))[..., None])
    assert 0.8 < np.sqrt(np.mean(stated**2)) < 1.35
