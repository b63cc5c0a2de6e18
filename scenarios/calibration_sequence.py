"""The calibration sequence (Sec. II, Fig. 4): show a board, calibrate, compare with the truth.

python scenarios/calibration_sequence.py [--lens 4.0mm] [--profile noise-only]
"""

from pathlib import Path

import cv2
import numpy as np
import tyro

from vergence.cli.options import check_outputs
from vergence.cli.terminal import plain_ending
from vergence.files import whole_file
from vergence.geometry.head import save_head
from vergence.geometry.se3 import angle, inverse
from vergence.paper.figures import Lens
from vergence.twin.calibration_sequence import carry_out, paper_calibration, plan
from vergence.twin.head import Twin
from vergence.twin.profile import load_profile

OUT = Path("runs/calibration")
SHOWN = 6  # views of the fixed board in the picture, as many as in the paper's Fig. 4


def main(out: Path = OUT, profile: str = "ideal", lens: Lens = "2.8mm", seed: int = 0) -> None:
    """Calibrate the twin by the paper's method, and print by how much each camera is off.

    Args:
        out: Folder for calibration.json and sequence.png, a picture of the board at rest.
        profile: Error profile: ideal, paper, noise-only, or a TOML file.
        lens: Focal length of the wide cameras.
        seed: Seed of everything random.
    """
    calibration, picture = out / "calibration.json", out / "sequence.png"
    check_outputs(calibration, picture)
    with Twin(load_profile(profile), seed=seed, lens=lens) as twin:
        found = paper_calibration(twin, seed)
        columns = [
            np.vstack(list(twin.capture(shot.cameras).images.values()))
            for shot in carry_out(twin, plan(twin.nominal, seed)[-SHOWN:])  # of the board at rest
        ]
    save_head(found.head, calibration)
    shown = cv2.resize(np.hstack(columns)[..., ::-1], None, fx=0.4, fy=0.4)
    with whole_file(picture) as path:
        path.write_bytes(cv2.imencode(".png", shown)[1].tobytes())
    for name, camera in found.head.cameras.items():
        true = twin.truth.cameras[name]
        error = inverse(true.T_eye_cam) @ camera.T_eye_cam
        turned, moved = np.degrees(angle(error[:3, :3])), 1e3 * np.linalg.norm(error[:3, 3])
        scale = camera.intrinsics.matrix[0, 0] / true.intrinsics.matrix[0, 0] - 1
        print(f"{name}: {turned:.3f} degrees, {moved:.2f} mm, focal length {100 * scale:+.2f} %")


if __name__ == "__main__":
    with plain_ending("calibration_sequence"):
        tyro.cli(main)
