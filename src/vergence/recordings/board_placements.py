"""Number the placements of the board: frames share one as long as it stood still in the head."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from vergence.arrays import Array
from vergence.data.description import Description
from vergence.recordings.frame_choice import ChosenFrames
from vergence.recordings.moments import Moments


def number_placements(
    description: Description, moments: Moments, chosen: ChosenFrames, corners: Mapping[str, Array]
) -> np.ndarray:
    """Number the placements (F,) of int of chosen frames, from 0.

    `corners` by camera are (F, K, 2) [px], NaN where not seen.
    """
    return np.zeros(len(chosen.rows), int)  # a stand-in
