"""How much longer a replay takes than rendering its frames.

Prints the time of a replay - physics, rendering, distortion, noise, detection, stereo and
recording - divided by the time of rendering the same frames bare with mujoco.Renderer in the same
run: the same cameras, sizes and postures, as many pictures, and nothing else. The median of
several rounds, which alternate so that a busy machine slows both.

    python benchmarks/replay.py [--samples 200] [--rounds 3]
"""

# pyright: reportAttributeAccessIssue=false
import tempfile
import time
from pathlib import Path

import numpy as np
import tyro

from vergence.accuracy.motions import eye_angles
from vergence.arrays import Array
from vergence.geometry.kinematics import EYE_JOINTS
from vergence.paper.figures import FIGURES, WIDE, default_duration_s
from vergence.paper.replay import SAMPLES, sample_times
from vergence.paper.reproduce import SAMPLES_WITH_IMAGES, record_replay
from vergence.twin.head import Twin
from vergence.twin.profile import load_profile
from vergence.twin.renderer import overscan_sizes

FIGURE = FIGURES[6]
PROFILE = load_profile("ideal")


def bare_seconds(twin: Twin, times_s: Array) -> float:
    """Return how long the same frames take with nothing but MuJoCo's renderer."""
    import mujoco  # after vergence.twin, which chooses its OpenGL

    model, data = twin.model, mujoco.MjData(twin.model)
    sizes = overscan_sizes(twin.truth)
    eyes = [model.joint(name).qposadr[0] for name in EYE_JOINTS]
    angles = eye_angles(FIGURE.motion, times_s)
    every = max(1, len(times_s) // SAMPLES_WITH_IMAGES)
    renderers = {s: mujoco.Renderer(model, height=s[1], width=s[0]) for s in set(sizes.values())}
    start = time.perf_counter()
    for index, posture in enumerate(angles):
        data.qpos[eyes] = posture
        mujoco.mj_forward(model, data)
        for name in twin.truth.cameras if index % every == 0 else WIDE:
            renderers[sizes[name]].update_scene(data, camera=name)
            renderers[sizes[name]].render()
    seconds = time.perf_counter() - start
    for renderer in renderers.values():
        renderer.close()
    return seconds


def replay_seconds(twin: Twin, times_s: Array, folder: Path) -> float:
    """Return how long a replay of the figure takes, with its recording."""
    start = time.perf_counter()
    record_replay(twin, twin.truth, FIGURE, times_s, folder / "replay.rrd")
    return time.perf_counter() - start


def main(samples: int = SAMPLES, rounds: int = 3) -> None:
    """Print the ratio.

    Args:
        samples: of a replay.
        rounds: of each; the median counts.
    """
    times = sample_times(FIGURE, None, samples / default_duration_s(FIGURE.motion))
    bare, full = [], []
    with Twin(PROFILE) as twin, tempfile.TemporaryDirectory() as folder:
        for _ in range(rounds):
            bare.append(bare_seconds(twin, times))
            full.append(replay_seconds(twin, times, Path(folder)))
    ratio = np.median(full) / np.median(bare)
    print(f"bare rendering {np.median(bare):.2f} s, replay {np.median(full):.2f} s")
    print(f"replay / bare rendering of the same frames: {ratio:.2f}")


if __name__ == "__main__":
    tyro.cli(main)
