"""Heads for the twin by their head.toml: the default one with other joints, and others."""

from __future__ import annotations

from pathlib import Path

from vergence.twin.head_file import models_folder
from vergence.twin.head_model import HeadModel, load_head_model

_OTHER_JOINTS = """
model = "{models}/cbi_head/cbi_head.xml"
[eyes]
left = {left}
right = {right}
"""
_ADDED = """
[joints.{eye}_{name}]
body = "{eye}_eye"
axis = {axis}
range_deg = [-30, 30]
"""
_AXES = {"lift": [0, 1, 0], "swing": [0, 0, 1], "twist": [1, 0, 0]}
_ON_A_NECK = """<mujoco><worldbody>
  <body name="mount" pos="0 0 1"><geom size="0.02"/>
    <body name="turntable" pos="0 0 0.1"><joint name="turn" axis="0 0 1" range="-60 60"/>
      <geom size="0.02"/>
      <body name="bar" pos="0.03 0 0.05"><joint name="nod" axis="0 1 0" range="-20 40"/>
        <geom size="0.02" pos="-0.03 0 0"/>{cameras}
      </body></body></body>
</worldbody></mujoco>"""
_CAMERA = '<camera name="{}" pos="0.01 {} 0" xyaxes="0 -1 0 0 0 1" fovy="55"/>'


def _other(*names: str) -> str:
    eyes = {eye: [f"{eye}_{name}" for name in names] for eye in ("left", "right")}
    added = [
        _ADDED.format(eye=eye, name=name, axis=_AXES[name])
        for eye in eyes
        for name in names
        if name in _AXES
    ]
    return _OTHER_JOINTS.format(models=models_folder(), **eyes) + "".join(added)


def described_head(kind: str, folder: Path) -> HeadModel:
    """Read one of the heads KINDS; its files are written into a folder."""
    text, cameras = 'model = "head.xml"', ""
    if kind == "default":
        return load_head_model()
    if kind == "shared tilt":
        text = f'model = "{models_folder()}/shared_tilt_head/shared_tilt_head.xml"'
    elif kind == "tilt before pan":
        text = _other("lift", "swing")
    elif kind == "with roll":
        text = _other("pan", "tilt", "twist")
    elif kind == "pair on a neck":
        cameras = _CAMERA.format("port", 0.04) + _CAMERA.format("starboard", -0.04)
    else:
        cameras = _CAMERA.format("eye", 0.0)
    (folder / "head.toml").write_text(text)
    (folder / "head.xml").write_text(_ON_A_NECK.format(cameras=cameras))
    return load_head_model(folder / "head.toml")


KINDS = "default", "shared tilt", "tilt before pan", "with roll", "pair on a neck", "one eye"
