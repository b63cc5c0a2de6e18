"""An experiment of your own: does the estimate stay the same while the eyes converge?

python scenarios/own_experiment.py
"""

import numpy as np

import vergence as vg
from vergence.cli.terminal import plain_ending
from vergence.twin.calibration_sequence import paper_calibration
from vergence.twin.head import Twin
from vergence.twin.profile import load_profile
from vergence.vision.sphere import find_sphere

OBJECT_M = np.array([0.5, -0.046, 0.0])  # midway between the eyes, from the left one
VERGENCE_RAD = np.linspace(-0.05, 0.20, 12)  # by which each eye turns inwards


def main() -> None:
    with Twin(load_profile("ideal"), seed=0) as twin:
        head = paper_calibration(twin, seed=0).head
        twin.place_object(OBJECT_M)
        for turn in VERGENCE_RAD:
            twin.settle(np.array([0, 0, 0, -turn, 0, turn, 0]))  # neck, left eye, right eye
            frame = twin.capture(("left_wide", "right_wide"))
            left, right = (
                find_sphere(frame.images[n], head.camera(n).intrinsics) for n in frame.images
            )
            point = vg.locate(
                head, left=left[None], right=right[None], joints=frame.eye_angles
            ).xyz[0]
            x, y, z = 1e3 * (point - OBJECT_M)
            print(f"vergence {2 * turn:+.2f} rad: error {x:z.1f}, {y:z.1f}, {z:z.1f} mm")


if __name__ == "__main__":
    with plain_ending("own_experiment"):
        main()
