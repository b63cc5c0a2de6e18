"""Make the pictures of the documents from a run's results.

    vergence reproduce --out runs/paper
    python docs/make_pictures.py runs/paper

The screenshot is taken by rerun's viewer without a screen; it needs a Vulkan driver (Debian:
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
"""When the screenshot is taken: all four cameras of Fig. 6 see the object, and there is a trail."""
PORT = 9987


def screenshot(recording: Path, moment_s: float) -> np.ndarray:
    """Return the viewer's window (H, W, 3), BGR, with a recording at a moment."""
    # The viewer is looked for on the PATH, where an environment that is not activated is not.
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
    """Write a PNG with as many colours as fit into MOST_BYTES."""
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


def main() -> None:
    parser = argparse.ArgumentParser(description="Make the pictures of the documents.")
    parser.add_argument("run", type=Path, help="folder that `vergence reproduce` wrote")
    parser.add_argument("--moment", type=float, default=MOMENT_S, help="of the screenshot [s]")
    args = parser.parse_args()
    figures = cv2.imread(str(args.run / "figures.png"))
    if figures is None or not (args.run / "fig06.rrd").is_file():
        sys.exit(f"{args.run} holds no figures.png or no fig06.rrd; run `vergence reproduce`.")
    IMAGES.mkdir(exist_ok=True)
    write_small(IMAGES / "figures.png", shrink(figures, 1200))
    write_small(
        IMAGES / "recording.png", shrink(screenshot(args.run / "fig06.rrd", args.moment), 1440)
    )


if __name__ == "__main__":
    main()
