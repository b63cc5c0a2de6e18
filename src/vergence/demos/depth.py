"""Dense depth while the twin's eyes move, and its error.

The truth is used for the errors, and to refuse a calibration of another head.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from vergence.accuracy.motions import eye_angles
from vergence.demos.depth_errors import DepthTruth, PairErrors, depth_errors, pooled
from vergence.demos.experiment import LOOKING, Experiment
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
from vergence.twin.model import check_calibration_of
from vergence.twin.simulated_robot import calibrate_twin, learn_by_looking

STEP_S = 9.0
"""Time between two pairs of the divergent motion [s]: no divisor of its periods."""


@contextmanager
def twin_depth(
    calibration: HeadCalibration | None, experiment: Experiment, pairs: int, progress: Progress
) -> Iterator[DepthSequence]:
    """Compute dense depth over the divergent motion of a twin, in a `with` block.

    Without a calibration the twin is calibrated first, by the paper's method. With the geometry
    "seen" it looks around first. VergenceError if the calibration is of another head.
    """
    with Twin(experiment.profile, seed=experiment.seed, scene=experiment.scene) as twin:
        joint_std_rad = None
        if calibration is None:
            settings = calibrate_twin(twin, experiment.seed, progress)
            calibration, joint_std_rad = settings.calibration, settings.joint_std_rad
        else:
            check_calibration_of(twin.truth, calibration)
        errors: dict[str, list[PairErrors]] = defaultdict(list)
        found = _pairs(twin, calibration, pairs, experiment.geometry, joint_std_rad, errors)
        yield DepthSequence(
            calibration,
            found,
            pairs,
            errors=lambda: {name: pooled(each) for name, each in errors.items()},
        )


def _pairs(
    twin: Twin,
    head: HeadCalibration,
    pairs: int,
    geometry: Geometry,
    joint_std_rad: float | None,
    errors: dict[str, list[PairErrors]],
) -> Iterator[tuple[StereoImages, PairDepth]]:
    """Yield pairs with their depths, and append their errors by geometry."""
    left, right = pair_names(twin.truth)
    visual = None
    if geometry == "seen":
        visual = learn_by_looking(twin, initial_visual_geometry(head), run=LOOKING)
    twin.restart(1)
    for k in range(pairs):
        posture = straight_neck(eye_angles("divergent", np.array(STEP_S * k)))
        twin.advance(twin.time_s + 0.5, posture)
        angles = twin.true_angles()[EYE_READINGS]
        frame = twin.capture((left, right))
        visual = None if visual is None else update_geometry(visual, frame)
        images = StereoImages(
            time_s=STEP_S * k,
            joints=frame.eye_angles,
            left=frame.images[left],
            right=frame.images[right],
            seen=None if visual is None else visual.latest,
        )
        truth = DepthTruth(twin.truth, angles, twin.true_depth(left))
        found = depth_by(images, head, images.joints, joint_std_rad=joint_std_rad)
        errors["joints"].append(depth_errors(*found, truth))
        true = depth_by(images, truth.head, truth.eye_angles)
        errors["true_geometry"].append(depth_errors(*true, truth))
        if images.seen is not None:
            found = depth_of(images, head)
            errors["seen"].append(depth_errors(*found, truth))
        yield images, found
