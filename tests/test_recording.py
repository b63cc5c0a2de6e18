"""The recordings: whole or not there, and with the numbers that were passed."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import cv2
import mujoco
import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from rrd import assert_valid, read_series
from vergence.accuracy.motions import eye_angles
from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.geometry.head import HeadCalibration
from vergence.geometry.kinematics import EYES
from vergence.geometry.se3 import pose, transform
from vergence.paper.figures import FIGURES
from vergence.paper.recording import figure_recording, log_results
from vergence.paper.replay import Measurements, Replay
from vergence.twin.appearance import VisualGeom, visual_geoms
from vergence.twin.head_file import models_folder
from vergence.twin.head_model import load_head_model, nominal_head
from vergence.twin.model import compile_head
from vergence.twin.renderer import overscan_sizes
from vergence.viewer.recording import log_frame, log_report
from vergence.viewer.shapes import lines_of_sight

FIGURE = FIGURES[6]
OBJECT = np.array(FIGURE.mean_m)
SAMPLES, EVERY, DROPPED = 24, 4, (5, 11)
TIMES: Array = np.round(np.arange(SAMPLES) * 0.1178, 3).astype(float)
T_WORLD_LBASE = pose(t=[0.0, 0.046, 1.2])
IN_IMAGE, OUTSIDE = np.array([[320.25, 200.0], [700.0, 200.0]])
NOT_FOUND = np.full(2, np.nan)


@pytest.fixture(scope="module")
def head() -> HeadCalibration:
    return nominal_head("2.8mm")


@pytest.fixture(scope="module")
def geoms() -> list[VisualGeom]:
    return visual_geoms(default_model())


def default_model() -> mujoco.MjModel:
    head = load_head_model()
    return compile_head(head, head.designed.head, overscan_sizes(head.designed.head))


def estimates() -> np.ndarray:
    points = np.random.default_rng(0).normal(OBJECT, FIGURE.std_m, (SAMPLES, 3))
    points[list(DROPPED)] = np.nan
    return points


def replay_of(points: np.ndarray) -> Replay:
    """Return a replay with these estimates (N, 3)."""
    unseen = np.full((SAMPLES, 2), np.nan)
    seen = Measurements(TIMES, eye_angles(FIGURE.motion, TIMES), unseen, unseen)
    return Replay(FIGURE, seen, points)


def noisy_image(rng: np.random.Generator) -> np.ndarray:
    """A picture as the twin's cameras give it: smooth, with noise of 3 grey levels."""
    coarse = rng.uniform(60, 190, (12, 16)).astype(np.float32)
    smooth = cv2.resize(coarse, (640, 480), interpolation=cv2.INTER_CUBIC)
    noise = rng.normal(0, 3, (480, 640, 3))
    return np.clip(smooth[:, :, None] + noise, 0, 255).astype(np.uint8)


def frame(head: HeadCalibration, index: int) -> Frame:
    rng = np.random.default_rng(index)
    return Frame(
        time_s=TIMES[index],
        joint_time_s=TIMES[index],
        eye_angles=eye_angles(FIGURE.motion, TIMES)[index],
        neck_angles=np.zeros(3),
        images={name: noisy_image(rng) for name in head.cameras},
    )


def log_all(rec: rr.RecordingStream, head: HeadCalibration) -> None:
    for index in range(0, SAMPLES, EVERY):
        log_frame(
            rec,
            head,
            time_s=TIMES[index],
            index=index,
            frame=frame(head, index),
            body_poses={"head": pose(t=[0, 0, 1.2]), "left_eye": T_WORLD_LBASE},
            detected={"left_wide": IN_IMAGE, "left_narrow": NOT_FOUND},
            truth={"left_wide": IN_IMAGE, "left_narrow": OUTSIDE},
        )
    log_results(rec, replay_of(estimates()), head, T_WORLD_LBASE)
    log_report(rec, "# Fig. 6\n\nA report.")


@pytest.fixture(scope="module")
def recorded(
    tmp_path_factory: pytest.TempPathFactory, head: HeadCalibration, geoms: list[VisualGeom]
) -> Path:
    path = tmp_path_factory.mktemp("run") / "fig06.rrd"
    with figure_recording(path, FIGURE, head, geoms) as rec:
        log_all(rec, head)
    return path


def components(path: Path, entity: str, component: str) -> list:
    """Return every row of a component, static ones too."""
    rows = []
    for chunk in RrdReader(path).stream().filter(content=entity, components=component):
        rows += chunk.to_record_batch().column(component).to_pylist()
    return rows


def test_a_recording_passes_the_viewers_own_check_and_brings_its_layout(recorded: Path):
    assert_valid(recorded)


def test_series_come_back_to_the_last_digit(recorded: Path):
    located = np.delete(np.arange(SAMPLES), DROPPED)
    for k, axis in enumerate("xyz"):
        times, values = read_series(recorded, f"/estimate/{axis}")
        np.testing.assert_array_equal(values, estimates()[located, k])
        np.testing.assert_allclose(times, TIMES[located], rtol=0, atol=1e-12)
    numbers, _ = read_series(recorded, "/estimate/x", timeline="frame")
    np.testing.assert_array_equal(numbers, located)
    _, pan = read_series(recorded, "/joints/left_pan")
    np.testing.assert_array_equal(pan, eye_angles(FIGURE.motion, TIMES)[:, 0])


def test_marks_lie_half_a_pixel_on_and_only_within_the_image(recorded: Path):
    def rings(camera: str) -> list:
        return components(recorded, f"/world/left_eye/{camera}/truth", "Ellipses2D:centers")

    def crosses(camera: str) -> list:
        return components(recorded, f"/world/left_eye/{camera}/detected", "LineStrips2D:strips")

    np.testing.assert_allclose(rings("left_wide")[0], [IN_IMAGE + 0.5])
    np.testing.assert_allclose(np.mean(crosses("left_wide")[0], axis=(0, 1)), IN_IMAGE + 0.5)
    assert rings("left_narrow") == [[]] * (SAMPLES // EVERY)
    assert crosses("left_narrow") == [[]] * (SAMPLES // EVERY)


def interrupt(path: Path, head: HeadCalibration, interruption: type[BaseException]) -> None:
    with figure_recording(path, FIGURE, head, []) as rec:
        log_report(rec, "half")
        raise interruption


@pytest.mark.parametrize("interruption", [ValueError, KeyboardInterrupt])
def test_an_interrupted_recording_leaves_nothing_and_spares_the_one_before(
    tmp_path: Path, head: HeadCalibration, interruption: type[BaseException]
):
    before = tmp_path / "fig06.rrd"
    before.write_text("before")
    for path in (before, tmp_path / "new" / "fig06.rrd"):
        with pytest.raises(interruption):
            interrupt(path, head, interruption)
    assert list((tmp_path / "new").iterdir()) == []
    assert before.read_text() == "before"


def test_estimates_and_lines_of_sight_hang_in_the_left_eyes_base_frame(recorded: Path, head):
    entity, located = "/world/left_base", np.delete(np.arange(SAMPLES), DROPPED)
    (translation,) = components(recorded, entity, "Transform3D:translation")
    np.testing.assert_allclose(translation[0], T_WORLD_LBASE[:3, 3], atol=1e-6)
    _, trail = read_series(recorded, f"{entity}/trail", component="Points3D:positions")
    np.testing.assert_allclose(trail, estimates()[located], atol=1e-6)
    _, strips = read_series(recorded, f"{entity}/rays", component="LineStrips3D:strips")
    assert strips.shape == (len(located), 3, 3)
    straight = lines_of_sight(head, OBJECT[None], np.zeros((1, 4)))[0]
    np.testing.assert_allclose(straight[0], head.cameras["left_wide"].T_eye_cam[:3, 3])
    in_right_base = transform(head.T_rbase_lbase, straight[2])
    of_right = head.cameras["right_wide"].T_eye_cam[:3, 3]
    np.testing.assert_allclose(in_right_base, of_right, atol=1e-12)
    assert components(recorded, "/__properties/statistics", "dropped") == [[len(DROPPED)]]


def test_a_run_without_estimates_is_recorded_from_another_thread(tmp_path: Path, head):
    cameras = {f"wide_of_{mounted.eye}": mounted for mounted in head.cameras.values()}
    renamed, path = replace(head, cameras=cameras), tmp_path / "fig06.rrd"

    def work(rec: rr.RecordingStream) -> None:
        seen = frame(renamed, 0)
        log_frame(
            rec, renamed, time_s=0.0, index=0, frame=seen, body_poses={}, detected={}, truth={}
        )
        log_results(rec, replay_of(np.full((SAMPLES, 3), np.nan)), renamed, T_WORLD_LBASE)

    with (
        figure_recording(path, FIGURE, renamed, []) as rec,
        ThreadPoolExecutor(max_workers=1) as worker,
    ):
        worker.submit(work, rec).result()
        assert not path.exists()  # before it is whole
    assert list(tmp_path.iterdir()) == [path]
    assert len(read_series(path, "/joints/right_tilt")[0]) == SAMPLES
    for eye in EYES:
        entity = f"/world/{eye}_eye/wide_of_{eye}/image"
        assert len(components(path, entity, "EncodedImage:blob")) == 1


def test_the_head_and_the_board_are_drawn_as_the_model_has_them(geoms: list[VisualGeom]):
    model = default_model()
    drawn = {geom.body for geom in geoms}
    assert drawn >= {"head", "left_eye", "right_eye", "left_pan", "right_pan", "object", "board"}
    collision_or_room = (model.geom_group == 3) | (model.geom_bodyid == 0)
    assert len(geoms) == sum(~collision_or_room)
    shell = next(geom for geom in geoms if geom.body == "head" and geom.triangles is not None)
    assert shell.triangles is not None
    corners = transform(shell.T_body_geom, shell.triangles.reshape(-1, 3))
    lines = (models_folder() / "cbi_head" / "assets" / "shell.obj").read_text().splitlines()
    vertices = np.array([line.split()[1:] for line in lines if line.startswith("v ")], float)
    for bound in (np.min, np.max):
        np.testing.assert_allclose(bound(corners, axis=0), bound(vertices, axis=0), atol=2e-5)
    (board,) = (geom for geom in geoms if geom.body == "board" and geom.shape == "plane")
    assert board.texture is not None
    height, width = board.texture.shape[:2]
    assert width / height == pytest.approx(board.size[0] / board.size[1])
