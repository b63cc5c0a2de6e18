"""Dense depth while the twin's eyes move, and its error.

The truth, which only the twin knows, is used for the errors, and to refuse a calibration of another
head.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from vergence.accuracy.motions import eye_angles
from vergence.arrays import Array
from vergence.demos.depth_errors import DepthTruth, depth_errors, summed
from vergence.demos.experiment import LOOKING
from vergence.gaze.commands import EYE_READINGS
from vergence.geometry.head import HeadCalibration, pair_names
from vergence.progress import Progress
from vergence.self_calibration.calibrator import Geometry, initial_visual_geometry, update_geometry
from vergence.self_calibration.dense_pairs import (
    DepthSequence,
    PairDepth,
    StereoImages,
    depth_by,
    depth_of,
)
from vergence.twin.calibration_sequence import straight_neck
from vergence.twin.head import Twin
from vergence.twin.looking_around import learn_by_looking
from vergence.twin.model import check_calibration_of
from vergence.twin.profile import ErrorProfile
from vergence.twin.scene.room import Scene
from vergence.twin.simulated_robot import calibrate_twin

STEP_S = 9.0
"""Time between two pairs of the divergent motion: no divisor of its periods."""


Errors = dict[str, list[tuple[Array, Array, float]]]
"""What `depth_errors` returns for each pair, by geometry."""


@contextmanager
def twin_depth(
    calibration: HeadCalibration | None,
    *,
    profile: ErrorProfile,
    scene: Scene,
    seed: int,
    pairs: int,
    geometry: Geometry,
    progress: Progress,
) -> Iterator[DepthSequence]:
    """Give a `with` block the dense depth of pairs over the divergent motion of a twin.

    Args:
        calibration: of the head; None: the twin is calibrated first, by the paper's method.
        profile: of the twin.
        scene: that the twin looks at.
        seed: of everything random.
        pairs: number of pairs.
        geometry: by which the pairs are rectified; for "seen" the twin looks around first.
        progress: is called after each view of a calibration.

    Raises:
        VergenceError: the calibration is of another head.
    """
    with _twin(profile, scene, seed, calibration, progress) as (twin, head, joint_std):
        moments = _moments(twin, pairs, head if geometry == "seen" else None)
        errors: Errors = defaultdict(list)
        found = _compared(moments, head, joint_std, errors)
        yield DepthSequence(
            head, found, pairs, errors=lambda: {name: summed(each) for name, each in errors.items()}
        )


@contextmanager
def _twin(
    profile: ErrorProfile,
    scene: Scene,
    seed: int,
    given: HeadCalibration | None,
    progress: Progress,
) -> Iterator[tuple[Twin, HeadCalibration, float | None]]:
    with Twin(profile, seed=seed, scene=scene) as twin:
        if given is not None:
            check_calibration_of(twin.truth, given)
            yield twin, given, None
        else:
            settings = calibrate_twin(twin, seed, progress)
            yield twin, settings.calibration, settings.joint_std_rad


def _moments(
    twin: Twin, pairs: int, looks: HeadCalibration | None
) -> Iterator[tuple[StereoImages, DepthTruth]]:
    """Yield pairs; where a head is given, with the geometry that it sees."""
    left, right = pair_names(twin.truth)
    geometry = None
    if looks is not None:
        geometry = learn_by_looking(twin, initial_visual_geometry(looks), run=LOOKING)
    twin.restart(1)
    for k in range(pairs):
        posture = straight_neck(eye_angles("divergent", np.array(STEP_S * k)))
        twin.advance(twin.time_s + 0.5, posture)
        angles = twin.true_angles()[EYE_READINGS]
        frame = twin.capture((left, right))
        geometry = None if geometry is None else update_geometry(geometry, frame)
        moment = StereoImages(
            time_s=STEP_S * k,
            joints=frame.eye_angles,
            left=frame.images[left],
            right=frame.images[right],
            seen=None if geometry is None else geometry.latest,
        )
        yield moment, DepthTruth(twin.truth, angles, twin.true_depth(left))


def _compared(
    moments: Iterator[tuple[StereoImages, DepthTruth]],
    head: HeadCalibration,
    joint_std_rad: float | None,
    errors: Errors,
) -> Iterator[tuple[StereoImages, PairDepth]]:
    """Yield pairs with their depths, whose errors are added by geometry, as in Summary."""
    for moment, truth in moments:
        found = depth_by(moment, head, moment.joints, joint_std_rad=joint_std_rad)
        errors["joints"].append(depth_errors(*found, truth))
        true = depth_by(moment, truth.head, truth.eye_angles)
        errors["true_geometry"].append(depth_errors(*true, truth))
        if moment.seen is not None:
            found = depth_of(moment, head)
            errors["seen"].append(depth_errors(*found, truth))
        yield moment, found
