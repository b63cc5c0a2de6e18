"""Read an MJCF or a URDF file as a specification whose parts all have names."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import mujoco

from vergence.errors import VergenceError, explain
from vergence.files import read_bytes

MAX_MODEL_BYTES = 16 * 2**20
"""Largest MJCF or URDF file [bytes]; the URDF of a humanoid has 0.2 MB."""
BOUND_MASS_KG, BOUND_INERTIA_KG_M2 = 1e-3, 1e-6
"""Least mass and inertia of a body where MuJoCo misses some; no servo of a head moves less."""
MESHES = (".stl", ".obj", ".msh")
"""Formats of meshes that MuJoCo reads."""


def load_model(path: Path) -> mujoco.MjSpec:
    """Read an MJCF or a URDF file, without meshes of a URDF that MuJoCo does not read.

    VergenceError if the file is missing, too large, or MuJoCo does not load it.
    """
    content = read_bytes(path, MAX_MODEL_BYTES)
    try:
        root = ElementTree.fromstring(content)
        if root.tag == "robot":
            spec = mujoco.MjSpec.from_string(_complete_urdf(root, path))
        else:
            spec = mujoco.MjSpec.from_file(str(path))
        for parts in (spec.bodies, spec.joints, spec.cameras):
            for number, part in enumerate(parts):
                part.name = part.name or f"{type(part).__name__[3:].lower()}_{number}"
        try:
            spec.compile()
        except ValueError:  # perhaps since bodies that move have no mass
            spec.compiler.boundmass, spec.compiler.boundinertia = BOUND_MASS_KG, BOUND_INERTIA_KG_M2
            spec.compiler.balanceinertia = True
            spec.compile()
    except (ElementTree.ParseError, ValueError, mujoco.FatalError) as error:
        raise VergenceError(f"MuJoCo does not load the model {path}: {explain(error)}.") from None
    return spec


def _complete_urdf(root: ElementTree.Element, path: Path) -> str:
    """Change the XML of a URDF to what MuJoCo needs."""
    for link in root.iter("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            for mesh in [*shape.iter("mesh")]:
                file = _mesh_file(mesh.get("filename", ""), path.resolve())
                mesh.set("filename", str(file))
                if file.suffix.lower() not in MESHES:
                    link.remove(shape)
    for stated in root.findall("mujoco"):
        root.remove(stated)
    options = {"fusestatic": "false", "discardvisual": "false", "strippath": "false"}
    ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler", options)
    return ElementTree.tostring(root, encoding="unicode")


def _mesh_file(name: str, path: Path) -> Path:
    """Find a mesh: in the folder of the URDF, or in that of its package above."""
    inside = name.removeprefix("file://").removeprefix("package://")
    without_package = inside.partition("/")[2]
    places = [(above, part) for above in path.parents for part in (inside, without_package)]
    found = (above / part for above, part in places if part and (above / part).is_file())
    return next(found, path.parent / inside)
