"""How far away a scene is, by planes at many distances."""

import cv2
import numpy as np
import pytest

from vergence.vision.matching.scene_features import inverse_depths, step_px

FOCAL, MIDDLE = 280.0, np.array([319.5, 239.5])
SHIFTS = {
    "sideways": (-0.07, 0.0, 0.0),
    "upwards": (0.0, 0.07, 0.0),
    "askew": (-0.05, 0.05, 0.0),
    "ahead too": (-0.06, 0.0, 0.03),
}


def textured(seed: int = 0) -> np.ndarray:
    grey = cv2.GaussianBlur(np.random.default_rng(seed).normal(0, 1, (480, 640)), (0, 0), 5.0)
    return np.clip(128 + 40 * grey / grey.std(), 0, 255).astype(np.uint8)


def of_plane(image: np.ndarray, shift: np.ndarray, near: float) -> np.ndarray:
    """Return what the first camera shows of a plane that the second one sees as an image."""
    scale = 1 - near * shift[2]
    moved = near * FOCAL * shift[:2] + (1 - scale) * MIDDLE
    M = np.array([[scale, 0, moved[0]], [0, scale, moved[1]]])
    return cv2.warpAffine(image, M, (640, 480), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)


@pytest.mark.parametrize("shift", SHIFTS.values(), ids=SHIFTS.keys())
@pytest.mark.parametrize("displaced_px", [-16, 0, 40, 120])
def test_a_plane_is_found_to_half_a_step(shift: tuple[float, ...], displaced_px: float):
    by_inverse_depth = FOCAL * float(np.hypot(*shift[:2]))
    near, second = displaced_px / by_inverse_depth, textured()
    first = of_plane(second, np.array(shift), near)
    at = np.array([[300.0, 220.0], [330.0, 260.0], [360.0, 200.0]])
    found = inverse_depths(first, second, at, focal=FOCAL, middle=MIDDLE, shift=np.array(shift))
    assert np.abs(found - near).max() * by_inverse_depth <= 0.51 * step_px(640)


def test_what_has_no_texture_or_no_counterpart_tells_nothing():
    at, shift = np.array([[300.0, 220.0], [100.0, 100.0]]), np.array(SHIFTS["sideways"])
    for first, second in (
        (np.full((480, 640), 128, np.uint8), np.full((480, 640), 128, np.uint8)),
        (textured(0), textured(1)),
    ):
        found = inverse_depths(first, second, at, focal=FOCAL, middle=MIDDLE, shift=shift)
        assert np.isnan(found).all()


def test_cameras_at_one_place_tell_nothing():
    image, at = textured(), np.array([[300.0, 220.0]])
    found = inverse_depths(image, image, at, focal=FOCAL, middle=MIDDLE, shift=np.zeros(3))
    assert np.isnan(found).all()
