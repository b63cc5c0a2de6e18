"""Read an MJCF or a URDF file as a specification that MuJoCo compiles.

A URDF gets what its format leaves open: where package:// paths lie, links that stay although they
do not move, and inertia. Parts without a name get one, so that head.toml can refer to them.
"""

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
"""Least mass and inertia of a body: MuJoCo refuses moving bodies without, and no servo of a head
moves a lighter one."""
MESHES = (".stl", ".obj", ".msh")
"""Formats of meshes that MuJoCo reads."""


def load_model(path: Path) -> mujoco.MjSpec:
    """Read an MJCF or a URDF file.

    Meshes of a URDF in a format that MuJoCo does not read are left out, since only the picture of
    the robot needs them. VergenceError if the file is missing, too large or neither of the two, or
    if MuJoCo does not compile it, as without a mesh.
    """
    try:
        root = ElementTree.fromstring(read_bytes(path, MAX_MODEL_BYTES))
    except ElementTree.ParseError as error:
        raise VergenceError(f"{path} is not XML: {explain(error)}.") from None
    if root.tag not in ("mujoco", "robot"):
        raise VergenceError(
            f"A model is an MJCF (<mujoco>) or a URDF (<robot>); {path} begins with <{root.tag}>."
        )
    try:
        if root.tag == "mujoco":
            spec = mujoco.MjSpec.from_file(str(path))
        else:
            spec = mujoco.MjSpec.from_string(_complete_urdf(root, path))
        spec.compiler.boundmass = max(spec.compiler.boundmass, BOUND_MASS_KG)
        spec.compiler.boundinertia = max(spec.compiler.boundinertia, BOUND_INERTIA_KG_M2)
        spec.compiler.balanceinertia = True
        for parts in (spec.bodies, spec.joints, spec.cameras):
            for number, part in enumerate(parts):
                part.name = part.name or f"{type(part).__name__[3:].lower()}_{number}"
        spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise VergenceError(f"MuJoCo does not load {path}: {explain(error)}.") from None
    return spec


def _complete_urdf(root: ElementTree.Element, path: Path) -> str:
    """Change the XML of a URDF to what MuJoCo needs."""
    if any("xacro" in element.tag for element in root.iter()):
        raise VergenceError(
            f"{path} is a xacro file; make a URDF of it first: xacro {path.name} > head.urdf."
        )
    for link in root.iter("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            for mesh in shape.iter("mesh"):
                file = _resolve(mesh.get("filename", ""), path)
                mesh.set("filename", str(file))
                if file.suffix.lower() not in MESHES:
                    link.remove(shape)
                    break
    settings = root.find("mujoco")
    settings = ElementTree.SubElement(root, "mujoco") if settings is None else settings
    compiler = settings.find("compiler")
    compiler = ElementTree.SubElement(settings, "compiler") if compiler is None else compiler
    wanted = {"fusestatic": "false", "discardvisual": "false"}
    compiler.attrib = wanted | compiler.attrib | {"strippath": "false"}
    return ElementTree.tostring(root, encoding="unicode")


def _resolve(name: str, path: Path) -> Path:
    """Find the file of a mesh: beside the URDF, or in the folder of the package above it."""
    package, _, rest = name.removeprefix("package://").partition("/")
    if not name.startswith("package://"):
        return path.parent.resolve() / name.removeprefix("file://")
    for folder in path.resolve().parents:
        for file in (folder / package / rest, folder / rest):
            if file.is_file():
                return file
    raise VergenceError(
        f"{path} has the mesh {name}, and no folder above it has {package}/{rest}; put the package "
        "there, or give the meshes paths beside the URDF."
    )
