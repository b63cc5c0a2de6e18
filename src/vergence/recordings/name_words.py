"""Read names of channels and joints as words: sides, parts of a robot, and motions."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

from vergence.geometry.kinematics import Side

Motion = Literal["pan", "tilt", "roll", "version", "vergence"]

_SIDES: dict[str, Side] = {
    "left": "left", "l": "left", "lft": "left", "right": "right", "r": "right", "rgt": "right",
}  # fmt: skip
_MOTIONS: dict[str, Motion] = {
    "pan": "pan", "yaw": "pan", "azimuth": "pan", "tilt": "tilt", "pitch": "tilt",
    "elevation": "tilt", "roll": "roll", "swing": "roll", "version": "version",
    "vers": "version", "vergence": "vergence", "verg": "vergence",
}  # fmt: skip
_EYE = {"eye", "eyes", "eyeball", "camera", "cameras", "cam", "stereo"}
_NECK = {"head", "neck", "face"}
_ELSEWHERE = {
    "arm", "wrist", "hand", "gripper", "finger", "thumb", "elbow", "shoulder", "leg", "hip",
    "knee", "ankle", "foot", "wheel", "torso", "waist", "base", "track", "third", "external",
}  # fmt: skip
_NOT_PICTURES = {"depth", "disparity", "mask", "segmentation", "label", "confidence", "thermal"}
_NARROW = {"narrow", "fovea", "foveal", "tele", "zoom"}
_WORDS = _SIDES.keys() | _MOTIONS.keys() | _EYE | _NECK | _ELSEWHERE | _NOT_PICTURES | _NARROW


@dataclass(frozen=True)
class NameWords:
    """What a name says of its thing."""

    side: Side | None
    motion: Motion | None
    eye: bool
    """Whether it names an eye or a camera."""
    neck: bool
    """Whether it names the head or the neck."""
    elsewhere: bool
    """Whether it names another part of a robot."""
    no_picture: bool
    """Whether it names images that show no grey levels."""
    narrow: bool


def read_name(name: str) -> NameWords:
    """Read a name such as `/stereo/left/image_raw`, `l_eye_pan` or `eyesTilt`."""
    spaced = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", name)
    words = [word for part in re.findall(r"[a-z]+", spaced.lower()) for word in _split(part)]
    sides = {_SIDES[word] for word in words if word in _SIDES}
    motions = [_MOTIONS[word] for word in words if word in _MOTIONS]
    return NameWords(
        side=sides.pop() if len(sides) == 1 else None,
        motion=motions[-1] if motions else None,
        eye=not _EYE.isdisjoint(words),
        neck=not _NECK.isdisjoint(words),
        elsewhere=not _ELSEWHERE.isdisjoint(words),
        no_picture=not _NOT_PICTURES.isdisjoint(words),
        narrow=not _NARROW.isdisjoint(words),
    )


@lru_cache(maxsize=4096)
def _split(word: str) -> tuple[str, ...]:
    """Split a word such as `lpan` or `leftcamera` where all its parts are known."""
    if word in _WORDS or len(word) > 40:
        return (word,)
    for k in range(len(word) - 1, 0, -1):
        if word[:k] in _WORDS and set(rest := _split(word[k:])) <= _WORDS:
            return (word[:k], *rest)
    return (word,)
