"""Make the pictures of the documents from the results of runs.

    vergence reproduce --out runs/paper
    vergence reproduce --compare --figures 6 7 --out runs/compared
    vergence foveate --trials 10 --profile paper --out runs/foveate
    vergence design --out runs/design
    python docs/make_pictures.py --paper runs/paper --compared runs/compared
    python docs/make_pictures.py --gaze runs/foveate --design runs/design --scenes

Screenshots are taken by rerun's viewer without a display, which needs a Vulkan driver (Debian:
apt-get install mesa-vulkan-drivers).
"""

from __future__ import annotations

import argparse
import os
import sys
import sysconfig
import time
from pathlib import Path

import cv2
import numpy as np
from rerun.experimental import ViewerClient  # experimental: its names change between versions

IMAGES = Path(__file__).parent / "images"
MOST_BYTES = 250_000
MOMENT_S = 20.3
"""Moment of the screenshot of Fig. 6, at which all four cameras see the object."""
GAZE_S = 1.16
"""Moment of the screenshot of foveate, at which the third object is nearly centred."""
PORT = 9987


def screenshot(recording: Path, moment_s: float) -> np.ndarray:
    """Return the viewer's window (H, W, 3), BGR, with a recording at a moment."""
    # rerun looks for its viewer on the PATH, which lacks an environment that is not activated.
    os.environ["PATH"] = os.pathsep.join([sysconfig.get_path("scripts"), os.environ["PATH"]])
    with ViewerClient.spawn(headless=True, port=PORT, hide_welcome_screen=True) as viewer:
        viewer.open(str(recording.resolve()))
        while viewer.get_state().loading:
            time.sleep(0.1)
        time.sleep(5.0)  # indexed only after it is loaded
        viewer.set_time("sim_time", duration=moment_s, play_state="paused")
        time.sleep(3.0)  # views report transient errors until their first full frame
        png = viewer.take_screenshot()
        problems = [(v.name, r.summary) for v in viewer.get_state().views for r in v.reports]
    if problems:
        sys.exit(f"The viewer complains: {problems}")
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        sys.exit("The viewer gave no picture.")
    return image


def write_small(path: Path, image: np.ndarray) -> None:
    """Write a PNG file with as many colours as MOST_BYTES allows."""
    for levels in (256, 64, 48, 32, 24, 16):
        step = 256 / levels
        coarse = np.round(np.round(image / step) * step).clip(0, 255).astype(np.uint8)
        cv2.imwrite(str(path), coarse, [cv2.IMWRITE_PNG_COMPRESSION, 9])
        if path.stat().st_size <= MOST_BYTES:
            break
    print(f"{path.name}: {image.shape[1]} x {image.shape[0]}, {path.stat().st_size / 1e3:.0f} kB")


def shrink(image: np.ndarray, width: int) -> np.ndarray:
    """Return an image no wider than a width [px]."""
    scale = min(1.0, width / image.shape[1])
    return cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)


def of_paper(run: Path) -> None:
    """Make the pictures of a run of `vergence reproduce`."""
    write_small(IMAGES / "figures.png", shrink(picture(run / "figures.png"), 1200))
    write_small(IMAGES / "recording.png", shrink(screenshot(run / "fig06.rrd", MOMENT_S), 1440))


def of_comparison(run: Path) -> None:
    """Make the picture of a run of `vergence reproduce --compare` of two figures."""
    write_small(IMAGES / "self_calibration.png", shrink(picture(run / "figures.png"), 1200))


def of_gaze(run: Path) -> None:
    """Make the pictures of a run of `vergence foveate`."""
    write_small(IMAGES / "depth.png", shrink(picture(run / "depth.png"), 1200))
    write_small(IMAGES / "gaze.png", shrink(screenshot(run / "foveate.rrd", GAZE_S), 1440))


def of_design(run: Path) -> None:
    """Make the picture of a run of `vergence design`."""
    write_small(IMAGES / "design.png", shrink(picture(run / "design.png"), 1560))


def of_scenes() -> None:
    """Make the pictures of the scenes, and of a rectified pair with its disparities."""
    from vergence.accuracy.motions import eye_angles
    from vergence.stereo.dense_depth import dense_depth
    from vergence.stereo.rectification import rectified_image, rectify
    from vergence.twin.calibration_sequence import straight_neck
    from vergence.twin.head import Twin
    from vergence.twin.profile import load_profile

    posture = straight_neck(eye_angles("divergent", np.array(18.0)))
    cameras = ("left_wide", "right_wide")
    seen = []
    for scene in ("room", "sparse", "moving"):
        with Twin(load_profile("paper"), scene=scene) as twin:
            twin.place_object(np.array([0.43, -0.02, -0.08]))
            twin.advance(0.5, straight_neck(np.zeros(4)))
            seen.append(twin.capture(("left_wide",)).images["left_wide"])
            if scene != "room":
                continue
            twin.advance(1.0, posture)
            images, angles = twin.capture(cameras).images, twin.true_angles()[3:]
            pair = rectify(twin.truth, angles)
            left, right = (images[name] for name in cameras)
            found = dense_depth(twin.truth, angles, pair, left, right)
            grey = np.nan_to_num(5 * found.disparity_px).clip(0, 255).astype(np.uint8)
            shown = cv2.applyColorMap(grey, cv2.COLORMAP_TURBO)[..., ::-1]
            shown[grey == 0] = 0
            views = [found.image, rectified_image(pair.right, right), shown]
            write_small(IMAGES / "dense_depth.png", shrink(np.hstack(views)[..., ::-1], 1200))
    write_small(IMAGES / "scenes.png", shrink(np.hstack(seen)[..., ::-1], 1200))


def picture(path: Path) -> np.ndarray:
    """Return an image (H, W, 3), BGR, from a file."""
    image = cv2.imread(str(path))
    if image is None:
        sys.exit(f"There is no picture {path}; the docstring has the commands that make it.")
    return image


def main() -> None:
    parser = argparse.ArgumentParser(description="Make the pictures of the documents.")
    parser.add_argument("--paper", type=Path, help="folder that `vergence reproduce` wrote")
    parser.add_argument("--compared", type=Path, help="folder of `vergence reproduce --compare`")
    parser.add_argument("--gaze", type=Path, help="folder that `vergence foveate` wrote")
    parser.add_argument("--design", type=Path, help="folder that `vergence design` wrote")
    parser.add_argument("--scenes", action="store_true", help="render the scenes, too")
    args = parser.parse_args()
    IMAGES.mkdir(exist_ok=True)
    if args.paper is not None:
        of_paper(args.paper)
    if args.compared is not None:
        of_comparison(args.compared)
    if args.gaze is not None:
        of_gaze(args.gaze)
    if args.design is not None:
        of_design(args.design)
    if args.scenes:
        of_scenes()


if __name__ == "__main__":
    main()
