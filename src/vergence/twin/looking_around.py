"""Images of the room alone while the eyes move, before an experiment: self-calibration learns."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from vergence.accuracy.motions import SLOWEST_S, eye_angles
from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.progress import Progress, silent
from vergence.self_calibration.calibrator import VisualGeometry, update_geometry
from vergence.twin.calibration_sequence import straight_neck
from vergence.twin.head import Twin

LOOK_S, LOOK_STEP_S = 5.0, 0.1
"""Duration of looking around, and period of its images [s]."""
FASTER = SLOWEST_S["divergent"] / LOOK_S
"""Speed of the eyes relative to the paper's figures. Each joint passes through its range once, at
45 degrees a second or less: new postures are more informative than more images."""
_SETTLE_S = 1.0


def look_times() -> Array:
    """List the times (n,) [s] of the frames."""
    return np.arange(0.0, LOOK_S, LOOK_STEP_S)


def look_around(twin: Twin, cameras: Sequence[str], *, run: int) -> Iterator[Frame]:
    """Yield frames of LOOK_S of quick divergent motion, in which vergence changes.

    The number of the run determines the noise.
    """
    twin.restart(run)

    def command(time_s: float) -> Array:
        return straight_neck(eye_angles("divergent", FASTER * np.array(time_s - _SETTLE_S)))

    twin.advance(_SETTLE_S / 2, command(_SETTLE_S))
    for time_s in look_times():
        twin.advance(round(_SETTLE_S + time_s, 3), command)
        yield twin.capture(cameras)


def learn_by_looking(
    twin: Twin, geometry: VisualGeometry, *, run: int, progress: Progress = silent
) -> VisualGeometry:
    """Update a geometry while the twin looks around; see `look_around`."""
    total = len(look_times())
    for done, frame in enumerate(look_around(twin, geometry.state.cameras, run=run), start=1):
        geometry = update_geometry(geometry, frame)
        progress("looking around", done, total)
    return geometry
