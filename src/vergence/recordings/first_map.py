"""Write a first map of a recording: guess its cameras, eyes, joints, units and board.

Each line of the map says whether it is sure or a guess, and why.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
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
    "version": "version vers",
    "vergence": "vergence verg",
    "eye": "eye eyes eyeball camera cameras cam stereo",
    "neck": "neck head face",
    "narrow": "narrow fovea foveal tele zoom",
    "no": "arm wrist hand gripper finger thumb elbow shoulder leg hip knee ankle foot wheel torso "
    "waist base third external depth disparity mask segmentation label confidence thermal",
}
"""Meanings of words; "no": neither an eye's, nor a picture."""
_WORDS = {word: meaning for meaning, words in _MEANINGS.items() for word in words.split()}
_ICUB = "neck_pitch", "neck_roll", "neck_yaw", "eyes_tilt", "eyes_version", "eyes_vergence"
"""Order of the six joints of an iCub's head, which YARP numbers."""


@dataclass(frozen=True)
class _Joint:
    column: str = UNKNOWN
    words: frozenset[str] = frozenset()
    unit: str = "rad"
    reason: str = "guess"


def first_map(recording: Recording, scanned: Scan) -> str:
    """Guess the map of a scanned recording, as the text of a TOML file."""
    cameras, joints = _cameras(scanned), _joints(scanned)
    lines = ['# A first map. Correct the guesses that are wrong, and fill in each "?".']
    for name, (channel, reason) in cameras.items():
        lines += [f"\n[cameras.{name}]", f"images = {_text(channel)}"]
        lines += [f'eye = "{name.partition("_")[0]}"  # {reason}; left as the robot\'s own']
        lenses = [lens for lens in scanned.lenses if _camera_of(lens) == _camera_of(channel)]
        lines += [f"lens = {_text(lens)}  # sure: of the same name" for lens in lenses[:1]]
    channels = [channel for channel, _ in cameras.values()]
    lines += _board_lines([*_some_images(recording, scanned, channels)])
    lines += _joint_lines(joints, [eye for eye in EYES if any(eye in name for name in cameras)])
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


def _joints(scanned: Scan) -> list[_Joint]:
    """Describe the joints; two channels may have joints of one name."""
    count, found = Counter(name for _, name in scanned.joints), []
    for channel in dict.fromkeys(channel for channel, _ in scanned.joints):
        names = [name for owner, name in scanned.joints if owner == channel]
        yarp = names[0].startswith(f"{channel}/")  # numbers of its vectors
        icub = yarp and "neck" in _read_name(channel) and len(names) == len(_ICUB)
        words = [_read_name(name) for name in (_ICUB if icub else names)]
        values = [scanned.joints[channel, name].values for name in names]
        of_head = [each for each, has in zip(values, words, strict=True) if has & {"eye", "neck"}]
        most = max((float(np.abs(each).max()) for each in of_head), default=0.0)
        unit = "deg" if yarp or most > np.pi else "rad"
        reason = f"{'sure' if most > 2 * np.pi else 'guess'}: {unit}"
        for name, has, each in zip(names, words, values, strict=True):
            column = name if count[name] == 1 else f"{channel}:{name}"
            span = f"{reason}, {each.min():.3g} to {each.max():.3g}"
            found.append(_Joint(column, has, unit, span))
    return found


def _joint_lines(joints: Sequence[_Joint], eyes: Sequence[str]) -> Iterator[str]:
    """Describe pan and tilt of each eye, or version and vergence, and the neck."""
    if not joints:
        yield "\n# No joint readings: name frames of TF that turn with the eyes, as poses."
        return
    usable = [each for each in joints if "no" not in each.words]
    roles = {f"{eye}_{motion}": (eye, motion) for eye in eyes for motion in ("pan", "tilt")}
    found = {role: _turning(usable, *way) for role, way in roles.items()}
    version = [each for each in usable if each.words & {"version", "vergence"}]
    if len(version) == 2:
        version.sort(key=lambda each: "vergence" in each.words)
        version.append(found["left_tilt"][0])
        yield from _version_lines(*version)
        found = {}
    yield "\n[joints]  # pan is positive to the left, tilt down; calibrate names wrong signs"
    taken = [*version, *(each for each, _ in found.values())]
    for each in usable:
        if "neck" in each.words and each.words & {"pan", "tilt", "roll"} and each not in taken:
            name = re.sub(r"\W", "_", each.column, flags=re.ASCII)[:50]
            name = name if re.match("neck|head", name) else f"neck_{name}"
            found[name] = each, "guess: a joint of the neck"
    for name, (joint, reason) in found.items():
        source = f'column = {_text(joint.column)}, unit = "{joint.unit}", sign = 1'
        yield f"{name} = {{ {source} }}  # {reason}; {joint.reason}; guess: sign"


def _turning(joints: Sequence[_Joint], eye: str, motion: str) -> tuple[_Joint, str]:
    own = [each for each in joints if motion in each.words]
    mine = [each for each in own if eye in each.words]
    shared = [each for each in own if not each.words & set(EYES)]
    shared.sort(key=lambda each: ("neck" in each.words, "eye" not in each.words))
    if mine:
        return mine[0], f"{'sure' if 'eye' in mine[0].words else 'guess'}: by its name"
    return (shared[0], "guess: both eyes share it") if shared else (_Joint(), "no name tells it")


def _version_lines(version: _Joint, vergence: _Joint, tilt: _Joint) -> Iterator[str]:
    """Describe eyes whose common tilt carries their pans, as the iCub's."""
    yield "\n[kinematics]  # guess: the tilt carries the pans; left pan = version - vergence / 2"
    for eye, half in zip(EYES, (-0.5, 0.5), strict=True):
        pan = f"{_text(version.column)} = 1, {_text(vergence.column)} = {half}"
        yield f"{eye} = ["
        for name, factors in ("tilt", f"{_text(tilt.column)} = 1"), ("pan", pan):
            yield f'    {{ name = "{name}", axis = "{name}", readings = {{ {factors} }} }},'
        yield "]"
    yield "\n[readings]  # calibrate names wrong signs"
    for each in (version, vergence, tilt):
        yield f'{_text(each.column)} = {{ unit = "{each.unit}", sign = 1 }}  # {each.reason}'


def _read_name(name: str) -> frozenset[str]:
    """Find the meanings in a name such as `/stereo/left/image_raw`, `l_eye_pan` or `EyesTilt`."""
    spaced = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", name)
    parts = (part for word in re.findall(r"[a-z]+", spaced.lower()) for part in _split(word))
    return frozenset(_WORDS[part] for part in parts if part in _WORDS)


@lru_cache(maxsize=4096)
def _split(word: str) -> tuple[str, ...]:
    """Split a word such as `lpan` or `leftcamera` where all its parts are known."""
    if word not in _WORDS and len(word) <= 40:
        for k in range(len(word) - 1, 0, -1):
            if word[:k] in _WORDS and set(rest := _split(word[k:])) <= _WORDS.keys():
                return (word[:k], *rest)
    return (word,)
