"""An object moves about and is hidden once; the eyes stay on it, its position is known (Sec. III).

python scenarios/track.py [--profile ideal] [--seconds 20]
"""

from pathlib import Path

import tyro

from vergence.demos.track import track
from vergence.twin.profile import load_profile

OUT = Path("runs/track")


def main(out: Path = OUT, profile: str = "paper", seed: int = 0, seconds: float = 20.0) -> None:
    found = track(seconds=seconds, seed=seed, profile=load_profile(profile), out=out)
    print(f"in both narrow images in {found.in_both:.1%} of {found.frames} frames")
    print(f"distance from their centres: {found.rms_px:.1f} px rms")
    print(
        f"position error: {1e3 * found.position_rms_m:.2f} mm rms, "
        f"{1e3 * found.single_frame_rms_m:.2f} mm by single frames, "
        f"{1e3 * found.wide_rms_m:.2f} mm by the wide images"
    )


if __name__ == "__main__":
    tyro.cli(main)
