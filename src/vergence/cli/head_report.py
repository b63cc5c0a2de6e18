"""What `vergence head` found in a model: its report, and its head.toml."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from vergence.cli.report import Report
from vergence.files import markdown_table
from vergence.findings import Finding
from vergence.geometry.joints import Joint
from vergence.geometry.kinematics import EYES

if TYPE_CHECKING:
    from vergence.twin.designed_head import DesignedHead
    from vergence.twin.head_file import HeadFile


def head_report(
    stated: HeadFile, found: DesignedHead, error: float, findings: Sequence[Finding]
) -> Report:
    """Report the eyes, joints and cameras of a head, and what is not sure of them.

    `stated` is complete, `error` is that of `head_checks.disagreement`.
    """
    head = found.head
    joints = [
        (name, f"{eye} eye", _axis(joint.axis), _sum(joint))
        for eye, names in found.eyes.items()
        for name, joint in zip(names, head.kinematics.eyes[eye], strict=True)
    ]
    neck = [
        (name, "neck", _axis(axis), name)
        for name, axis in zip(found.neck, head.neck.axes, strict=True)
    ]
    cameras = [
        (
            name,
            mounted.eye,
            found.cameras[name],
            "{} x {}".format(*mounted.intrinsics.size),
            f"{np.degrees(2 * np.arctan(camera.width / 2 / camera.matrix[0, 0])):.0f}",
        )
        for name, mounted in head.cameras.items()
        for camera in [mounted.intrinsics]
    ]
    agree = f"{error:.0e} (poses of cameras and head at 20 random postures)"
    parts = [
        f"The head is the body {found.base}; its eyes look along {_axis(stated.forward)} of it, "
        f"and {_axis(stated.up)} is up.",
        markdown_table("joint | of | turns about | angle", [*neck, *joints]),
        markdown_table("camera | eye | on body | pixels | field of view [deg]", cameras),
        f"Kinematics and MuJoCo agree to {agree}.",
        *map(str, findings),
    ]
    data = {
        "base": found.base,
        "eyes": dict(found.eyes),
        "neck": list(found.neck),
        "cameras": {name: mounted.eye for name, mounted in head.cameras.items()},
        "readings": list(head.kinematics.readings),
        "disagreement": error,
        "findings": [finding.code for finding in findings],
    }
    return Report("Head of a model", parts, data)


def _axis(direction: np.ndarray | None) -> str:
    """Name a direction by the axis of its frame, or by its components."""
    assert direction is not None
    largest = int(np.abs(direction).argmax())
    if abs(direction[largest]) > 1 - 1e-9:
        return f"{'-+'[int(direction[largest] > 0)]}{'xyz'[largest]}"
    return "({:.3f}, {:.3f}, {:.3f})".format(*direction)


def _sum(joint: Joint) -> str:
    """Write a joint's angle as a sum of readings."""
    terms = [
        f"{'-' if factor < 0 else '+'} {'' if abs(factor) == 1 else f'{abs(factor):.4g} '}{name}"
        for name, factor in joint.readings.items()
    ]
    offset = [f"+ {np.degrees(joint.offset_rad):.4g} deg"] if joint.offset_rad else []
    return " ".join([*terms, *offset]).removeprefix("+ ")


def as_toml(stated: HeadFile, found: DesignedHead) -> str:
    """Format a complete description."""
    coupled = [
        f"# {joint} = {text}"
        for eye in EYES
        for joint, described in zip(
            found.eyes.get(eye, ()), found.head.kinematics.eyes[eye], strict=True
        )
        if (text := _sum(described)) != joint
    ]
    cameras = [
        f"\n[cameras.{_key(name)}]\n" + "\n".join(_pairs(camera.model_dump(exclude_unset=True)))
        for name, camera in stated.cameras.items()
    ]
    lines = [
        "# Written by `vergence head`, from the model alone; docs/own_head.md explains the fields.",
        *_pairs({"model": stated.model}),
        "",
        "# The body that is the head, and where in it the eyes look with all joints at zero.",
        *_pairs({"base": stated.base, "forward": stated.forward, "up": stated.up}),
        "",
        "# Joints of neck and eyes, from the body outwards. Other joints stand still.",
        *_pairs({"neck": stated.neck}),
        *(["", "# The model couples joints to these readings:", *coupled] if coupled else []),
        "",
        "[eyes]",
        *_pairs(stated.eyes),
        *cameras,
    ]
    return "\n".join(lines) + "\n"


def _pairs(values: Mapping[Any, Any]) -> Iterator[str]:
    for key, value in values.items():
        if value is not None:
            plain = np.asarray(value).tolist() if isinstance(value, np.ndarray) else value
            # TOML writes strings, numbers and arrays as JSON does.
            yield f"{_key(key)} = {json.dumps(plain, ensure_ascii=False)}"


def _key(name: str) -> str:
    return name if re.fullmatch("[A-Za-z0-9_-]+", name) else json.dumps(name)
