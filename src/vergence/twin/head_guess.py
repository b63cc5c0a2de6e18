"""Complete head.toml from the model: cameras, eyes, joints, neck and directions."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import re
from collections.abc import Collection, Mapping

import mujoco
import numpy as np

from vergence.arrays import Array
from vergence.errors import VergenceError, listed
from vergence.geometry.kinematics import EYES, Side
from vergence.geometry.se3 import cross, inverse, transform
from vergence.twin.designed_head import camera_in_body
from vergence.twin.head_file import CameraFile, HeadFile
from vergence.twin.model_joints import (
    DIGITS,
    ancestors,
    at_rest,
    body_pose,
    is_hinge,
    joints_to,
    model_readings,
)

MIN_EYE_JOINTS, MAX_NECK_JOINTS = 2, 3
"""Minimum number of joints of an eye, if the model has so many, and maximum of a neck."""
APART_M = 0.01
"""Distance across the head from which cameras are of two eyes [m]."""
USUAL_FOV_DEG = 60.0
"""Field of view of a link that is taken for a camera: a URDF states no lens."""
_SIDE: dict[str, Side] = {"left": "left", "l": "left", "right": "right", "r": "right"}
"""Words in the names of the eyes' parts."""
_LINKS = r"optical", r"(^|[_-])(cam(era)?|eye)\d*([_-]|$)"
"""Names of links that are taken for cameras, the surest first."""
OPTICAL = CameraFile(forward=np.array([0.0, 0.0, 1.0]), up=np.array([0.0, -1.0, 0.0]))
"""Axes of an optical frame by REP 103."""


def completed(stated: HeadFile, model: mujoco.MjModel) -> HeadFile:
    """Fill in from a compiled model what a description leaves open.

    An eye has its own joints and, if these are fewer than MIN_EYE_JOINTS, shared ones before them;
    the base is the body before, and independent hinges before it are the neck. KeyError of MuJoCo
    for a part that the model does not have; VergenceError if eyes are not found.
    """
    for joint in (*stated.joints, *(stated.neck or ()), *sum(stated.eyes.values(), ())):
        model.joint(joint)
    cameras = dict(stated.cameras) or _cameras(stated, model)
    where = {name: camera_in_body(model, name, camera) for name, camera in cameras.items()}
    paths = {name: _hinges(model, body, stated) for name, (body, _) in where.items()}
    shared = [j for j in next(iter(paths.values())) if all(j in path for path in paths.values())]
    base = stated.base
    if not base:
        own = min(len(path) for path in paths.values()) - len(shared)
        taken = min(len(shared), max(0, MIN_EYE_JOINTS - own))
        first = {path[len(shared) - taken :][0] for path in paths.values()}
        first = {joints[0] for joints in stated.eyes.values() if joints} or first
        before = [ancestors(model, int(model.joint(joint).bodyid[0]))[:-1] for joint in first]
        base = model.body(max(set.intersection(*map(set, before)))).name  # numbered outwards
    fixed = joints_to(model, base)
    inside = {name: [j for j in path if j not in fixed] for name, path in paths.items()}
    data = at_rest(model, {joint for path in paths.values() for joint in path})
    T_base = inverse(body_pose(data, base))
    T = {name: T_base @ body_pose(data, body) for name, (body, _) in where.items()}
    forward, up = _directions(data, base, T, where)
    forward = forward if stated.forward is None else stated.forward
    up = up if stated.up is None else stated.up
    left = cross(up, forward)
    places = {
        n: float(transform(T[n], np.zeros(3) if own is None else own[:3, 3]) @ left)
        for n, (_, own) in where.items()
    }
    sides = _sides(stated, cameras, {path[-1] for path in paths.values()}, places)
    eyes: dict[Side, tuple[str, ...]] = {
        eye: stated.eyes.get(eye, tuple(next(inside[n] for n in cameras if sides[n] == eye)))
        for eye in EYES
        if eye in sides.values()
    }
    free = [j for j in shared if j in fixed and model_readings(model, [j]).names == (j,)]
    update = {
        "base": base,
        "forward": forward,
        "up": up,
        "cameras": {n: c.model_copy(update={"eye": sides[n]}) for n, c in cameras.items()},
        "eyes": eyes,
        "neck": tuple(free[-MAX_NECK_JOINTS:]) if stated.neck is None else stated.neck,
    }
    return stated.model_copy(update=update)


def _hinges(model: mujoco.MjModel, body: str, stated: HeadFile) -> list[str]:
    """List the hinges that move a body; joints of other kinds stand still where eyes are stated."""
    found, other = [], ""
    for joint in joints_to(model, body):
        if is_hinge(model, joint):
            found += [joint] if model_readings(model, [joint]).names else []  # or it is held still
        elif not stated.eyes:
            found, other = [], f" but by {joint}"
    if not found:
        raise VergenceError(
            f"In {stated.model} the camera on {body} is moved by no hinge{other}; the joints of an "
            "eye are hinges (docs/own_head.md)."
        )
    return found


def _cameras(stated: HeadFile, model: mujoco.MjModel) -> dict[str, CameraFile]:
    """Find the cameras that a joint moves or, without any, links whose names are a camera's."""
    fixed = int(mujoco.mjtCamLight.mjCAMLIGHT_FIXED)
    cameras = [model.camera(k) for k in range(model.ncam)]
    names = [
        camera.name
        for camera in cameras
        if camera.mode[0] == fixed and joints_to(model, model.body(camera.bodyid[0]).name)
    ]
    links = [model.body(b).name for b in range(1, model.nbody)]
    for pattern in _LINKS if not model.ncam else ():
        groups: dict[tuple[str, ...], list[str]] = {}
        for name in links:
            if re.search(pattern, name, re.IGNORECASE) and (path := joints_to(model, name)):
                groups.setdefault(tuple(path), []).append(name)
        inner = {path[:n] for path in groups for n in range(len(path))}
        names = names or [min(g, key=len) for path, g in groups.items() if path not in inner]
    if not names:
        raise VergenceError(
            f"{stated.model} has no camera that a joint moves, nor a link that is called a camera "
            "or an eye; add cameras to the model, or name the links under [cameras] in head.toml."
        )
    found = {}
    for name in names:
        plain = re.sub(r"[^A-Za-z0-9_-]", "_", name)[:50]
        plain = plain if plain[0].isalpha() and plain not in EYES else f"camera_{plain}"
        axes = OPTICAL if re.search(_LINKS[0], name) else CameraFile()
        link = axes.model_copy(update={"body": name, "fov_deg": USUAL_FOV_DEG})
        found[plain] = CameraFile(camera=name) if model.ncam else link
    return found


def _directions(
    data: mujoco.MjData,
    base: str,
    bodies: Mapping[str, Array],
    where: Mapping[str, tuple[str, Array | None]],
) -> tuple[Array, ...]:
    """Find where the eyes look and what is up, in the base; `bodies` are poses (4, 4) of carriers.

    Links without axes look across the line between them, with the world's z up, or along its x.
    """
    forward, _, up = body_pose(data, base)[:3, :3]
    places = {_side_of(name): T[:3, 3] for name, T in bodies.items()}
    axes = [(bodies[n] @ own)[:3, :3] for n, (_, own) in where.items() if own is not None]
    if axes:
        _, down, forward = sum(axes, np.zeros((3, 3))).T
        up = -down
    elif {"left", "right"} <= places.keys():
        forward = cross(places["left"] - places["right"], up)
    return tuple(np.round(d / (np.linalg.norm(d) or 1.0), DIGITS) + 0.0 for d in (forward, up))


def _side_of(name: str) -> Side | None:
    """Read from a name which eye it is of; None: neither, or both."""
    words = re.findall("[a-z]+", re.sub("([a-z])([A-Z])", r"\1 \2", name).lower())
    sides: set[Side] = {_SIDE[word] for word in words if word in _SIDE}
    return sides.pop() if len(sides) == 1 else None


def _sides(
    stated: HeadFile,
    cameras: Mapping[str, CameraFile],
    parts: Collection[str],
    places: Mapping[str, float],
) -> dict[str, Side]:
    """Assign eyes to cameras: as stated, by their names, or by their places to the left [m].

    `parts` are the last joints that move cameras.
    """
    sides: dict[str, Side | None] = {
        n: camera.eye or _side_of(camera.camera or n) for n, camera in cameras.items()
    }
    if None not in sides.values() and (len(parts) != 2 or len({*sides.values()}) == 2):
        return {name: side for name, side in sides.items() if side is not None}
    if len(parts) > 2:
        raise VergenceError(
            f"{stated.model} has cameras on {len(parts)} parts: {listed([*cameras])[:300]}; name "
            "those of the two eyes under [cameras] in a head.toml."
        )
    low, high = min(places.values()), max(places.values())
    right = -np.inf if high - low < APART_M else (low + high) / 2
    return {name: EYES[bool(place < right)] for name, place in places.items()}
