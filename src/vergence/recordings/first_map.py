"""Write a first map of a recording: guess its cameras, eyes, joints, units and board.

Each line of the map says whether it is sure or a guess, and why.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np

from vergence.calibration.other_boards import find_board
from vergence.data.images import to_8_bits
from vergence.geometry.board import Charuco
from vergence.geometry.kinematics import EYES, Side
from vergence.recordings.name_words import Motion, NameWords, read_name
from vergence.recordings.pose_tracks import pose_frames
from vergence.recordings.recording import Recording
from vergence.recordings.recording_map import UNKNOWN
from vergence.recordings.scan import Scan
from vergence.vision.exposure import grey_levels

_PROBES = 8
"""Images in which a board is sought; each takes about half a second."""
_LISTED = 20
"""Most joints that are named as not used."""
_PAN_TILT: tuple[Motion, ...] = ("pan", "tilt")
_ICUB = "neck_pitch", "neck_roll", "neck_yaw", "eyes_tilt", "eyes_version", "eyes_vergence"
"""Order of the six joints of an iCub's head, which YARP numbers."""


@dataclass(frozen=True)
class _Joint:
    column: str
    """Its name or, where several channels have it, channel:name."""
    words: NameWords
    unit: str
    reason: str
    """Why it has that unit."""


@dataclass(frozen=True)
class _Camera:
    name: str
    eye: Side
    images: str
    lens: str | None
    reason: str


def first_map(recording: Recording, scanned: Scan) -> str:
    """Guess the map of a scanned recording, as the text of a TOML file."""
    cameras, joints = _cameras(scanned), _joints(scanned)
    eyes = [eye for eye in EYES if any(each.eye == eye for each in cameras)]
    lines = [
        "# A first map of a recording. Correct the guesses that are wrong, and fill in each "
        f"{_text(UNKNOWN)}.",
        *_camera_lines(cameras),
        *_board_lines([*_some_images(recording, scanned, cameras)]),
        *(_joint_lines(joints, eyes) if joints else _pose_lines(recording, eyes)),
    ]
    return "\n".join(lines) + "\n"


def _text(text: str) -> str:
    """Format a string for TOML."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _cameras(scanned: Scan) -> list[_Camera]:
    """Select a channel of images for each camera of an eye."""
    groups: dict[str, list[str]] = {}
    for name in scanned.images.keys() - scanned.errors.keys():
        words = read_name(name)
        if not (words.elsewhere or words.no_picture):
            groups.setdefault(_camera_of(name), []).append(name)
    # As the sensor sees, not rectified, and not compressed where there is both.
    chosen = sorted(
        min(group, key=lambda name: ("rect" in name, name.endswith("/compressed"), name))
        for group in groups.values()
    )
    sided = [name for name in chosen if read_name(name).side]
    found: list[_Camera] = []
    for order, name in enumerate(sided or chosen[: len(EYES)]):
        words = read_name(name)
        eye = words.side or EYES[order]
        reason = "sure: by its name" if words.side else "guess: by the order of the names"
        lens = next((each for each in scanned.lenses if _camera_of(each) == _camera_of(name)), None)
        called = f"{eye}_{'narrow' if words.narrow else 'wide'}"
        same = sum(other.name.startswith(called) for other in found)
        called += f"_{same + 1}" if same else ""
        found.append(_Camera(called, eye, name, lens, reason))
    return found


def _camera_of(channel: str) -> str:
    """Strip the last part of a topic, such as image_raw, and how it is compressed."""
    camera, _, last = channel.removesuffix("/compressed").rpartition("/")
    words = read_name(last)
    return channel if not camera or words.side or words.eye or words.neck else camera


def _camera_lines(cameras: Sequence[_Camera]) -> Iterator[str]:
    for each in cameras or [_Camera("left_wide", "left", UNKNOWN, None, "guess")]:
        yield f"\n[cameras.{each.name}]"
        yield f'eye = "{each.eye}"  # {each.reason}; left and right as the robot\'s own'
        yield f"images = {_text(each.images)}"
        if each.lens:
            yield f"lens = {_text(each.lens)}  # sure: of the same name as the images"


def _some_images(
    recording: Recording, scanned: Scan, cameras: Sequence[_Camera]
) -> Iterator[np.ndarray]:
    """Read images of all cameras, spread over the recording."""
    for each in cameras[:_PROBES]:
        received_ns = scanned.images[each.images].received_ns
        count = -(-_PROBES // len(cameras))
        for at in received_ns[np.linspace(0, len(received_ns) - 1, count + 2).astype(int)[1:-1]]:
            for message in islice(recording.read([each.images], int(at), int(at) + 1), 1):
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
    count = Counter(name for _, name in scanned.joints)
    channels: dict[str, list[str]] = {}
    for channel, name in scanned.joints:
        channels.setdefault(channel, []).append(name)
    found = []
    for channel, names in channels.items():
        yarp = names[0].startswith(f"{channel}/")
        icub = yarp and "head" in channel and len(names) == len(_ICUB)
        words = [read_name(name) for name in (_ICUB if icub else names)]
        values = [scanned.joints[channel, name].values for name in names]
        of_head = [each for each, word in zip(values, words, strict=True) if word.eye or word.neck]
        most = max((float(np.abs(each).max()) for each in of_head), default=0.0)
        unit = "deg" if yarp or most > np.pi else "rad"
        reason = "sure: degrees" if most > 2 * np.pi else f"guess: {unit}"
        for name, word, each in zip(names, words, values, strict=True):
            column = name if count[name] == 1 else f"{channel}:{name}"
            found.append(
                _Joint(column, word, unit, f"{reason}, {each.min():.3g} to {each.max():.3g}")
            )
    return found


def _joint_lines(joints: Sequence[_Joint], eyes: Sequence[Side]) -> list[str]:
    """Describe pan and tilt of each eye, or version and vergence, and the neck."""
    usable = [each for each in joints if not each.words.elsewhere]
    roles = {f"{eye}_{motion}": _role(usable, eye, motion) for eye in eyes for motion in _PAN_TILT}
    version, vergence = (
        next((each for each in usable if each.words.motion == motion), None)
        for motion in ("version", "vergence")
    )
    lines = []
    if version and vergence:
        tilt = next((each for name, (each, _) in roles.items() if each and "tilt" in name), None)
        lines += [
            *_version_lines(version, vergence, tilt or _Joint(UNKNOWN, read_name(""), "rad", ""))
        ]
        used, roles = {version, vergence, tilt}, {}
    else:
        used = {each for each, _ in roles.values()}
    lines.append(
        "\n[joints]  # pan is positive to the left, tilt down; calibrate names wrong signs"
    )
    for name, (each, reason) in roles.items():
        if each:
            lines.append(_joint_line(name, each, reason))
        else:
            lines.append(f'{name} = {{ column = {_text(UNKNOWN)}, unit = "rad", sign = 1 }}')
    for each in usable:
        key = re.sub(r"\W", "_", each.column, flags=re.ASCII)
        if each.words.neck and not each.words.eye and each.words.motion and each not in used:
            lines.append(_joint_line(f"neck_{key}"[:60], each, "guess: a joint of the neck"))
            used.add(each)
    others = [each.column for each in joints if each not in used][:_LISTED]
    return [*lines, *(f"# not used: {_text(column)}" for column in others)]


def _role(joints: Sequence[_Joint], eye: Side, motion: str) -> tuple[_Joint | None, str]:
    """Find the joint that turns an eye, and say how sure it is."""
    ranks: Mapping[str, Callable[[NameWords], bool]] = {
        "sure: by its name": lambda words: words.side == eye and words.eye,
        "guess: it has the side": lambda words: words.side == eye,
        "guess: both eyes share it": lambda words: words.side is None and not words.neck,
        "guess: it carries both eyes": lambda words: words.side is None,
    }
    for reason, fits in ranks.items():
        for each in joints:
            if each.words.motion == motion and fits(each.words):
                return each, reason
    return None, ""


def _joint_line(name: str, joint: _Joint, reason: str) -> str:
    source = f'{{ column = {_text(joint.column)}, unit = "{joint.unit}", sign = 1 }}'
    return f"{name} = {source}  # {reason}; {joint.reason}; guess: sign"


def _version_lines(version: _Joint, vergence: _Joint, tilt: _Joint) -> Iterator[str]:
    """Describe eyes whose common tilt carries their pans, as the iCub's."""
    yield "\n[kinematics]  # guess: the tilt carries the pans; left pan = version - vergence / 2"
    for eye, half in zip(EYES, (-0.5, 0.5), strict=True):
        pan = f"{_text(version.column)} = 1, {_text(vergence.column)} = {half}"
        yield f"{eye} = ["
        yield f'    {{ name = "tilt", axis = "tilt", readings = {{ {_text(tilt.column)} = 1 }} }},'
        yield f'    {{ name = "pan", axis = "pan", readings = {{ {pan} }} }},\n]'
    yield "\n[readings]  # calibrate names wrong signs"
    for each in (version, vergence, tilt):
        yield f'{_text(each.column)} = {{ unit = "{each.unit}", sign = 1 }}  # {each.reason}'


def _pose_lines(recording: Recording, eyes: Sequence[Side]) -> Iterator[str]:
    """Describe poses of the eyes by the frames of a recording without joint readings."""
    parents = pose_frames(recording)
    if not parents:
        yield "\n# There are no joint readings, nor poses of the eyes: record one of both."
    for eye in eyes if parents else ():
        own = [name for name in parents if read_name(name).side == eye and read_name(name).eye]
        roots = [name for name in parents.values() if name not in parents]
        yield f"\n[poses.{eye}]  # guess: by the names of frames"
        yield f"base = {_text((roots or [UNKNOWN])[0])}  # stays where it is in the head"
        yield f"eye = {_text((own or [UNKNOWN])[0])}  # turns with the eye"
