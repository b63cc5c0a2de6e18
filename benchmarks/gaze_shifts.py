"""Stability of the image while eyes and neck share gaze shifts of 20 to 60 degrees.

    python benchmarks/gaze_shifts.py [--profile ideal] [--shifts 40] [--seed 0]

The twin is calibrated and turns to objects that appear one after the other.
"""

from dataclasses import replace

import numpy as np
import tyro

from gaze_shift import objects, shift_gaze
from vergence.twin.head import Twin
from vergence.twin.profile import load_profile
from vergence.twin.simulated_robot import calibrate_twin

BAR_PX = 20.0
"""Greatest error allowed for a foveated object while the neck turns."""
ARRIVED_PX = 8.0


def main(profile: str = "ideal", shifts: int = 40, seed: int = 0) -> None:
    """Print statistics of the gaze shifts.

    Args:
        profile: error profile.
        shifts: number of gaze shifts.
        seed: of everything random.
    """
    with Twin(load_profile(profile), seed=seed) as twin:
        settings = replace(calibrate_twin(twin, seed), use_neck=True)
        done = shift_gaze(twin, settings, 1, objects(shifts, seed))
    angle = np.degrees([shift.angle_rad for shift in done])
    reached, moved, final, neck, beyond, frames = (
        np.array([getattr(shift, name) for shift in done])
        for name in (
            "reached_s",
            "turning_px",
            "final_px",
            "neck_rad",
            "beyond_rad",
            "turning_frames",
        )
    )
    print(f"{shifts} shifts of {angle.min():.0f} to {angle.max():.0f} degrees, {profile}")
    print(f"ended within {ARRIVED_PX:.0f} px of both centres: {(final < ARRIVED_PX).sum()}")
    print(f"reached after: median {np.median(reached):.2f} s, last {reached.max():.2f} s")
    print(f"the neck turned by: median {np.degrees(np.median(neck)):.0f} degrees")
    print(
        f"object from the centres while the neck still turned ({frames.sum()} frames): "
        f"median {np.median(moved):.1f} px, worst {moved.max():.1f} px, "
        f"below {BAR_PX:.0f} px in {(moved < BAR_PX).sum()}"
    )
    print(f"a joint beyond its range by at most {np.degrees(max(beyond.max(), 0)):.3f} degrees")
    for k in np.argsort(moved)[-3:]:
        print(f"  shift {k}: {angle[k]:.0f} deg, {reached[k]:.2f} s, {moved[k]:.1f} px")


if __name__ == "__main__":
    tyro.cli(main)
