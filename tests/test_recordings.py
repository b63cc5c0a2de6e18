"""From a robot's bag to a dataset, to a calibrated head and to points: what the page says."""

import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from documents import blocks, commands, first
from drawn_bag import (
    MAP,
    START_NS,
    Session,
    draw,
    messages,
    two_eyes,
    usual,
    write_bag,
    write_mcap,
)
from drawn_room import view
from vergence import cli
from vergence.data.reader import load_dataset
from vergence.errors import VergenceError
from vergence.geometry.head import load_head
from vergence.recordings import frame_choice
from vergence.recordings.import_recording import import_recording
from vergence.recordings.recording_map import load_map
from vergence.stereo.extrinsics import relative_camera_pose

PAGE = "docs/recordings.md"


def run(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> None:
    monkeypatch.setattr(sys, "argv", ["vergence", *map(str, arguments)])
    cli.main()


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory, slow_setup: None) -> tuple[Path, Session]:
    """A folder with robot/session.mcap of a board, and robot/later.mcap of a room."""
    folder, session = tmp_path_factory.mktemp("page"), replace(usual(5, 9), rest_ns=700_000_000)
    (folder / "robot").mkdir()
    write_mcap(folder / "robot" / "session.mcap", messages(session, two_eyes()))
    later = replace(session, angles=session.angles[5:9])

    def room(head, camera, angles):
        return view(head, camera, angles)[..., 0]

    write_mcap(folder / "robot" / "later.mcap", messages(later, two_eyes(), see=room))
    return folder, session


@pytest.mark.usefixtures("two_folds")
def test_the_page_s_commands_lead_to_points(robot, monkeypatch, capsys):
    folder, session = robot
    monkeypatch.setattr(frame_choice, "MOST_MOVING", 15)  # to save time
    monkeypatch.chdir(folder)
    steps = [words[1:] for words in commands(PAGE) if words[1] != "record"]
    listing, direct, imported, _, corrected, exported = steps
    run(monkeypatch, *listing)
    printed = capsys.readouterr().out
    assert "| /stereo/left/image_raw" in printed
    assert "fill in 3 values" in printed
    place = folder / "robot" / "map.toml"
    with pytest.raises(SystemExit):
        run(monkeypatch, *direct)
    assert "columns: " in capsys.readouterr().err
    written, page = place.read_text(), first(PAGE, "toml")
    filled = written.replace(
        '"r_eye_pan", unit = "deg", sign = 1', '"r_eye_pan", unit = "deg", sign = -1'
    )
    for name, value in (("columns", 7), ("rows", 6), ("square_m", 0.03)):
        filled = filled.replace(f'{name} = "?"', f"{name} = {value}")
    assert tomllib.loads(filled) == tomllib.loads(page)
    place.write_text(page)

    run(monkeypatch, *imported)
    dataset = load_dataset("my_head")
    assert len(set(dataset.placement)) == 6
    assert dataset.moving.any()
    for row in np.flatnonzero(~dataset.moving).tolist():
        t = round(dataset.time_s[row] * 1e9 - START_NS, -6)
        np.testing.assert_allclose(dataset.eye_angles[row], session.angles_at(int(t)), atol=1e-9)
        expected = draw(
            two_eyes(), "left_wide", session.angles_at(int(t)), session.board_at(int(t))
        )
        image = dataset.image("left_wide", row)
        assert image is not None
        assert np.abs(image[..., 0] - expected.astype(float)).max() < 6

    run(monkeypatch, *direct)
    found = load_head("head.json")
    truth, joints = two_eyes(), dataset.eye_angles[-1]
    error = relative_camera_pose(found, joints) - relative_camera_pose(truth, joints)
    assert np.abs(error).max() < 2e-3
    capsys.readouterr()
    code = next(block.text for block in blocks(PAGE) if block.language == "python")
    exec(compile(code, PAGE, "exec"), {})
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) > 10
    assert all("OK" in line for line in lines)

    run(monkeypatch, *exported)
    assert len(Path("poses.csv").read_text().splitlines()) > 2 * 100

    run(monkeypatch, *listing[:1], "robot/later.mcap", "--map", "robot/later.toml")
    board = page[page.index("[board]") : page.index("[joints]")]
    place.write_text(page.replace(board, ""))
    run(monkeypatch, *corrected)
    assert load_head("learned.json") is not None
    with pytest.raises(SystemExit):
        run(monkeypatch, "calibrate", "robot/later.mcap", "--out", "other.json")
    assert "describes no board" in capsys.readouterr().err


def test_a_board_that_nobody_shows_is_named(tmp_path):
    session = Session(np.outer([0, 0.2], np.ones(4)), np.tile(np.eye(4), (2, 1, 1)))
    write_bag(tmp_path / "bag", messages(session, two_eyes()))
    (tmp_path / "map.toml").write_text(MAP)
    with pytest.raises(
        VergenceError, match=r"None of \d+ frames? of .* shows a chessboard of 7 x 6"
    ):
        import_recording(tmp_path / "bag", load_map(tmp_path / "map.toml"), tmp_path / "out")
    assert not (tmp_path / "out").exists()
