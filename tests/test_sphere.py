"""The image of a sphere's centre, from antialiased pictures made here."""

import cv2
import numpy as np
import pytest

from vergence.geometry.camera import Camera, normalise, pinhole, project
from vergence.vision.sphere import find_sphere, sphere_detector

WIDE = pinhole(640, 480, 280.0, (-0.12, 0.02, 0.0005, -0.0005, 0.0))
PLAIN = pinhole(640, 480, 400.0)
RED, GREY = np.array([200.0, 20.0, 20.0]), 110.0
RADIUS_M = 0.02
_FINE = 8  # samples along each side of a pixel; half as many where there are many pixels


def picture(
    camera: Camera,
    centre: np.ndarray,
    radius: float = RADIUS_M,
    *,
    light: np.ndarray | None = None,
    background: np.ndarray | float = GREY,
) -> np.ndarray:
    """Return the image (H, W, 3) uint8 of a red sphere, each pixel averaged.

    It is flat, or matt and lit from everywhere, most from the direction `light` (3,).
    """
    middle = project(camera, centre)
    size = int(1.4 * camera.matrix[0, 0] * radius / centre[2] + 12)
    u0, v0 = np.clip(np.round(middle).astype(int) - size, 0, [camera.width, camera.height])
    u1, v1 = np.clip(np.round(middle).astype(int) + size, 0, [camera.width, camera.height])
    fine = _FINE if size < 100 else _FINE // 2
    offsets = (np.arange(fine) + 0.5) / fine - 0.5
    u = (np.arange(u0, u1)[:, None] + offsets).ravel()
    v = (np.arange(v0, v1)[:, None] + offsets).ravel()
    rays = normalise(camera, np.stack(np.meshgrid(u, v), axis=-1))
    rays = np.concatenate([rays, np.ones((*rays.shape[:2], 1))], axis=-1)
    along = rays @ centre / np.linalg.norm(rays, axis=-1)
    hit = along**2 >= centre @ centre - radius**2
    brightness = np.ones(hit.shape)
    if light is not None:
        unit = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        near = along - np.sqrt(np.maximum(along**2 - centre @ centre + radius**2, 0))
        normals = (near[..., None] * unit - centre) / radius
        brightness = 0.8 + 0.25 * normals @ light
    shape = v1 - v0, fine, u1 - u0, fine
    cover = hit.reshape(shape).mean(axis=(1, 3))[..., None]
    lit = (hit * brightness).reshape(shape).mean(axis=(1, 3))[..., None]
    image = np.ones((camera.height, camera.width, 3)) * background
    image[v0:v1, u0:u1] = lit * RED + (1 - cover) * image[v0:v1, u0:u1]
    return np.round(image).astype(np.uint8)


def at(camera: Camera, pixel: tuple[float, float], depth_m: float) -> np.ndarray:
    return np.array([*normalise(camera, np.array(pixel)), 1.0]) * depth_m


@pytest.mark.parametrize("camera", [WIDE, PLAIN], ids=["distorted", "pinhole"])
@pytest.mark.parametrize("pixel", [(60.3, 50.7), (590.1, 60.2), (61.9, 430.4), (580.6, 420.9)])
def test_the_centre_is_unbiased_in_the_corners_of_the_field(camera, pixel):
    """Within 0.02 px, where the outline's own centre is off by more."""
    image = picture(camera, at(camera, pixel, 0.35))
    assert np.abs(find_sphere(image, camera) - pixel).max() < 0.02
    v, u = np.nonzero(image[..., 0] > 150)
    assert np.abs(np.array([u.mean(), v.mean()]) - pixel).max() > 0.1


def test_the_centre_has_no_error_that_follows_the_pixel_grid():
    errors = []
    for shift in np.linspace(0, 1, 12, endpoint=False):
        pixel = (410.0 + shift, 130.0 + 0.37 * shift)
        errors.append(find_sphere(picture(WIDE, at(WIDE, pixel, 1.1)), WIDE) - pixel)
    assert np.abs(errors).max() < 0.02


WOOD = np.array([150.0, 128.0, 100.0])
BRICK, PAINT = np.array([120.0, 82.0, 72.0]), np.array([182.0, 178.0, 165.0])
PIXEL = (200.4, 300.3)
SIDE, BELOW = np.array([0.8, -0.6, 0.0]), np.array([-0.6, 0.0, -0.8])
U, V = np.meshgrid(np.arange(640), np.arange(480))
TEXTURE = GREY - 60 * ((U // 9 + V // 7) % 2)[..., None]


@pytest.mark.parametrize("depth", [0.2, 0.4, 0.8, 1.2])
@pytest.mark.parametrize(
    ("light", "background", "blur_px", "within_px"),
    [
        (None, GREY, 0.0, 0.02),
        (None, TEXTURE, 0.0, 0.02),
        (SIDE, WOOD, 0.0, 0.03),
        (BELOW, WOOD, 0.0, 0.03),
        (BELOW, np.where((PIXEL[0] - 5 > U)[..., None], BRICK, PAINT), 0.45, 0.03),
        (BELOW, np.where((PIXEL[0] + 3 > U)[..., None], BRICK, PAINT), 0.45, 0.03),
        (SIDE, WOOD, 0.5, 0.05),
        (SIDE, WOOD, 1.0, 0.05),
    ],
    ids=["grey", "texture", "side", "below", "edge", "other edge", "blur", "more blur"],
)
def test_shading_background_and_blur_do_not_move_the_centre(
    light, background, blur_px: float, within_px: float, depth: float
):
    """Weighting with brightness alone would err by a tenth of a pixel and more."""
    image = picture(WIDE, at(WIDE, PIXEL, depth), light=light, background=background)
    image = cv2.GaussianBlur(image, (0, 0), blur_px) if blur_px else image
    assert np.abs(find_sphere(image, WIDE) - PIXEL).max() < within_px


@pytest.mark.parametrize("depth", [0.2, 0.4])
@pytest.mark.parametrize("hidden", [0.15, 0.25, 0.5])
def test_the_centre_of_a_sphere_that_is_hidden_in_part_is_not_known(depth: float, hidden: float):
    """The middle of what is left is wrong by pixels: it is no measurement, or an uncertain one."""
    pixel = (200.4, 300.3)
    image = picture(WIDE, at(WIDE, pixel, depth), light=np.array([0.8, -0.6, 0.0]), background=WOOD)
    right = pixel[0] + WIDE.matrix[0, 0] * RADIUS_M / depth * (1 - 2 * hidden)
    image[:, round(right) :] = (90, 100, 120)
    assert np.isnan(find_sphere(image, WIDE)).all()
    found = sphere_detector()(image, WIDE, None)
    assert found is not None
    error = np.abs(found.pixel - pixel).max()
    assert error > 0.5
    assert error < 2 * found.std_px


@pytest.mark.render
def test_the_rendered_sphere_is_where_the_twin_knows_it_in_the_room():
    from vergence.geometry.projection import project_point
    from vergence.twin.head import Twin
    from vergence.twin.profile import ErrorProfile

    rng, errors = np.random.default_rng(0), []
    with Twin(ErrorProfile()) as twin:
        for depth in (0.42, 0.64, 1.1):
            for _ in range(4):
                twin.advance(twin.time_s + 0.2, np.append(np.zeros(3), rng.uniform(-0.2, 0.2, 4)))
                twin.place_object(np.array([depth, *rng.uniform(-0.15, 0.15, 2) * depth]))
                eyes, where = twin.true_angles()[3:], twin.true_object()
                for name, image in twin.capture(("left_wide", "right_wide")).images.items():
                    true = project_point(twin.truth, name, eyes, where)
                    errors.append(find_sphere(image, twin.truth.camera(name).intrinsics) - true)
    assert np.abs(np.mean(errors, axis=0)).max() < 0.05
    assert np.sqrt(np.mean(np.square(errors))) < 0.07


def test_the_largest_region_counts_unless_another_is_near_where_it_is_sought():
    pixel = (200.4, 300.3)
    image = picture(WIDE, at(WIDE, pixel, 0.4))
    image[100:103, 500:503] = RED
    assert np.abs(find_sphere(image, WIDE) - pixel).max() < 0.02
    image[60:220, 420:580] = picture(WIDE, at(WIDE, (500.0, 140.0), 0.1))[60:220, 420:580]
    near = sphere_detector()(image, WIDE, np.array([190.0, 310.0]))
    assert near is not None
    assert np.abs(near.pixel - pixel).max() < 0.02
    assert np.abs(find_sphere(image, WIDE) - pixel).max() > 100


@pytest.mark.parametrize("pixel", [(5.0, 240.0), (636.0, 240.0), (320.0, 3.0), (320.0, 477.0)])
def test_a_sphere_partly_outside_the_image_is_not_found(pixel: tuple[float, float]):
    image = picture(WIDE, at(WIDE, pixel, 0.35))
    assert (image[..., 0] > 150).sum() > 50
    assert np.isnan(find_sphere(image, WIDE)).all()


def test_what_is_no_sphere_is_not_found():
    """Nothing red; a speck; red beyond the fold of a lens."""
    rng = np.random.default_rng(0)
    grey = rng.integers(0, 256, (480, 640, 1)).astype(np.uint8).repeat(3, axis=2)
    speck, corner = np.full((2, 480, 640, 3), 110, np.uint8)
    speck[200, 300:303], corner[20:40, 20:40] = RED, RED
    for image in (grey, np.zeros((480, 640, 3), np.uint8), speck):
        assert np.isnan(find_sphere(image, WIDE)).all()
    folding = pinhole(640, 480, 280.0, (-0.3, 0, 0, 0, 0))
    assert np.isnan(find_sphere(corner, folding)).all()


def test_whatever_is_red_gives_a_pixel_or_none_without_a_warning():
    for width_px in (1, 2, 3):  # of large windows that are averaged nothing is left
        image = np.full((480, 640, 3), 110, np.uint8)
        cv2.circle(image, (320, 240), 150, (150, 90, 90), width_px)
        assert not np.isinf(find_sphere(image, WIDE)).any()
    rng = np.random.default_rng(0)
    camera = pinhole(160, 120, 70.0, (-0.12, 0.02, 0.0005, -0.0005, 0.0))
    for _ in range(100):
        image = np.full((120, 160, 3), rng.integers(0, 256, 3), np.uint8)
        u, v, width, height = rng.integers([10, 10, 1, 1], [110, 90, 20, 20])
        shape = image[v : v + height, u : u + width]
        shape[:] = rng.integers([100, 0, 0], [256, 120, 120], shape.shape)
        assert not np.isinf(find_sphere(image, camera)).any()


def test_a_blue_sphere_is_found_beside_a_red_one_and_neither_for_the_other():
    red = picture(WIDE, at(WIDE, (300.2, 200.4), 0.5))
    blue = picture(WIDE, at(WIDE, (330.7, 280.1), 0.5))[..., ::-1]
    both = np.where(np.abs(blue - GREY).max(axis=-1, keepdims=True) > 0, blue, red)
    for colour, pixel in (("red", (300.2, 200.4)), ("blue", (330.7, 280.1))):
        found = sphere_detector(colour)(both, WIDE, None)
        assert found is not None
        np.testing.assert_allclose(found.pixel, pixel, atol=0.02)
    assert sphere_detector("blue")(red, WIDE, None) is None
