"""Small recordings of two cameras and two joints, written in the documented form of each format."""

from pathlib import Path

import cv2
import numpy as np

START_NS = 1_700_000_000_123_456_000
JOINT_NS = START_NS + np.arange(12) * 10_000_000
IMAGE_NS = START_NS + 15_000_000 + np.arange(4) * 20_000_000
PAN_TILT = np.round(np.random.default_rng(0).normal(0, 10, (12, 2)), 6)
IMAGES = {
    eye: np.random.default_rng(seed).integers(0, 256, (4, 24, 32, 3), dtype=np.uint8)
    for seed, eye in enumerate(("left", "right"))
}
"""By camera (4, 24, 32, 3), RGB."""


def seconds(time_ns: int) -> str:
    return f"{time_ns // 10**9}.{time_ns % 10**9 // 1000:06d}"


def write_image(path: Path, image: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), cv2.cvtColor(image, cv2.COLOR_RGB2BGR))


def write_port(folder: Path, kind: str, lines: list[str], stamp: str = "rx") -> None:
    """Write a folder of yarpdatadumper."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "info.log").write_text(
        f"Type: {kind};\nStamp: {stamp};\n[{seconds(START_NS)}] /icub/{folder.name} [connected]\n"
    )
    (folder / "data.log").write_text("".join(f"{line}\n" for line in lines))


def write_yarp(folder: Path, *, two_stamps: bool = False) -> None:
    """Write a folder of ports: head and two cameras; received 2 ms after it was sent."""

    def stamps(time_ns: int) -> str:
        return seconds(time_ns) + (f" {seconds(time_ns + 2_000_000)}" if two_stamps else "")

    which = "tx+rx" if two_stamps else "rx"
    rows = zip(JOINT_NS.tolist(), PAN_TILT.tolist(), strict=True)
    lines = [f"{k} {stamps(t)} {pan} {tilt}" for k, (t, (pan, tilt)) in enumerate(rows)]
    write_port(folder / "head", "Bottle", lines, which)
    for eye, images in IMAGES.items():
        lines = [f"{7 + k} {stamps(t)} {k:08d}.ppm [rgb]" for k, t in enumerate(IMAGE_NS.tolist())]
        write_port(folder / "cam" / eye, "Image", lines, which)
        for k, image in enumerate(images):
            write_image(folder / "cam" / eye / f"{k:08d}.ppm", image)
