"""Lenses that were known before a calibration: their models, and whether the images agree."""

from __future__ import annotations

import numpy as np

from vergence.calibration.intrinsics import calibrate_camera
from vergence.calibration.lens_choice import known_model
from vergence.calibration.observations import Observations
from vergence.errors import VergenceError
from vergence.findings import Finding, warning
from vergence.geometry.board import corner_points

SIGNIFICANT = 4.0
"""Deviations [sigma] between a known focal length and the images' that are no chance."""
LEAST_PART = 0.004
"""Relative difference of focal lengths that is reported: boards that bend make a tenth of it."""


def contradicted_lenses(seen: Observations) -> list[Finding]:
    """Compare known focal lengths with those that images of eyes at rest show alone."""
    findings, points = [], corner_points(seen.board)
    for name, known in seen.known_lenses.items():
        if name not in seen.corners:
            continue
        model, size = known_model(known), seen.sizes[name]
        try:
            found = calibrate_camera(seen.corners[name], points, size=size, lens_model=model)
        except VergenceError:  # the images alone do not determine a lens
            continue
        stated, shown = (np.diag(lens.matrix)[:2] for lens in (known.camera, found.camera))
        std = np.hypot(found.accuracy.focal * shown, known.std_percent / 100 * stated)
        off = np.abs(shown - stated)
        if (off > np.maximum(SIGNIFICANT * std, LEAST_PART * stated)).any():
            k = int(np.argmax(off / std))
            sentence = (
                f"By the images {name}.{'fx' if k == 0 else 'fy'} is {shown[k]:.1f} px, but its "
                f"known lens has {stated[k]:.1f} px: check that it is the lens of these images, "
                "and the side of the board's squares; else state a larger intrinsics_std_percent."
            )
            findings.append(warning("known-lens", sentence, name))
    return findings
