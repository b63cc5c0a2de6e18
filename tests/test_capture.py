"""Guided capture: a person follows the guide; frames are kept, planned for, and survive a kill."""

import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import vergence as vg
from drawn_head_before_person import DrawnHead
from guided_capture import AtOnce, HeadWithoutImages, on_paper, share_inside, simulated
from simulated_recording import BOARD
from vergence.cli import parsed
from vergence.data.growing import add_rows, begin_dataset
from vergence.demos import simulated_person
from vergence.live import capture, session
from vergence.live.capture import CaptureSettings, CaptureState, begin_capture
from vergence.live.folder import FolderHead
from vergence.live.kept import Kept, kept_in
from vergence.live.session import run_capture
from vergence.live.status import coverage, status

DRAWN = "--driver", "drawn_head_before_person:open_drawn"
GOAL_M = 0.006
"""Reached after a few views more than the first ones."""


def run(head: HeadWithoutImages, settings: CaptureSettings, **options) -> CaptureState:
    """Run a capture with a person who follows the guide; estimates do not depend on the machine."""
    state = options.pop("state", None) or begin_capture(settings)
    keep = options.pop("keep", lambda rows: None)
    options = {"look": head.follow, "detect": head.detect, "pool": AtOnce(), **options}
    return run_capture(head, settings, state, keep, **options)


@pytest.mark.slow
def test_a_person_who_follows_the_guide_reaches_the_accuracy():
    head, settings = simulated(2, GOAL_M)
    begun = []

    def look(state, frame):
        if state.outlook is not None and not begun:
            begun.append(state)
        head.follow(state, frame)

    state = run(head, settings, look=look, until_s=600.0)
    assert state.finished == "the accuracy is reached"
    assert state.estimate.accuracy_m[0] <= GOAL_M
    assert state.views <= 1.3 * on_paper(begun[0], GOAL_M) + 1
    assert share_inside(state.estimate, head.truth) >= 0.8
    swept = [view for view in state.kept if view.moving]
    assert len(swept) >= 10
    assert len({view.placement for view in swept}) == 1
    assert state.head.time_offset_s == pytest.approx(0.0, abs=0.01)
    assert "mm" in status(settings, state)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["one eye", "fixed"])
def test_heads_whose_views_cannot_be_planned_are_captured_too(kind, monkeypatch):
    monkeypatch.setattr(capture, "WITHOUT_PLAN", 18)
    head, settings = simulated(0, GOAL_M)
    described, limits = settings.description, settings.limits
    if kind == "one eye":
        joints = {n: j for n, j in described.joints.items() if n.startswith("left")}
        cameras = {"left_wide": described.cameras["left_wide"]}
        described = replace(described, cameras=cameras, joints=joints)
        head.truth = replace(head.truth, cameras={"left_wide": head.truth.camera("left_wide")})
    else:
        described, limits = replace(described, joints={}, eye_motion="fixed"), None
        read = head.read
        head.read = lambda names: replace(read(names), eye_angles=np.empty(0))
    state = run(head, replace(settings, description=described, limits=limits), until_s=900.0)
    assert state.finished == "18 views usually suffice where none is planned"
    assert state.estimate.head is not None


def test_a_frame_is_kept_when_board_and_eyes_have_stood_still_and_never_twice():
    head, settings = simulated(0, GOAL_M)
    kept_s, moving_s = [], []

    def look(state, frame):
        head.follow(state, frame)
        if state.T_lbase_board is not None and state.watched.still_s == 0:
            moving_s.append(frame.time_s)

    rows = []
    run(head, settings, look=look, keep=rows.extend, until_s=30.0)
    kept_s = [row.frame.time_s for row in rows if not row.moving]
    assert len(kept_s) >= 4
    assert not set(kept_s) & set(moving_s)
    still = [max(t for t in [0.0, *moving_s] if t < kept) for kept in kept_s]
    assert all(kept - last > 0.4 for kept, last in zip(kept_s, still, strict=True))
    # A board that nobody moves is kept once.
    head, settings = simulated(0, GOAL_M)
    state = begin_capture(settings)
    head.person.ask(state.asked[0].T_lbase_target, False, 0.0)
    asked = set()
    bare = replace(settings, limits=None)
    state = run(head, bare, look=lambda now, _: asked.add(id(now.asked[0])), until_s=60.0)
    assert state.views == 1
    assert len(asked) >= 3  # another view is asked for after a while


def test_a_board_that_was_asked_for_elsewhere_has_a_place_of_its_own():
    _, settings = simulated(0, GOAL_M)
    state = begin_capture(settings)
    stays = replace(state.asked[0], board_stays=True)
    # Nothing was kept where the board was asked to before: it has moved, and is asked to stay now.
    first = Kept(vg.Frame(0.0, 0.0, np.zeros(4), np.empty(0), {}), {}, 7)
    frame = replace(first.frame, time_s=1.0)
    for in_place, number in ((False, 8), (True, 7)):
        now = replace(state, kept=(first,), asked=(stays,), in_place=in_place)
        assert capture._placement(settings, now, frame) == number
    assert not begin_capture(settings, (first,)).in_place


def test_a_sweep_is_kept_where_the_board_was_in_sight():
    _, settings = simulated(0, GOAL_M)
    sweep, rows = capture.Sweep(0.0, np.zeros(4)), []
    for time_s in (0.0, 0.1, *np.arange(1.0, 2.5, 0.1), 2.9):
        frame = vg.Frame(time_s, time_s, np.zeros(4), np.empty(0), {})
        rows.append((vg.DatasetRow(frame, 0, moving=True), Kept(frame, {}, 0, moving=True)))
    sweep = replace(sweep, rows=tuple(rows))
    frame = vg.Frame(3.1, 3.1, np.zeros(4), np.empty(0), {})
    state, kept = capture._step_sweep(begin_capture(settings), sweep, frame)
    assert [row.frame.time_s for row in kept] == pytest.approx(np.arange(1.0, 2.5, 0.1))
    assert state.sweep is None
    short = replace(sweep, rows=tuple(rows[:2]))
    assert capture._step_sweep(begin_capture(settings), short, frame)[1] == ()


def test_capture_goes_on_from_a_dataset_though_the_clock_began_anew(tmp_path):
    head, settings = DrawnHead.drawn(1)
    growing = begin_dataset(tmp_path / "d", settings.description)

    def keep(rows):
        nonlocal growing
        growing = add_rows(growing, *rows)

    first = run(head, settings, keep=keep, until_s=16.0, detect=head.by_images)
    assert first.views >= 3
    head, _ = DrawnHead.drawn(1)
    kept = kept_in(vg.load_dataset(tmp_path / "d"))
    assert len(kept) == len(first.kept)
    for before, after in zip(first.kept, kept, strict=True):
        for name, corners in before.corners.items():
            np.testing.assert_allclose(after.corners[name], corners, atol=0.05)
    growing = begin_dataset(tmp_path / "d", settings.description)
    state = begin_capture(settings, kept)
    assert state.asked[0].T_lbase_target == pytest.approx(first.asked[0].T_lbase_target)
    again = run(head, settings, state=state, keep=keep, until_s=8.0, detect=head.by_images)
    assert again.views > first.views
    assert (np.diff(vg.load_dataset(tmp_path / "d").time_s) > 0).all()


def test_a_dataset_of_another_head_is_not_continued(tmp_path):
    _, settings = simulated(0, GOAL_M)
    begin_dataset(tmp_path / "d", settings.description)
    other = replace(settings.description, board=replace(BOARD, square_m=0.02))
    with pytest.raises(vg.VergenceError, match="another board"):
        begin_dataset(tmp_path / "d", other)
    (tmp_path / "e").mkdir()
    (tmp_path / "e" / "file").touch()
    with pytest.raises(vg.VergenceError, match="holds no dataset"):
        begin_dataset(tmp_path / "e", other)


WRITER = """
import sys
from pathlib import Path
import numpy as np
import vergence as vg
from guided_capture import simulated
from vergence.cli import parsed
from vergence.data.growing import add_rows, begin_dataset
_, settings = simulated(0, 0.01)
growing = begin_dataset(Path(sys.argv[1]), settings.description)
print("ready", flush=True)
image = np.random.default_rng(0).integers(0, 255, (480, 640), np.uint8)
for k in range(len(growing.rows), 10_000):
    images = dict.fromkeys(settings.description.cameras, image)
    frame = vg.Frame(float(k), float(k), np.zeros(4), np.empty(0), images)
    growing = add_rows(growing, vg.DatasetRow(frame, k))
    print(k + 1, flush=True)
"""


def test_a_killed_capture_loses_the_frame_in_hand_at_most(tmp_path):
    rng, written = np.random.default_rng(0), 0
    path = [str(Path(__file__).parents[1] / "benchmarks"), *sys.path]
    for _ in range(2):
        with subprocess.Popen(
            [sys.executable, "-c", WRITER, str(tmp_path / "d")],
            stdout=subprocess.PIPE,
            text=True,
            env={"PYTHONPATH": ":".join(path)},
        ) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"
            time.sleep(rng.uniform(0.05, 0.4))
            process.send_signal(signal.SIGKILL)
            announced = [int(line) for line in process.stdout.read().split()]
        rows = len(vg.load_dataset(tmp_path / "d")) if announced or written else 0
        assert rows - (announced[-1] if announced else written) in (0, 1)
        written = rows
    assert written > 0
    dataset = vg.load_dataset(tmp_path / "d")
    assert dataset.image("left_wide", written - 1) is not None


def test_frames_that_another_program_writes_are_read_when_they_are_whole(tmp_path):
    _, settings = simulated(0, GOAL_M)
    growing = begin_dataset(tmp_path / "d", settings.description)
    head = FolderHead(tmp_path / "d")
    assert head.read(()) is None
    image = np.zeros((480, 640), np.uint8)
    for k in range(2):
        images = {"left_wide": image, "right_wide": image}
        frame = vg.Frame(k + 1.0, k + 1.0, np.full(4, 0.1), np.empty(0), images)
        growing = add_rows(growing, vg.DatasetRow(frame, k))
        found = head.read(())
        assert found is not None
        assert found.time_s == head.now_s() == k + 1.0
        assert head.read(()) is None
    table = tmp_path / "d" / "frames.csv"
    whole = table.read_text()
    table.write_text(whole + "3.0,3.0,\n")  # half a line
    assert head.read(()) is None
    table.write_text(whole)


def test_coverage_counts_cells_with_corners():
    corners = np.array([[10.0, 10.0], [630.0, 470.0], [np.nan, np.nan]])
    kept = Kept(vg.Frame(0.0, 0.0, np.zeros(4), np.empty(0), {}), {"left": corners}, 0)
    assert coverage((kept,), "left", (640, 480)) == pytest.approx(2 / 48)
    assert coverage((kept,), "right", (640, 480)) == 0.0


@pytest.mark.slow
@pytest.mark.usefixtures("two_folds")
def test_the_command_captures_with_a_driver_and_calibrates(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(simulated_person, "MOVE_S", 0.2)  # fewer images to draw
    monkeypatch.setattr(capture, "STILL_S", 0.2)
    monkeypatch.setattr(session, "ThreadPoolExecutor", lambda count: AtOnce())
    out = tmp_path / "d"
    report = parsed(["capture", *DRAWN, "--out", str(out), "--goal-mm", "40"])()
    told = capsys.readouterr().err
    assert "the accuracy is reached" in told
    assert re.search(r"next: move the board \d+ cm", told)
    assert "left_wide covered to" in told
    assert vg.load_head(out / "calibration.json").accuracy is not None
    assert "VOID" not in report.summary()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ([], "name --driver MODULE:NAME, --twin or --folder DIR; found 0"),
        (["--twin", "--folder", "x"], "found 2"),
        (
            ["--driver", "drawn_head_before_person:two_limits"],
            "limits of a driver are of all joints",
        ),
        (["--driver", "nothing"], "named as module:Name or file.py:Name"),
        (["--driver", "no_such_module:Head"], "No driver can be loaded from no_such_module"),
        (["--folder", "no_such_folder"], "There is no dataset folder no_such_folder"),
        ([*DRAWN, "--goal-mm", "0"], "accuracy above 0 m"),
        ([*DRAWN, "--profile", "ideal"], "without --twin"),
    ],
)
def test_what_cannot_be_captured_is_refused_in_one_sentence(arguments, sentence, tmp_path):
    with pytest.raises(vg.VergenceError, match=re.escape(sentence)):
        parsed(["capture", "--out", str(tmp_path / "d"), *arguments])()
    assert not (tmp_path / "d").exists()


def test_a_file_that_is_no_calibration_is_not_replaced(tmp_path):
    (tmp_path / "notes.json").write_text("{}")
    words = [*DRAWN, "--out", str(tmp_path / "d"), "--calibration", str(tmp_path / "notes.json")]
    with pytest.raises(vg.VergenceError, match="is no calibration, and is not replaced"):
        parsed(["capture", *words])()


def test_a_long_capture_that_goes_on_asks_no_camera_that_has_shown_enough():
    _, settings = simulated(0, GOAL_M)
    corners = dict.fromkeys(settings.description.cameras, np.zeros((54, 2)))
    kept = [Kept(vg.Frame(k, k, np.zeros(4), np.empty(0), {}), corners, k) for k in range(30)]
    assert begin_capture(settings, tuple(kept)).for_camera == ""
