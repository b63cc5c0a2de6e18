"""Write a first map of a recording: guess its cameras, eyes, joints, units and board.

Each line of the map says whether it is sure or a guess, and why.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import islice

import numpy as np

from vergence.calibration.other_boards import find_board
from vergence.data.images import to_8_bits
from vergence.geometry.board import Charuco
from vergence.geometry.kinematics import EYES
from vergence.recordings.recording import Recording
from vergence.recordings.recording_map import UNKNOWN
from vergence.recordings.scan import Scan
from vergence.vision.exposure import grey_levels

_PROBES = 8
"""Images in which a board is sought; each takes about half a second."""
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
_WORDS = {word: meaning for meaning, words in _MEANINGS.items() for word in words.split()}


def first_map(recording: Recording, scanned: Scan) -> str:
    """Guess the map of a scanned recording, as the text of a TOML file."""
    cameras = _cameras(scanned)
    lines = ['# A first map. Correct the guesses that are wrong, and fill in each "?".']
    for name, (channel, reason) in cameras.items():
        lines += [f"\n[cameras.{name}]", f"images = {_text(channel)}"]
        lines += [f'eye = "{name.partition("_")[0]}"  # {reason}; left as the robot\'s own']
        lenses = [lens for lens in scanned.lenses if _camera_of(lens) == _camera_of(channel)]
        lines += [f"lens = {_text(lens)}  # sure: of the same name" for lens in lenses[:1]]
    channels = [channel for channel, _ in cameras.values()]
    lines += _board_lines([*_some_images(recording, scanned, channels)])
    lines += _joint_lines(scanned, [eye for eye in EYES if any(eye in name for name in cameras)])
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
    chosen = [min(each, key=lambda name: ("rect" in name, len(name))) for each in groups.values()]
    sides = {name: side for name in chosen for side in EYES if side in _read_name(name)}
    reason = "sure: by its name" if sides else "guess: by the order of names"
    found = {}
    for channel, side in (sides or dict(zip(chosen, EYES, strict=False))).items():
        name = f"{side}_{'narrow' if 'narrow' in _read_name(channel) else 'wide'}"
        same = sum(other.startswith(name) for other in found)
        found[f"{name}_{same + 1}" if same else name] = channel, reason
    return found or {"left_wide": (UNKNOWN, "guess")}


def _camera_of(channel: str) -> str:
    """Strip the last part of a topic, such as image_raw, and how it is compressed."""
    camera, _, last = channel.removesuffix("/compressed").rpartition("/")
    return camera if camera and (last == "camera_info" or not _read_name(last)) else channel


def _some_images(
    recording: Recording, scanned: Scan, channels: Sequence[str]
) -> Iterator[np.ndarray]:
    """Read images of all channels, spread over the recording."""
    for channel in scanned.images.keys() & channels:
        received_ns = scanned.images[channel].received_ns
        count = -(-_PROBES // len(channels))
        for at in received_ns[np.linspace(0, len(received_ns) - 1, count + 2).astype(int)[1:-1]]:
            for message in islice(recording.read([channel], int(at), int(at) + 1), 1):
                content = message.decode()
                assert isinstance(content, np.ndarray)
                yield grey_levels(to_8_bits(content))


def _board_lines(images: Sequence[np.ndarray]) -> Iterator[str]:
    found = find_board(images)
    if found is None:
        yield f"\n# {len(images)} images show no board. To calibrate, describe one, such as:"
        yield '# [board]\n# kind = "chessboard"\n# columns = 9\n# rows = 6\n# square_m = 0.03'
        return
    board, count = found
    yield f"\n[board]  # {'sure' if count > 1 else 'guess'}: in {count} of {len(images)} images"
    yield f"kind = {_text(board.kind)}"
    if isinstance(board, Charuco):
        yield f"squares_x = {board.squares_x}\nsquares_y = {board.squares_y}"
        yield f"dictionary = {_text(board.dictionary)}\nlegacy = {str(board.legacy).lower()}"
        yield f"marker_m = {_text(UNKNOWN)}  # the side of a marker [m], measured"
    else:
        yield f"columns = {board.columns}  # corners inside the board\nrows = {board.rows}"
    yield f"square_m = {_text(UNKNOWN)}  # the side of a square [m], measured; no image shows it"


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
