"""Complete head.toml from the model: cameras, eyes, joints, neck and directions."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations

import mujoco
import numpy as np

from vergence.arrays import Array
from vergence.errors import VergenceError, listed
from vergence.geometry.joints import PARALLEL
from vergence.geometry.kinematics import EYES, Side
from vergence.geometry.se3 import cross
from vergence.twin.designed_head import camera_body, camera_in_body, camera_place
from vergence.twin.head_file import CameraFile, HeadFile
from vergence.twin.model_chain import ancestors, bodies_between, check_open, joints_of, model_chain
from vergence.twin.model_readings import model_readings

NECK_JOINTS = 3
"""Most joints of a neck that is not stated: those before it are the body's."""
SNAP = float(np.cos(np.radians(15)))
"""Cosine of the angle within which a direction is that of an axis of the base: cameras are often
mounted a few degrees off."""
LEAST_COMMON = 0.1
"""Length of the mean of directions (unit vectors) below which they have none in common."""
APART_M = 0.01
"""Distance across the head from which cameras on one part are two eyes [m]."""
USUAL_FOV_DEG = 60.0
"""Field of view of a link that is taken for a camera: a URDF states no lens."""
_SIDE: dict[str, Side] = {"left": "left", "l": "left", "right": "right", "r": "right"}
"""Words in the names of the eyes' parts."""
_LINKS: tuple[tuple[str, CameraFile], ...] = (
    (r"optical", CameraFile(forward=np.array([0.0, 0, 1]), up=np.array([0.0, -1, 0]))),
    (r"cam(era)?\d*([_-]|$)", CameraFile(forward=np.array([1.0, 0, 0]), up=np.array([0.0, 0, 1]))),
    (r"(^|[_-])eye\d*([_-]|$)", CameraFile()),
)
"""Names of links that are cameras, the surest first, and their axes by REP 103."""


def completed(stated: HeadFile, model: mujoco.MjModel) -> HeadFile:
    """Fill in from a compiled model what a description leaves open.

    An eye has its own joints and, if these turn about fewer than two axes, the joints before them,
    which both eyes share. The base is the body before them, and up to NECK_JOINTS independent
    hinges before it are the neck. VergenceError if the model has no such cameras, joints or bodies,
    or leaves open which cameras are the eyes'.
    """
    _check_names(stated, model)
    cameras = dict(stated.cameras) or _found_cameras(stated, model)
    paths = {n: _hinges(model, camera_body(model, n, c), stated) for n, c in cameras.items()}
    base = _base(model, list(paths.values()), stated.eyes) if stated.base is None else stated.base
    beyond = {name: [j for j in path if _is_beyond(model, base, j)] for name, path in paths.items()}
    if not stated.eyes:
        for body in {camera_body(model, name, camera) for name, camera in cameras.items()}:
            check_open(model, bodies_between(model, model.body(base).id, model.body(body).id))
    bodies = {
        name: model_chain(model, base, camera_body(model, name, camera), beyond[name]).T_base_end
        for name, camera in cameras.items()
    }
    filled = stated.model_copy(update={"base": base, "cameras": cameras})
    forward, up = _directions(model, filled, bodies)
    parts = {name: path[-1] for name, path in paths.items()}
    places = {n: T[:3, :3] @ camera_place(model, n, cameras[n]) for n, T in bodies.items()}
    left = {n: float(np.cross(up, forward) @ (places[n] + T[:3, 3])) for n, T in bodies.items()}
    cameras = _with_eyes(filled, parts, left)
    if not stated.cameras:  # the first one of either eye, then the second ones
        turn = {
            n: [k for k in cameras if cameras[k].eye == cameras[n].eye].index(n) for n in cameras
        }
        cameras = dict(sorted(cameras.items(), key=lambda each: turn[each[0]]))
    eyes: dict[Side, tuple[str, ...]] = {
        camera.eye: tuple(beyond[name]) for name, camera in reversed(cameras.items()) if camera.eye
    }
    neck = [
        joint
        for joint in next(iter(paths.values()))
        if all(joint in path and joint not in beyond[name] for name, path in paths.items())
        and model_readings(model, [joint]).names == (joint,)
    ]
    update = {
        "cameras": cameras,
        "forward": forward,
        "up": up,
        "eyes": {eye: stated.eyes.get(eye, eyes[eye]) for eye in EYES if eye in eyes},
        "neck": tuple(neck[-NECK_JOINTS:]) if stated.neck is None else stated.neck,
    }
    return filled.model_copy(update=update)


def _check_names(stated: HeadFile, model: mujoco.MjModel) -> None:
    """Raise VergenceError for parts that the model does not have."""
    joints = [
        *stated.joints,
        *(stated.neck or ()),
        *(j for eye in stated.eyes.values() for j in eye),
    ]
    bodies = [stated.base, *(camera.body for camera in stated.cameras.values())]
    cameras = [c.camera or name for name, c in stated.cameras.items() if c.body is None]
    for what, wanted, count in (
        ("joint", joints, model.njnt),
        ("body", bodies, model.nbody),
        ("camera", cameras, model.ncam),
    ):
        known = [getattr(model, what)(k).name for k in range(count)]
        for name in wanted:
            if name is not None and name not in known:
                has = f"it has {', '.join(known)}" if known else "it has none"
                raise VergenceError(f"{stated.model} has no {what} {name!r}; {has:.300}.")


def _hinges(model: mujoco.MjModel, body: str, stated: HeadFile) -> list[str]:
    """List the hinges that move a body, from the last joint of another kind before it outwards.

    With stated eyes joints of other kinds stand still, and do not count. VergenceError if there are
    no hinges.
    """
    found: list[str] = []
    other = ""
    for joint in joints_of(model, bodies_between(model, 0, model.body(body).id)):
        name, kind = model.joint(joint).name, mujoco.mjtJoint(int(model.jnt_type[joint]))
        if kind == mujoco.mjtJoint.mjJNT_HINGE:
            if model_readings(model, [name]).names:  # or an equality holds it still
                found.append(name)
        elif not stated.eyes:
            found, other = [], f" but by {name}, a {kind.name[6:].lower()} joint"
    if not found:
        raise VergenceError(
            f"In {stated.model} the camera on {body} is moved by no hinge{other}; the joints of an "
            "eye are hinges. docs/own_head.md shows what other heads need."
        )
    return found


def named_cameras(model: mujoco.MjModel, names: Iterable[str]) -> dict[str, CameraFile]:
    """Describe cameras of a model, or links that are taken for cameras, by their names.

    The axes of a link are those that REP 103 has for its name.
    """
    known, found = {model.camera(k).name for k in range(model.ncam)}, {}
    for name in names:
        plain = re.sub(r"[^A-Za-z0-9_-]", "_", name)[:50]
        plain = plain if plain[0].isalpha() and plain not in EYES else f"camera_{plain}"
        if name in known:
            found[plain] = CameraFile() if name == plain else CameraFile(camera=name)
        else:
            like = (c for pattern, c in _LINKS if re.search(pattern, name, re.IGNORECASE))
            link = {"body": name, "fov_deg": USUAL_FOV_DEG}
            found[plain] = next(like, CameraFile()).model_copy(update=link)
    return found


def _found_cameras(stated: HeadFile, model: mujoco.MjModel) -> dict[str, CameraFile]:
    """Find the cameras that a joint moves or, without any, links whose names are a camera's."""
    fixed, names = int(mujoco.mjtCamLight.mjCAMLIGHT_FIXED), []
    for k in range(model.ncam):
        path = bodies_between(model, 0, int(model.cam_bodyid[k]))
        if model.cam_mode[k] == fixed and joints_of(model, path):
            names.append(model.camera(k).name)
    if model.ncam and not names:
        others = ", ".join(model.camera(k).name for k in range(model.ncam))
        raise VergenceError(
            f"No camera of {stated.model} is carried by a joint, as eyes are; it has {others}."
        )
    links = [model.body(b).name for b in range(1, model.nbody)] if not names else []
    for pattern, _ in _LINKS:
        groups: dict[tuple[int, ...], list[str]] = {}
        for name in links:
            path = tuple(joints_of(model, bodies_between(model, 0, model.body(name).id)))
            if path and re.search(pattern, name, re.IGNORECASE):
                groups.setdefault(path, []).append(name)
        inner = {path[:n] for path in groups for n in range(len(path))}
        outermost = [min(group, key=len) for path, group in groups.items() if path not in inner]
        names = names or outermost
    if not names:
        raise VergenceError(
            f"{stated.model} has no camera that a joint moves, and no link that is called a camera "
            "or an eye; add cameras to the model, or name the links under [cameras] in head.toml."
        )
    return named_cameras(model, names)


def _base(
    model: mujoco.MjModel, paths: Sequence[Sequence[str]], eyes: Mapping[Side, Sequence[str]]
) -> str:
    """Find the body before the joints of the eyes."""
    first = {joints[0] for joints in eyes.values() if joints}
    if not first:
        shared = [joint for joint in paths[0] if all(joint in path for path in paths)]
        axes = _axes(model, {joint for path in paths for joint in path})
        taken = 0
        while taken < len(shared) and not all(
            turns_about_two(axes[joint] for joint in path[len(shared) - taken :]) for path in paths
        ):
            taken += 1
        first = {path[min(len(shared) - taken, len(path) - 1)] for path in paths}
    bodies = [int(model.jnt_bodyid[model.joint(joint).id]) for joint in first]
    above = [set(ancestors(model, int(model.body_parentid[body]))) for body in bodies]
    return model.body(max(set.intersection(*above))).name  # bodies are numbered outwards


def _axes(model: mujoco.MjModel, joints: Iterable[str]) -> dict[str, Array]:
    """Compute the axes (3,) of hinges in the world, as the model stands."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return {joint: data.joint(joint).xaxis.copy() for joint in joints}


def turns_about_two(axes: Iterable[Array]) -> bool:
    """Check whether two of some axes are not parallel."""
    return any(np.linalg.norm(cross(a, b)) > PARALLEL for a, b in combinations(axes, 2))


def _is_beyond(model: mujoco.MjModel, base: str, joint: str) -> bool:
    """Check whether a joint moves a body against a base before it."""
    body = int(model.jnt_bodyid[model.joint(joint).id])
    return model.body(base).id in ancestors(model, body)[:-1]


def _directions(
    model: mujoco.MjModel, stated: HeadFile, bodies: Mapping[str, Array]
) -> tuple[Array, Array]:
    """Find where the eyes look and what is up, in the base, with every joint at zero.

    `bodies` are the poses (4, 4) of the bodies that carry cameras. Links without axes of their own
    look across the line from the right one to the left one, with the model's z up, or along the
    model's x.
    """
    assert stated.base is not None
    hinge = mujoco.mjtJoint.mjJNT_HINGE
    hinges = [model.joint(j).name for j in range(model.njnt) if model.jnt_type[j] == int(hinge)]
    before = model_chain(model, "world", stated.base, hinges)
    forward, _, up = before.T_base_end[:3, :3]
    places = {_side_of(name): bodies[name][:3, 3] for name in stated.cameras}
    axes = [
        (bodies[name] @ camera_in_body(model, name, stated))[:3, :3]
        for name, camera in stated.cameras.items()
        if camera.body is None or (camera.forward is not None and camera.up is not None)
    ]
    if axes:
        _, down, forward = sum(axes, np.zeros((3, 3))).T
        up = -down
        least = LEAST_COMMON * len(axes)
        if stated.forward is None and min(map(np.linalg.norm, (forward, up))) < least:
            raise VergenceError(
                f"The cameras of {stated.model} look in different directions; state where the head "
                "looks, forward and up in head.toml."
            )
    elif {"left", "right"} <= places.keys():
        forward = cross(places["left"] - places["right"], up)
    if min(np.linalg.norm(forward), np.linalg.norm(up)) < LEAST_COMMON * max(len(axes), 1):
        raise VergenceError(
            f"The cameras of {stated.model} look in different directions; state where the head "
            "looks, forward and up in head.toml."
        )
    forward = _snapped(forward) if stated.forward is None else stated.forward
    return forward, _snapped(up) if stated.up is None else stated.up


def _snapped(direction: Array) -> Array:
    """Replace a direction (3,) by the axis of its frame that is near, if one is."""
    direction = direction / np.linalg.norm(direction)
    nearest = np.eye(3)[np.abs(direction).argmax()] * np.sign(direction)
    return (nearest if nearest @ direction > SNAP else direction) + 0.0


def _side_of(name: str) -> Side | None:
    """Read from a name which eye it is of; None: neither, or both."""
    words = re.findall("[a-z]+", re.sub("([a-z])([A-Z])", r"\1 \2", name).lower())
    sides: set[Side] = {_SIDE[word] for word in words if word in _SIDE}
    return sides.pop() if len(sides) == 1 else None


def _with_eyes(
    stated: HeadFile, parts: Mapping[str, str], left: Mapping[str, float]
) -> dict[str, CameraFile]:
    """Tell which eye carries each camera: as stated, by its name, or by its place.

    `parts` are by camera the last joint that moves it, `left` how far to the left it is [m].
    """
    cameras = stated.cameras
    groups = {part: [n for n in cameras if parts[n] == part] for part in parts.values()}
    named = {n: cameras[n].eye or _side_of(n) or _side_of(cameras[n].body or "") for n in cameras}
    if len(groups) > 2 and not all(named.values()):
        moved = listed([f"{', '.join(names)} by {part}" for part, names in groups.items()])
        raise VergenceError(
            f"{stated.model} has cameras on {len(groups)} parts ({moved:.300}); name those of the "
            "two eyes under [cameras] in head.toml, or after --cameras."
        )
    by_name = [{named[n] for n in names} for names in groups.values()]
    if None not in named.values() and (
        len(groups) == 1 or ({"left"} in by_name and {"right"} in by_name)
    ):
        eyes = named
    else:
        places = {n: np.mean([left[k] for k in groups[parts[n]]]) for n in cameras}
        if len(groups) == 1:
            apart = max(left.values()) - min(left.values()) > APART_M
            places = left if apart else dict.fromkeys(cameras, 0.0)
        middle = (max(places.values()) + min(places.values())) / 2
        eyes = {n: "left" if place >= middle else "right" for n, place in places.items()}
    return {
        name: camera.model_copy(update={"eye": camera.eye or eyes[name]})
        for name, camera in cameras.items()
    }
