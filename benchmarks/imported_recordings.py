"""Are rests and placements found in recordings in which a person moves the board?

    MUJOCO_GL=egl python benchmarks/imported_recordings.py --recordings 20 --out runs/imported.jsonl

Each recording has a seed of its own: a head with its errors, a session, and readings at a rate of
their own, late and with backlash. It is written as a bag and imported without a map of rests or
placements. Prints what is wrong in each, and how many are right. One takes about a minute; one that
is in the file already is not made again.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tyro

from board_sessions import Session, mistakes, random_session
from vergence.data.description import DatasetJoint
from vergence.data.reader import load_dataset
from vergence.geometry.kinematics import EYE_JOINTS
from vergence.paper.figures import WIDE
from vergence.recordings.bag import message, write_bag
from vergence.recordings.import_recording import import_recording
from vergence.recordings.recording import JointSample, Message
from vergence.recordings.recording_map import CameraSource, RecordingMap
from vergence.twin.calibration_sequence import BOARD, Shot, visible
from vergence.twin.head import Twin
from vergence.twin.profile import ErrorProfile, load_profile

BEGIN_NS = 1_700_000_000_000_000_000
"""Time zero in the recordings [ns]."""
CHANNEL = "/{}/image_raw"
MAP = RecordingMap(
    cameras={
        name: CameraSource(eye, CHANNEL.format(name))
        for name, eye in zip(WIDE, ("left", "right"), strict=True)
    },
    board=BOARD,
    joints={name: DatasetJoint(name, "rad") for name in EYE_JOINTS},
)


@dataclass(frozen=True)
class Config:
    """How many, and where the results go."""

    recordings: int = 20
    first_seed: int = 300
    rests: int = 16
    """Directions of the eyes in each."""
    rate_hz: float = 20.0
    """Of images."""
    out: Path = Path("runs/imported.jsonl")


def profile_of(rng: np.random.Generator) -> ErrorProfile:
    """Draw a head's errors: latency, backlash, noise and gains of its readings."""
    profile = load_profile("noise-only")
    joints = profile.joints.model_copy(
        update={
            "noise_deg": rng.uniform(0.01, 0.2),
            "backlash_deg": rng.choice([0.0, rng.uniform(0.1, 1.0)]),
            "delay_ms": rng.uniform(0.0, 150.0),
            "gain_percent": tuple(rng.uniform(-4, 4, 4).tolist()),
            "offset_deg": tuple(rng.normal(0, 0.5, 4).tolist()),
        }
    )
    return profile.model_copy(update={"joints": joints})


def messages(twin: Twin, session: Session, rate_hz: float) -> Iterator[Message]:
    """Carry out a session, and yield images and readings in order of time."""
    twin.settle(twin.posture(session.joints))
    begin = twin.time_s
    events = [(t, True) for t in np.arange(0, session.end_s, 1 / rate_hz)]
    events += [(t, False) for t in np.arange(0.003, session.end_s, 1 / 97)]
    for t, image in sorted(events):
        twin.advance(begin + t, lambda now: twin.posture(session.joints_at(now - begin)))
        stamp = BEGIN_NS + round(t * 1e9)
        if not image:
            readings = twin.expose(()).frame.eye_angles
            yield message("/joint_states", stamp, JointSample(EYE_JOINTS, readings))
            continue
        twin.place_board(session.board_at(t))
        for name, picture in twin.capture(WIDE).images.items():
            grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
            yield message(CHANNEL.format(name), stamp, grey, received_ns=stamp + 15_000_000)


def one(seed: int, rests: int, rate_hz: float) -> dict[str, Any]:
    """Record, import and judge one recording."""
    rng = np.random.default_rng(seed)
    profile, began = profile_of(rng), time.perf_counter()
    with tempfile.TemporaryDirectory() as folder, Twin(profile, seed=seed) as twin:
        moves = int(rng.integers(3, 7))
        session = random_session(twin.nominal, BOARD, rng, moves=moves, rests=rests)
        bag, place = Path(folder) / "bag", Path(folder) / "dataset"
        write_bag(bag, messages(twin, session, rate_hz))
        recorded = time.perf_counter()
        import_recording(bag, MAP, place)
        imported = time.perf_counter()
        dataset = load_dataset(place)
        time_s = (np.round(dataset.time_s * 1e9) - BEGIN_NS) * 1e-9

        def sees(t: float) -> bool:
            shot = Shot(0, session.board_at(t), session.joints_at(t), WIDE)
            return any(visible(twin.truth, BOARD, name, shot).all() for name in WIDE)

        found = mistakes(
            session, time_s, moving=dataset.moving, number=dataset.placement, sees=sees
        )
    return {
        "seed": seed,
        "moves": moves,
        "seconds": round(session.end_s, 1),
        "rest": int((~dataset.moving).sum()),
        "moving": int(dataset.moving.sum()),
        "placements": len(np.unique(dataset.placement)),
        "joints": profile.joints.model_dump(),
        "wrong_rests": found.rest,
        "wrong_placements": found.placements,
        "recorded_s": round(recorded - began, 1),
        "imported_s": round(imported - recorded, 1),
    }


def main(config: Config) -> int:
    """Make what is missing, print what is wrong, and return 1 if anything is."""
    config.out.parent.mkdir(parents=True, exist_ok=True)
    lines = config.out.read_text().splitlines() if config.out.exists() else []
    done = {row["seed"]: row for row in map(json.loads, lines)}
    wanted = range(config.first_seed, config.first_seed + config.recordings)
    for seed in wanted:
        if seed not in done:
            done[seed] = one(seed, config.rests, config.rate_hz)
            with config.out.open("a") as file:
                file.write(json.dumps(done[seed]) + "\n")
        row = done[seed]
        wrong = [*row["wrong_rests"], *row["wrong_placements"]]
        print(
            f"{seed}: {row['seconds']} s, {row['moves']} moves, {row['rest']} frames at rest, "
            f"{row['moving']} moving, {row['placements']} placements; "
            f"{'; '.join(wrong) or 'right'}",
            flush=True,
        )
    right = sum(not (done[s]["wrong_rests"] or done[s]["wrong_placements"]) for s in wanted)
    print(f"{right} of {len(wanted)} recordings are right.")
    return int(right < len(wanted))


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Config, description=__doc__)))
