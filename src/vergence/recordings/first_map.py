"""Write a first map of a recording: guess its cameras, eyes, joints and units.

Each line of the map says whether it is sure or a guess, and why.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from vergence.geometry.kinematics import EYES
from vergence.recordings.recording_map import UNKNOWN
from vergence.recordings.scan import Scan

_MEANINGS = {
    "left": "left l lft",
    "right": "right r rgt",
    "pan": "pan yaw azimuth",
    "tilt": "tilt pitch elevation",
    "roll": "roll",
    "eye": "eye eyes eyeball camera cameras cam stereo",
    "neck": "neck head face",
    "narrow": "narrow fovea foveal tele zoom",
    "no": "arm wrist hand gripper finger thumb elbow shoulder leg hip knee ankle foot wheel torso "
    "waist base third external depth disparity mask segmentation label confidence thermal",
}
"""Meanings of words; "no": neither an eye's, nor a picture."""
_TURNS = "pan", "tilt"
_BOARD = f"""
[board]  # or another kind, as in docs/dataset.md; leave it out if no board is shown
kind = "chessboard"
columns = "{UNKNOWN}"  # corners inside the board
rows = "{UNKNOWN}"
square_m = "{UNKNOWN}"  # the side of a square [m], measured"""
_WORDS = {word: meaning for meaning, words in _MEANINGS.items() for word in words.split()}


def first_map(scanned: Scan) -> str:
    """Guess the map of a scanned recording, as the text of a TOML file."""
    cameras = _cameras(scanned)
    eyes = [eye for eye in EYES if any(eye in name for name in cameras)]
    lines = ['# A first map. Correct the guesses that are wrong, and fill in each "?".']
    for name, (channel, reason) in cameras.items():
        lines += [f"\n[cameras.{name}]", f"images = {_text(channel)}"]
        lines += [f'eye = "{name.partition("_")[0]}"  # {reason}; left as the robot\'s own']
        lenses = [lens for lens in scanned.lenses if _camera_of(lens) == _camera_of(channel)]
        lines += [f"lens = {_text(lens)}  # sure: of the same name" for lens in lenses[:1]]
    lines += [_BOARD, *_joint_lines(scanned, eyes)]
    return "\n".join(lines) + "\n"


def _text(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _cameras(scanned: Scan) -> dict[str, tuple[str, str]]:
    """Select a channel of images for each camera, and say how sure its eye is."""
    groups: dict[str, list[str]] = {}
    for channel in sorted(scanned.images.keys() - scanned.errors.keys()):
        if "no" not in _read_name(channel):
            groups.setdefault(_camera_of(channel), []).append(channel)
    # As the sensor sees, not rectified, and not compressed where there is both.
    chosen = [min(names, key=lambda name: ("rect" in name, len(name))) for names in groups.values()]
    sides = {name: side for name in chosen for side in EYES if side in _read_name(name)}
    reason = "sure: by its name" if sides else "guess: by the order of names"
    cameras = {}
    for channel, side in (sides or dict(zip(chosen, EYES, strict=False))).items():
        name = f"{side}_{'narrow' if 'narrow' in _read_name(channel) else 'wide'}"
        same = sum(other.startswith(name) for other in cameras)
        cameras[f"{name}_{same + 1}" if same else name] = channel, reason
    return cameras or {"left_wide": (UNKNOWN, "guess")}


def _camera_of(channel: str) -> str:
    """Strip the last part of a topic, such as image_raw, and how it is compressed."""
    camera, _, last = channel.removesuffix("/compressed").rpartition("/")
    return camera if camera and (last == "camera_info" or not _read_name(last)) else channel


def _joint_lines(scanned: Scan, eyes: Sequence[str]) -> Iterator[str]:
    """Describe pan and tilt of each eye, and the joints of the neck."""
    if not scanned.joints:
        yield "\n# No joint readings: name frames of TF that turn with the eyes, as poses."
        return
    yield "\n[joints]  # pan is positive to the left, tilt down; calibrate names wrong signs"
    count = Counter(name for _, name in scanned.joints)
    joints, ends = dict[str, frozenset[str]](), dict[str, tuple[float, float]]()
    for (channel, name), track in scanned.joints.items():
        column = name if count[name] == 1 else f"{channel}:{name}"
        if "no" not in (words := _read_name(name)):
            joints[column] = words
        ends[column] = float(track.values.min()), float(track.values.max())
    of_head = [max(map(abs, ends[c])) for c, words in joints.items() if words & {"eye", "neck"}]
    unit = "deg" if max(of_head, default=0.0) > np.pi else "rad"
    roles = {f"{eye}_{turn}": _turning(joints, eye, turn) for eye in eyes for turn in _TURNS}
    for column, words in joints.items():
        if "neck" in words and words & {*_TURNS, "roll"} and column not in roles.values():
            name = re.sub(r"\W", "_", column, flags=re.ASCII)[:50]
            roles[name if re.match("neck|head", name) else f"neck_{name}"] = column
    for name, column in roles.items():
        sure = {"eye", *name.split("_")} <= joints.get(column, set())
        read = f", {ends[column][0]:.3g} to {ends[column][1]:.3g}" if column in ends else ""
        source = f'column = {_text(column)}, unit = "{unit}", sign = 1'
        yield f"{name} = {{ {source} }}  # {'sure' if sure else 'guess'}; guess: sign, {unit}{read}"


def _turning(joints: Mapping[str, frozenset[str]], eye: str, turn: str) -> str:
    """Choose the joint that turns an eye, or else one that both eyes share."""

    def unlikely(column: str) -> tuple[bool, ...]:
        return eye not in joints[column], "neck" in joints[column], "eye" not in joints[column]

    others = {*EYES} - {eye}
    usable = [column for column, words in joints.items() if turn in words and not words & others]
    return min(usable, key=unlikely, default=UNKNOWN)


def _read_name(name: str) -> frozenset[str]:
    """Find the meanings in a name such as `/stereo/left/image_raw`, `l_eye_pan` or `EyesTilt`."""
    spaced = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", name)
    words = re.findall(r"[a-z]+", spaced.lower())
    return frozenset(_WORDS[word] for word in words if word in _WORDS)
