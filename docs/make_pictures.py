"""Make the pictures of the documents from the results of runs.

    vergence reproduce --out runs/paper
    vergence foveate --trials 10 --profile paper --out runs/foveate
    vergence design --accuracy-mm 5 --at-m 0.5 --out runs/design
    python docs/make_pictures.py --paper runs/paper --gaze runs/foveate --design runs/design
    python docs/make_pictures.py --compared runs/compared --scenes

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
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure as Canvas
from rerun.experimental import ViewerClient  # experimental: its names change between versions

from vergence.twin.scene import Scene
from vergence.viewer.plots.canvas import BLUE, panels, plain_log, save

IMAGES = Path(__file__).parent / "images"
MOST_BYTES = 250_000
MOMENT_S = 20.3
"""Moment of the screenshot of Fig. 6, at which all four cameras see the object."""
GAZE_S = 1.16
"""Moment of the screenshot of foveate, at which the third object is nearly centred."""
COMPARED_S, COMPARED_HZ = 60.0, 4.0
"""Length and rate of the replays in which self-calibration is compared."""
SCENES: dict[Scene, str] = {
    "room": "room",
    "sparse": "sparse: plain walls",
    "moving": "moving: an object passes",
}
"""Scenes of the twin that are shown, and their titles."""
DEPTH_M = (0.3, 5.0)
"""Ends of the scale of colours of depth."""
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
    """Replay Figs. 6 and 7 into a folder, and draw by how much depth is wrong, by method."""
    from vergence.paper.comparison import LEARNED, SINGLE
    from vergence.paper.reproduce import ReproductionSettings, reproduce
    from vergence.twin.profile import load_profile

    settings = ReproductionSettings(
        run,
        figures=(6, 7),
        profile=load_profile("paper"),
        duration_s=COMPARED_S,
        rate_hz=COMPARED_HZ,
        compare=True,
    )
    done = reproduce(settings, jobs=-1)
    canvas, all_axes = panels(2, "Error of the depth of a fixed object while the eyes move")
    for axes, (_, replay) in zip(all_axes, sorted(done.replays.items()), strict=True):
        true_m, time_s = replay.figure.mean_m[0], replay.measurements.time_s
        estimates = {
            "joint readings": (replay.points, BLUE, 0.8),
            "single frames": (replay.others[SINGLE], "darkorange", 1.1),
            "learned": (replay.others[LEARNED], "black", 1.4),
        }
        for name, (points, colour, width) in estimates.items():
            error_mm = 1e3 * (points[:, 0] - true_m)
            label = f"{name}: std {np.nanstd(error_mm, ddof=1):.1f} mm"
            axes.plot(time_s, error_mm, color=colour, linewidth=width, label=label)
        axes.set_title(f"{replay.figure.title}, object at {true_m:.2f} m", fontsize=11, loc="left")
        axes.set(xlabel="time [s]", ylabel="error of depth [mm]", ylim=(-75, 75))
        axes.legend(fontsize=9, frameon=False, loc="upper right")
        axes.grid(color="0.9", linewidth=0.6)
        axes.margins(x=0)
    save(canvas, run / "errors.png")
    write_small(IMAGES / "self_calibration.png", picture(run / "errors.png"))


def of_gaze(run: Path) -> None:
    """Make the pictures of a run of `vergence foveate`."""
    write_small(IMAGES / "depth.png", shrink(picture(run / "depth.png"), 1200))
    write_small(IMAGES / "gaze.png", shrink(screenshot(run / "foveate.rrd", GAZE_S), 1440))


def of_design(run: Path) -> None:
    """Make the picture of a run of `vergence design`."""
    write_small(IMAGES / "design.png", shrink(picture(run / "design.png"), 1560))


def of_scenes() -> None:
    """Make the pictures of the scenes, and of a rectified pair with its depth."""
    from vergence.accuracy.motions import eye_angles
    from vergence.stereo.dense_depth import dense_depth
    from vergence.stereo.rectification import rectified_image, rectify
    from vergence.twin.head import Twin
    from vergence.twin.profile import load_profile

    cameras = ("left_wide", "right_wide")
    seen = []
    for scene in SCENES:
        with Twin(load_profile("paper"), scene=scene) as twin:
            twin.place_object(np.array([0.43, -0.02, -0.08]))
            twin.advance(0.5, twin.posture(np.zeros(4)))
            seen.append(twin.capture(("left_wide",)).images["left_wide"])
            if scene != "room":
                continue
            twin.advance(1.0, twin.posture(eye_angles("divergent", np.array(18.0))))
            images, angles = twin.capture(cameras).images, twin.true_angles()[3:]
            pair = rectify(twin.truth, angles)
            left, right = (images[name] for name in cameras)
            found = dense_depth(pair, left, right)
            draw_depth(found.image, rectified_image(pair.right, right), found.depth_m)
    canvas, all_axes = panels(3, "The left wide camera's view", columns=3)
    for axes, image, title in zip(all_axes, seen, SCENES.values(), strict=True):
        axes.imshow(image)
        axes.set_title(title, fontsize=11, loc="left")
        axes.set_axis_off()
    save_picture(canvas, "scenes.png")


def draw_depth(left: np.ndarray, right: np.ndarray, depth_m: np.ndarray) -> None:
    """Draw a rectified pair and the depth (H, W) [m] of its left view, with a scale of colours."""
    canvas, (first, second, third) = panels(3, "A rectified pair, and its depth", columns=3)
    for axes, image, title in (
        (first, left, "left, rectified"),
        (second, right, "right, rectified"),
    ):
        axes.imshow(image, cmap="gray")
        axes.set_title(title, fontsize=11, loc="left")
    nearest, farthest = DEPTH_M
    colours = LogNorm(nearest, farthest)
    shown = third.imshow(depth_m, cmap="turbo_r", norm=colours)
    third.set_facecolor("black")
    third.set_title("depth (black: none)", fontsize=11, loc="left")
    scale = canvas.colorbar(shown, ax=third, label="depth [m]", shrink=0.8)
    plain_log(scale.ax.yaxis)
    for axes in (first, second, third):
        axes.set(xticks=[], yticks=[])
    save_picture(canvas, "dense_depth.png")


def save_picture(canvas: Canvas, name: str) -> None:
    """Write a canvas among the pictures of the documents."""
    save(canvas, IMAGES / name)
    write_small(IMAGES / name, picture(IMAGES / name))


def picture(path: Path) -> np.ndarray:
    """Return an image (H, W, 3), BGR, from a file."""
    image = cv2.imread(str(path))
    if image is None:
        sys.exit(f"There is no picture {path}; the docstring has the commands that make it.")
    return image


def main() -> None:
    parser = argparse.ArgumentParser(description="Make the pictures of the documents.")
    parser.add_argument("--paper", type=Path, help="folder that `vergence reproduce` wrote")
    parser.add_argument("--compared", type=Path, help="folder into which two figures are replayed")
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
