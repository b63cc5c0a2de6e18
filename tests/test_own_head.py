"""The page on an own head: a reader's model finds its eyes, and looks at an object."""

import json
from pathlib import Path

import pytest

from documents import commands, first
from vergence import cli
from vergence.twin.head_model import load_head_model
from vergence.twin.model import compile_head
from vergence.twin.renderer import overscan_sizes

PAGE = "docs/own_head.md"


def test_the_model_of_the_page_is_short_and_its_eyes_are_found(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    model = first(PAGE, "xml")
    assert model.count("\n") <= 40
    Path("eyes.xml").write_text(model)
    (found,) = [words[1:] for words in commands(PAGE) if words[1] == "head"]
    report = cli.parsed(found[:2])()
    assert report.data["eyes"] == {
        "left": ("left_pan", "left_tilt"), "right": ("right_pan", "right_tilt")
    }  # fmt: skip
    assert report.data["disagreement"] < 1e-9


def test_the_description_of_the_page_describes_a_head(tmp_path):
    turn = '<joint name="{0}_pan" axis="0 0 1"/><geom size="0.01"/>'
    link = f'<body name="{{0}}" pos="0 {{1}} 0">{turn}</body>'
    eyes = link.format("l_eye", 0.03) + link.format("r_eye", -0.03)
    (tmp_path / "robot.urdf").write_text(f"<mujoco><worldbody>{eyes}</worldbody></mujoco>")
    (tmp_path / "head.toml").write_text(first(PAGE, "toml"))
    of = load_head_model(tmp_path / "head.toml")
    assert of.designed.cameras == {"left_camera": "l_eye", "right_camera": "r_eye"}
    assert of.designed.head.cameras["right_camera"].intrinsics.width == 640


@pytest.mark.parametrize("kv", [0.0, 0.02])
def test_servos_that_would_swing_are_replaced(tmp_path, kv: float):
    names = [f"{eye}_{joint}" for eye in ("left", "right") for joint in ("pan", "tilt")]
    servos = "".join(f'<position joint="{name}" kp="0.4" kv="{kv}"/>' for name in names)
    model = first(PAGE, "xml").replace("</mujoco>", f"<actuator>{servos}</actuator></mujoco>")
    (tmp_path / "eyes.xml").write_text(model)
    of = load_head_model(tmp_path / "eyes.xml")
    head = of.designed.head
    compiled = compile_head(of, head, overscan_sizes(head))
    assert (compiled.actuator_gainprm[:, 0] == 0.4).all() == (kv > 0)
    assert (compiled.actuator_biasprm[:, 2] < 0).all()


@pytest.mark.render
@pytest.mark.slow
@pytest.mark.usefixtures("few_views")
def test_the_commands_of_the_page_let_the_eyes_look(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("eyes.xml").write_text(first(PAGE, "xml"))
    typed = {words[1]: words[1:] for words in commands(PAGE) if words[0] == "vergence"}
    cli.parsed(typed["head"])()
    fewer = ["1" if word == "3" else word for word in typed["foveate"]]
    cli.parsed(fewer)()
    found = json.loads(Path("runs/foveate/foveate.json").read_text())
    assert found["lost"] == 0
    assert found["median_px"] < 0.2
    cli.parsed(["12" if word == "60" else word for word in typed["record"]])()
    described = json.loads(Path("my_head/dataset.json").read_text())
    assert set(described["cameras"]) == {"left_camera", "right_camera"}
