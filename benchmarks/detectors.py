"""Final error of the gaze by detector, cameras and joints: a sphere and a marker.

    python benchmarks/detectors.py [--trials 40] [--profile ideal] [--seed 0]

The trials are those of `vergence foveate`: an object appears, and half a second later its true
distance from the image's centre is measured, in the worse eye. With the wide cameras alone the head
has no others: calibration, roles and error are those of the wide images. Pixels of a wide camera
are 4.3 times as large as those of a narrow one. Eyes that share a tilt cannot both centre the
object where their narrow cameras are mounted at different heights: half of that remains.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import tyro

from cards import Card, marker_card
from vergence.demos.experiment import p95
from vergence.demos.foveate import run_trial, targets
from vergence.gaze.state import GazeSettings
from vergence.twin.head import Twin
from vergence.twin.head_model import HeadModel
from vergence.twin.profile import load_profile
from vergence.twin.simulated_robot import calibrate_twin, unoccluded
from vergence.vision.detector import Detector
from vergence.vision.marker import marker_detector
from vergence.vision.sphere import sphere_detector

DICTIONARY, MARKER = "DICT_4X4_50", 7
CARD_M = 0.1
"""Side of the marker [m]: 19 px in a wide image at 1.5 m."""


def wide_alone(settings: GazeSettings) -> GazeSettings:
    """Return the settings of a head that has no narrow cameras."""
    head = settings.calibration
    wide = {name: head.cameras[name] for name in settings.wide}
    return replace(settings, calibration=replace(head, cameras=wide))


KINDS: dict[str, tuple[Card | None, Detector, bool]] = {
    "four cameras, sphere": (None, sphere_detector(), False),
    "wide alone, sphere": (None, sphere_detector(), True),
    "wide alone, marker": (
        marker_card(DICTIONARY, MARKER, CARD_M),
        marker_detector(DICTIONARY, MARKER),
        True,
    ),
}
"""By name: the card that is shown, None for the sphere; its detector; and whether the head has wide
cameras only."""


def final_errors(
    kind: str,
    *,
    trials: int,
    profile: str,
    seed: int,
    calibration: GazeSettings | None = None,
    head: HeadModel | None = None,
) -> tuple[list[float], int]:
    """Return the final errors [px] of trials, and how many lost the object.

    Settings with a calibration may be given; None: the twin is calibrated. The head is the default
    one, or another.
    """
    card, detect, alone = KINDS[kind]
    furnish = card and card.put
    with Twin(load_profile(profile), seed=seed, furnish=furnish, head=head) as twin:
        settings = calibrate_twin(twin, seed) if calibration is None else calibration
        settings = replace(settings, objects={"object": detect})
        settings = wide_alone(settings) if alone else settings
        places = targets(trials, seed, free=partial(unoccluded, twin, margin_m=CARD_M / 2))
        made = [run_trial(twin, settings, k, place) for k, place in enumerate(places, start=1)]
    return [trial.final_px for trial in made], sum(trial.lost for trial in made)


def main(trials: int = 40, profile: str = "ideal", seed: int = 0) -> None:
    """Print a table of final errors.

    Args:
        trials: number of objects of each kind.
        profile: error profile.
        seed: of everything random.
    """
    print(
        "| cameras, object | median [px] | 95 % [px] | worst [px] | lost |\n|---|---|---|---|---|"
    )
    for kind in KINDS:
        found, lost = final_errors(kind, trials=trials, profile=profile, seed=seed)
        print(
            f"| {kind} | {np.median(found):.3f} | {p95(found):.3f} | {max(found):.3f} "
            f"| {lost} of {trials} |",
            flush=True,
        )


if __name__ == "__main__":
    tyro.cli(main)
