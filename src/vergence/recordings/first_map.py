"""Write a first map of a recording: guess its cameras, eyes, joints, units and board.

Every line of the map says whether it is sure or a guess, and why.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from vergence.calibration.other_boards import find_board
from vergence.data.images import to_8_bits
from vergence.errors import counted
from vergence.geometry.board import Board, Charuco
from vergence.geometry.kinematics import EYES, Side
from vergence.recordings.listing import ChannelListing, Listing
from vergence.recordings.name_words import Motion, NameWords, read_name
from vergence.recordings.recording_map import MAX_GAP_S, UNKNOWN
from vergence.vision.exposure import grey_levels

_PROBES = 8
"""Images in which a board is sought; each takes about half a second."""
_LISTED = 12
"""Most other joints that the map names."""
_NECK: dict[str, Motion] = {"neck_pitch": "tilt", "neck_roll": "roll", "neck_yaw": "pan"}
_ICUB = "neck_pitch", "neck_roll", "neck_yaw", "eyes_tilt", "eyes_version", "eyes_vergence"
"""Order of the six joints of an iCub's head."""


@dataclass(frozen=True)
class _Joint:
    """A joint of the recording."""

    column: str
    """Its name or, where several channels have it, channel:name."""
    words: NameWords
    low: float
    high: float
    degrees: bool
    unit_reason: str


@dataclass(frozen=True)
class _Camera:
    name: str
    eye: Side
    images: ChannelListing
    lens: str | None
    reason: str


def first_map(listing: Listing) -> str:
    """Guess a map as the text of a TOML file."""
    cameras, joints = _cameras(listing), _joints(listing)
    eyes = [eye for eye in EYES if any(each.eye == eye for each in cameras)]
    lines = [
        f"# A first map of {_plain(listing.path.name)}: each line is sure or a guess, as it says.",
        f"# Correct what is wrong, and fill in each {_text(UNKNOWN)}.",
        *_timing(listing, cameras, joints),
        *_camera_lines(cameras),
        *_board_lines(cameras),
        *(_joint_lines(joints, eyes) or _pose_lines(listing, eyes)),
    ]
    return "\n".join(lines) + "\n"


def _text(text: str) -> str:
    """Format a string for TOML."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _plain(text: str) -> str:
    """Format a name for a comment."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)[:100]


def _cameras(listing: Listing) -> list[_Camera]:
    """Select one channel of images for each camera, and give it an eye."""
    groups: dict[str, list[ChannelListing]] = {}
    for name, each in listing.channels.items():
        words = read_name(name)
        pictures = each.channel.kind == "images" and each.images and not each.error
        if pictures and not (words.elsewhere or words.no_picture):
            groups.setdefault(_camera_of(name), []).append(each)
    chosen = [min(group, key=_preference) for group in groups.values()]
    on_head = [each for each in chosen if _of_head(read_name(each.channel.name))]
    chosen = on_head if len(on_head) >= 2 else chosen
    sides = [read_name(each.channel.name).side for each in chosen]
    found: list[_Camera] = []
    for order, (each, side) in enumerate(zip(chosen, sides, strict=True)):
        name = each.channel.name
        reason = f'sure: "{side}" by its name'
        if side is None:
            if any(sides) or len(chosen) > 2:
                continue  # neither of an eye nor one of a pair
            side, reason = EYES[order], f"guess: {('first', 'second')[order]} of the cameras"
        lens = next(
            (
                other.channel.name
                for other in listing.channels.values()
                if other.lens is not None and _camera_of(other.channel.name) == _camera_of(name)
            ),
            None,
        )
        kind = "narrow" if read_name(name).narrow else "wide"
        same = sum(other.name.startswith(f"{side}_{kind}") for other in found)
        called = f"{side}_{kind}" + (f"_{same + 1}" if same else "")
        found.append(_Camera(called, side, each, lens, reason))
    return found


def _camera_of(channel: str) -> str:
    """Strip the last part of a topic, such as image_raw, and how it is compressed."""
    parts = channel.removesuffix("/compressed").split("/")
    return "/".join(parts[:-1]) if len(parts) > 2 else channel


def _preference(each: ChannelListing) -> tuple[bool, bool, int]:
    """Sort channels of one camera: as the sensor sees, uncompressed, most images."""
    name = each.channel.name
    return "rect" in name, name.endswith("/compressed"), -each.channel.count


def _of_head(words: NameWords) -> bool:
    return words.eye or words.neck or words.side is not None


def _camera_lines(cameras: Sequence[_Camera]) -> Iterator[str]:
    for each in cameras:
        yield f"\n[cameras.{each.name}]"
        yield f'eye = "{each.eye}"  # {each.reason}; left and right as the robot\'s own'
        yield f"images = {_text(each.images.channel.name)}"
        if each.lens:
            yield f"lens = {_text(each.lens)}  # sure: beside the images"
    if not cameras:
        yield "\n# No channel of images can be used."
        yield f"[cameras.left_wide]\neye = {_text(UNKNOWN)}\nimages = {_text(UNKNOWN)}"


def _board_lines(cameras: Sequence[_Camera]) -> Iterator[str]:
    images = [image for each in cameras for image in each.images.images]
    images = images[:: max(1, -(-len(images) // _PROBES))]
    found = find_board([grey_levels(to_8_bits(each)) for each in images])
    if found is None:
        yield f"\n# No board in {counted(len(images), 'image')}: for self-calibration only. To"
        yield "# calibrate, describe one, as in docs/dataset.md:"
        yield '# [board]\n# kind = "chessboard"\n# columns = 9\n# rows = 6\n# square_m = 0.03'
        return
    board, count = found
    yield f"\n[board]\n# {'sure' if count > 1 else 'guess'}: in {count} of {len(images)} images"
    yield from _described(board)
    yield f"square_m = {_text(UNKNOWN)}  # the side of a square [m], measured; no image shows it"


def _described(board: Board) -> Iterator[str]:
    yield f"kind = {_text(board.kind)}"
    if isinstance(board, Charuco):
        yield f"squares_x = {board.squares_x}\nsquares_y = {board.squares_y}"
        yield f"dictionary = {_text(board.dictionary)}"
        yield f"legacy = {str(board.legacy).lower()}"
        yield f"marker_m = {_text(UNKNOWN)}  # the side of a marker [m], measured"
    else:
        yield f"columns = {board.columns}  # corners inside the board\nrows = {board.rows}"


def _joints(listing: Listing) -> list[_Joint]:
    """Describe the joints; two channels may have joints of one name."""
    names = [name for _, name in listing.joints]
    of_channel: dict[str, list[str]] = {}
    for channel, name in listing.joints:
        of_channel.setdefault(channel, []).append(name)
    turned = {
        channel: any(
            max(map(abs, listing.joints[channel, name])) > 2 * np.pi and _of_head(read_name(name))
            for name in own
        )
        for channel, own in of_channel.items()
    }
    found = []
    for (channel, name), (low, high) in listing.joints.items():
        column = name if names.count(name) == 1 else f"{channel}:{name}"
        order = of_channel[channel]
        in_icub = len(order) == len(_ICUB) and "head" in channel and re.search(r"\d$", name)
        words = read_name(_ICUB[order.index(name)] if in_icub else name)
        yarp = "yarp" in listing.channels[channel].channel.type.lower()
        values = f"{low:.3g} to {high:.3g}"
        if max(abs(low), abs(high)) > 2 * np.pi:
            unit = True, f"sure: degrees, {values}"
        elif max(abs(low), abs(high)) > 2.0 and words.eye:
            unit = True, f"guess: degrees, since no eye turns by {values} rad"
        elif turned[channel]:
            unit = True, f"guess: degrees, as others of {_plain(channel)}; {values}"
        elif yarp:
            unit = True, f"guess: degrees, as YARP gives them; {values}"
        else:
            unit = False, f"guess: radians, {values}"
        found.append(_Joint(column, words, low, high, *unit))
    return found


def _joint_lines(joints: Sequence[_Joint], eyes: Sequence[Side]) -> list[str]:
    """Describe pan and tilt of each eye, or version and vergence; empty without joints."""
    if not joints:
        return []
    usable = [each for each in joints if not each.words.elsewhere]
    roles = {
        (eye, motion): _role(usable, eye, motion) for eye in eyes for motion in ("pan", "tilt")
    }
    version = next((each for each in usable if each.words.motion == "version"), None)
    vergence = next((each for each in usable if each.words.motion == "vergence"), None)
    used = {each.column for each, _ in roles.values() if each}
    lines = []
    if version and vergence and len(eyes) == 2:
        used = {version.column, vergence.column}
        tilts = {eye: roles[eye, "tilt"] for eye in eyes}
        lines += _version_lines(version, vergence, tilts)
        used |= {each.column for each, _ in tilts.values() if each}
        lines.append("\n[joints]")
    else:
        lines.append(
            "\n[joints]  # pan is positive to the left, tilt down; calibrate names wrong signs"
        )
        for (eye, motion), (each, reason) in roles.items():
            lines.append(_joint_line(f"{eye}_{motion}", each, reason))
    for name, motion in _NECK.items():
        necks = [
            each
            for each in usable
            if each.words.neck and each.words.motion == motion and each.column not in used
        ]
        if necks:
            lines.append(_joint_line(name, necks[0], "guess by its name"))
            used.add(necks[0].column)
    other = sorted((each for each in joints if each.column not in used), key=_travel)
    lines += [
        f"# not used: {_plain(each.column)}, {each.low:.3g} to {each.high:.3g}"
        for each in other[:_LISTED]
    ]
    if len(other) > _LISTED:
        lines.append(f"# and {len(other) - _LISTED} more, which move less")
    return lines


def _travel(each: _Joint) -> float:
    return each.low - each.high


def _role(joints: Sequence[_Joint], eye: Side, motion: Motion) -> tuple[_Joint | None, str]:
    """Find the joint that turns an eye, and say how sure it is."""
    own = [each for each in joints if each.words.motion == motion]
    ranks = (
        ("sure: its name", lambda words: words.side == eye and words.eye),
        ("guess: its name has the side", lambda words: words.side == eye),
        ("guess: both eyes share it", lambda words: words.side is None and words.eye),
        ("guess: both eyes share it", lambda words: words.side is None and not words.neck),
        ("guess: it carries both eyes", lambda words: words.side is None and words.neck),
    )
    for reason, fits in ranks:
        for each in own:
            if fits(each.words):
                return each, reason
    return None, ""


def _joint_line(name: str, joint: _Joint | None, reason: str) -> str:
    if joint is None:
        return (
            f'{name} = {{ column = {_text(UNKNOWN)}, unit = "rad", sign = 1 }}  # by no name; '
            "without such a joint describe kinematics"
        )
    unit = "deg" if joint.degrees else "rad"
    return (
        f'{name} = {{ column = {_text(joint.column)}, unit = "{unit}", sign = 1 }}  # {reason}; '
        f"{joint.unit_reason}; sign a guess"
    )


def _version_lines(
    version: _Joint, vergence: _Joint, tilts: Mapping[Side, tuple[_Joint | None, str]]
) -> Iterator[str]:
    yield "\n# guess: a tilt that carries the pans; left pan = version - vergence / 2"
    readings = {version.column: version, vergence.column: vergence}
    yield "[kinematics]"
    for eye, sign in zip(EYES, (-0.5, 0.5), strict=True):
        tilt = tilts[eye][0]
        column = UNKNOWN if tilt is None else tilt.column
        if tilt is not None:
            readings[column] = tilt
        yield f"{eye} = ["
        yield f'    {{ name = "tilt", axis = "tilt", readings = {{ {_text(column)} = 1 }} }},'
        yield (
            f'    {{ name = "pan", axis = "pan", readings = {{ {_text(version.column)} = 1, '
            f"{_text(vergence.column)} = {sign} }} }},"
        )
        yield "]"
    yield "\n[readings]  # calibrate names wrong signs"
    for column, joint in readings.items():
        unit = "deg" if joint.degrees else "rad"
        yield f'{_text(column)} = {{ unit = "{unit}", sign = 1 }}  # {joint.unit_reason}'


def _pose_lines(listing: Listing, eyes: Sequence[Side]) -> list[str]:
    """Describe poses of the eyes by frames that the recording has."""
    if not listing.frames:
        return ["\n# No joint readings: a recording of moving eyes has them, or poses of the eyes."]
    frames = {*listing.frames, *listing.frames.values()}
    roots = sorted(frames - set(listing.frames))
    lines = []
    for eye in eyes:
        own = sorted(
            frame for frame in frames if read_name(frame).side == eye and read_name(frame).eye
        )
        base, frame = (roots or [UNKNOWN])[0], (own or [UNKNOWN])[0]
        lines.append(
            f"\n[poses.{eye}]  # guess, among the frames {_plain(', '.join(sorted(frames)))}"
        )
        lines.append(f"base = {_text(base)}  # a frame that stays where it is in the head")
        lines.append(f"eye = {_text(frame)}  # a frame that turns with the eye")
    return lines


def _timing(
    listing: Listing, cameras: Sequence[_Camera], joints: Sequence[_Joint]
) -> Iterator[str]:
    """State the times that count, and the gap between readings."""
    images = [each.images for each in cameras]
    readings = [each for each in listing.channels.values() if each.channel.kind == "joints"]
    frozen = [each for each in (*images, *readings) if _stands_still(each.stamp_ns)]
    apart = not frozen and any(
        a.stamp_ns.max() < b.stamp_ns.min() or b.stamp_ns.max() < a.stamp_ns.min()
        for a in images
        for b in readings
        if len(b.stamp_ns)
    )
    if frozen:
        name = _plain(frozen[0].channel.name)
        yield f'stamps = "received"  # guess: the stamps of {name} stand still'
    elif apart:
        yield 'stamps = "received"  # guess: images and readings are stamped by two clocks'
    period_s = max((each.period_s for each in readings if each.channel.count > 1), default=0.0)
    if joints and 3 * period_s > MAX_GAP_S:
        yield f"max_gap_s = {3 * period_s:.3g}  # guess: readings are {period_s:.3g} s apart"


def _stands_still(stamp_ns: np.ndarray) -> bool:
    return len(stamp_ns) > 2 and float(np.mean(np.diff(stamp_ns) == 0)) > 0.5
