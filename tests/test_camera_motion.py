"""How cameras stand to each other, and how this changes with everything that moves them."""

import numpy as np
import pytest

from head_kinds import KINDS, head_of
from vergence.geometry.camera import intrinsics_names
from vergence.geometry.eye_motion import camera_motion, relative_motion
from vergence.geometry.head import parameter_names
from vergence.geometry.parameters import boxplus
from vergence.geometry.se3 import boxminus
from vergence.stereo.extrinsics import camera_poses, relative_camera_pose


def drawn(kind):
    """Return a head with its first and last camera, readings of two moments, and a generator."""
    rng = np.random.default_rng(0)
    head = head_of(kind, rng)
    r, names = len(head.kinematics.readings), list(head.cameras)
    return head, (names[0], names[-1]), *rng.normal(0, 0.2, (2, r)), rng


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "one eye"])
def test_of_the_two_eyes_it_is_equation_11(kind):
    head, pair, joints, _, _ = drawn(kind)
    left, right = (camera_motion(head, name, joints) for name in pair)
    poses = camera_poses(head, joints, cameras=pair)
    np.testing.assert_allclose([left.T_lbase_cam, right.T_lbase_cam], poses, atol=1e-14)
    expected = relative_camera_pose(head, joints, cameras=pair)
    np.testing.assert_allclose(relative_motion(left, right).T_second_first, expected, atol=1e-14)


@pytest.mark.parametrize("other", [0, 1], ids=["both cameras", "one camera"])
@pytest.mark.parametrize("kind", KINDS)
def test_increments_are_those_of_differences(kind, other):
    head, cameras, before, now, rng = drawn(kind)
    change = rng.normal(0, 1, len(parameter_names(head)))
    # Lenses move no camera, and focal lengths would become negative.
    of_lenses = {
        f"{camera}.{name}"
        for camera, mounted in head.cameras.items()
        for name in intrinsics_names(mounted.intrinsics)
    }
    change[[name in of_lenses for name in parameter_names(head)]] = 0
    turns = rng.normal(0, 1, (2, len(now)))

    def moved(h):
        changed = boxplus(head, h * change)
        moments = before + h * turns[0], now + h * turns[1]
        first, second = (
            camera_motion(changed, name, joints)
            for name, joints in zip((cameras[other], cameras[1]), moments, strict=True)
        )
        return relative_motion(first, second)

    found, step = moved(0.0), 1e-6
    low, high = (
        boxminus(moved(h).T_second_first, found.T_second_first) / step for h in (-step, step)
    )
    expected = found.by_parameters @ change + found.by_first @ turns[0] + found.by_second @ turns[1]
    np.testing.assert_allclose((high - low) / 2, expected, rtol=1e-6, atol=1e-8)
