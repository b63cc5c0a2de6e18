"""Arguments of a wrong kind are refused in one sentence by every public function."""

import inspect
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vergence as vg
from recordings import small_dataset
from simulated_head import plain_head
from vergence.gaze.state import GazeSettings
from vergence.geometry.camera import pinhole
from vergence.interchange import kalibr

WRONG = {
    "None": None,
    "a name": "head.json",
    "a Path": Path("head.json"),
    "a number": 3.5,
    "a dictionary": {"a": 1},
    "names": ["a", "b"],
    "something": object(),
    "lists of two lengths": [[1, 2], [3]],
    "complex numbers": np.array([1j, 2]),
    "a class": vg.Camera,
}


@pytest.fixture(scope="module")
def right(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, Any]]:
    """By public function, and class that is checked: arguments that it takes."""
    folder = tmp_path_factory.mktemp("arguments")
    small_dataset(folder)
    head, joints, rng = plain_head(0.09, 280.0), np.zeros(4), np.random.default_rng(0)
    kalibr.save(head, folder / "chain.yaml")
    vg.save_head(head, folder / "head.json")
    points, pair, data = np.array([[0.6, 0.04, 0.0]]), vg.rectify(head, joints), vg.load_dataset
    pixels = {
        side: vg.project_point(head, f"{side}_wide", joints, points) for side in ("left", "right")
    }
    image = np.zeros((480, 640), np.uint8)
    located = {"head": head, **pixels, "joints": joints, "cameras": None}
    located |= {"pixel_std_px": None, "joint_std_rad": None}
    board = vg.Chessboard(columns=4, rows=3, square_m=0.03)
    return {
        "T_rcam_lcam": {"head": head, "joints": joints, "cameras": None},
        "adjust_target_poses": {
            "T_cam_target": {"left_wide": np.tile(np.eye(4), (5, 1, 1))},
            "eye": rng.normal(size=(5, 4), scale=0.2),
            "eyes": {"left_wide": "left"},
            **dict.fromkeys(("kinematics", "placement", "covariance", "noise_factor", "start")),
            "fixed": (),
            "joint_std": None,
        },
        "calibrate": {"data": data(folder), "method": "bundle", "lens": "auto"},
        "combination": {**located, "weights": np.ones(1)},
        "dense_depth": {
            **{"head": head, "joints": joints, "pair": pair, "left": image, "right": image},
            **{"nearest_m": None, "cameras": None},
        },
        "detect_target": {"dataset": data(folder)},
        "export_head": {"head": head, "path": folder / "head.urdf", "format_name": "urdf"},
        "gaze_angles": {"calibration": head, "points_lbase": points, "cameras": None},
        "import_head": {"path": folder / "chain.yaml", "format_name": "kalibr"}
        | {"template": head},
        "in_body": {"head": head, "points_lbase": points, "neck_angles": np.empty(0)},
        "in_head": {"head": head, "points_lbase": points},
        "load_dataset": {"folder": folder},
        "load_head": {"path": folder / "head.json"},
        "locate": {**located, "joint_time_s": None},
        "point_cloud": {"pair": pair, "found": vg.dense_depth(head, joints, pair, image, image)},
        "project_point": {"head": head, "camera": "left_wide", "joints": joints, "points": points},
        "rectified_image": {"view": pair.left, "image": image},
        "rectify": {"head": head, "joints": joints, "cameras": None, "size": None}
        | {"focal_px": None},
        "refine_eye_camera": {
            "eye": rng.normal(size=(5, 2), scale=0.2),
            "pixels": rng.uniform(100, 300, (5, 12, 2)),
            "points": rng.normal(size=(12, 3)),
            "camera": pinhole(640, 480, 280.0),
            "start": None,
            "joints": None,
        },
        "save_head": {"head": head, "path": folder / "again.json"},
        "write_dataset": {
            **{"folder": folder / "new", "description": data(folder).description, "rows": []}
        },
        "Observations": {
            "board": board,
            "placement": np.zeros(2, int),
            "eye_angles": np.zeros((2, 4)),
            "corners": {"left_wide": np.zeros((2, 12, 2))},
            "sizes": {"left_wide": (640, 480)},
            "eyes": {},
            "kinematics": vg.Kinematics(),
            "timing": None,
            "T_base_eye": None,
        },
    }


FUNCTIONS = [name for name in vg.__all__ if inspect.isfunction(getattr(vg, name))]
ALLOWED = {
    "save_head": {"a name": "path", "a Path": "path"},
    "export_head": {"a name": "path", "a Path": "path"},
    "write_dataset": {"a name": "folder", "a Path": "folder"},
}
"""By function, and kind of a wrong value, the argument of which it is no wrong kind."""


@pytest.mark.parametrize("name", [*FUNCTIONS, "Observations"])
@pytest.mark.parametrize("kind", WRONG)
def test_an_argument_of_a_wrong_kind_is_refused_in_one_sentence(name: str, kind: str, right):
    use: Callable[..., object] = getattr(vg, name)
    for argument, value in right[name].items():
        if ALLOWED.get(name, {}).get(kind) == argument or (value is None and kind == "None"):
            continue
        if kind == "a number" and argument in ("pixel_std_px", "joint_std_rad", "nearest_m"):
            continue
        with pytest.raises(vg.VergenceError) as refused:
            use(**{**right[name], argument: WRONG[kind]})
        assert "\n" not in str(refused.value)


def test_a_path_in_place_of_a_head_is_told_how_to_become_one():
    with pytest.raises(vg.VergenceError) as refused:
        vg.in_head("head.json", np.zeros(3))  # pyright: ignore[reportArgumentType]
    assert str(refused.value) == (
        'in_head: head is a HeadCalibration, such as vg.load_head("head.json") or '
        "vg.calibrate(data).head; found 'head.json'."
    )


@pytest.mark.parametrize("calibration", ["head.json", None])
def test_a_gaze_without_a_head_says_what_it_needs(calibration: Any):
    with pytest.raises(vg.VergenceError, match="GazeSettings: calibration is a HeadCalibration, "):
        GazeSettings(calibration=calibration)


def test_a_missing_argument_and_an_error_of_another_cause_stay_what_they_are():
    with pytest.raises(TypeError, match="missing 1 required positional argument: 'points_lbase'"):
        vg.in_head(plain_head(0.09, 280.0))  # pyright: ignore[reportCallIssue]

    def stopped(task: str, done: int, total: int) -> None:
        raise RuntimeError("stopped by the caller")

    board, pose = vg.Chessboard(columns=4, rows=3, square_m=0.03), np.zeros((1, 12, 2))
    seen = vg.Observations(
        board, np.zeros(1), np.zeros((1, 4)), {"left_a": pose}, {"left_a": (9, 9)}
    )
    with pytest.raises(RuntimeError, match="stopped by the caller"):
        vg.calibrate(seen, progress=stopped)


def test_public_functions_can_be_sent_to_other_processes():
    assert pickle.loads(pickle.dumps(vg.locate)) is vg.locate


@pytest.mark.parametrize("weight", [np.nan, np.inf])
def test_weights_that_are_not_finite_are_refused(weight: float, right):
    with pytest.raises(vg.VergenceError, match="Weights of a combination are finite"):
        vg.combination(**{**right["combination"], "weights": [weight]})


def test_cameras_of_a_gaze_are_a_list_of_names(right):
    for cameras in ("left_wide", []):
        with pytest.raises(vg.VergenceError, match=r"such as \['left_wide'\]; found"):
            vg.gaze_angles(**{**right["gaze_angles"], "cameras": cameras})
