"""Settings and printed results of the paper's Figs. 6-11.

Source: A. Ude and E. Oztop, "Active 3-D Vision on a Humanoid Head", captions of Figs. 6-11.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from vergence.accuracy.motions import PERIOD_S, Motion

Lens = Literal["2.8mm", "4.0mm"]
"""Focal length of the wide cameras."""
WIDE = ("left_wide", "right_wide")
"""The wide cameras of the paper's head, by which it locates points."""


@dataclass(frozen=True)
class Figure:
    """One experiment, in which the head locates a fixed object while its eyes move."""

    number: int
    motion: Motion
    lens: Lens
    mean_m: tuple[float, float, float]
    """Mean of the estimated positions (x forward = depth, y left, z up), as printed."""
    std_m: tuple[float, float, float]
    """Their standard deviation; printed to 1 mm, so that 2 mm means 1.5 to 2.5."""

    @property
    def title(self) -> str:
        """Heading of the figure's plot and recording: its number, motion and lens."""
        return f"Fig. {self.number} - {self.motion}, {self.lens.removesuffix('mm')} mm"


FIGURES = {
    figure.number: figure
    for figure in (
        Figure(6, "parallel", "2.8mm", (0.426, -0.021, -0.081), (0.010, 0.002, 0.005)),
        Figure(7, "divergent", "2.8mm", (0.421, -0.072, -0.088), (0.020, 0.003, 0.007)),
        Figure(8, "parallel", "2.8mm", (1.106, 0.017, 0.003), (0.066, 0.006, 0.008)),
        Figure(9, "divergent", "2.8mm", (1.109, 0.017, 0.001), (0.102, 0.011, 0.007)),
        Figure(10, "parallel", "4.0mm", (0.642, 0.173, -0.035), (0.019, 0.007, 0.003)),
        Figure(11, "divergent", "4.0mm", (0.643, 0.173, -0.035), (0.029, 0.011, 0.002)),
    )
}
"""The paper's figures by number."""


def default_duration_s(motion: Motion) -> float:
    """Compute the combined period, repeated to at least 60 s: shorter runs change the std."""
    return float(PERIOD_S[motion] * np.ceil(60 / PERIOD_S[motion]))
