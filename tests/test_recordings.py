"""From a robot's bag to a dataset, and to a calibrated head."""

import sys
from pathlib import Path

import numpy as np
import pytest

from drawn_bag import MAP, START_NS, Session, draw, messages, two_eyes, usual, write_bag
from vergence import cli
from vergence.data.reader import load_dataset


def run(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> None:
    monkeypatch.setattr(sys, "argv", ["vergence", *map(str, arguments)])
    cli.main()


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Session]:
    folder, session = tmp_path_factory.mktemp("robot"), usual(3, 3)
    write_bag(folder / "bag", messages(session, two_eyes()))
    (folder / "map.toml").write_text(MAP)
    return folder / "bag", session


def test_a_bag_becomes_a_dataset(bag, tmp_path, monkeypatch):
    path, session = bag
    run(monkeypatch, "import-recording", path, "--out", tmp_path / "dataset")
    dataset = load_dataset(tmp_path / "dataset")
    at_rest = 0
    for row in range(len(dataset)):
        t = round(dataset.time_s[row] * 1e9) - START_NS
        if abs(t % session.period_ns - session.rest_ns / 2) > session.rest_ns / 2:
            continue
        t, at_rest = round(t, -5), at_rest + 1  # the stamp is rounded
        np.testing.assert_allclose(dataset.eye_angles[row], session.angles_at(t), atol=1e-12)
        expected = draw(two_eyes(), "left_wide", session.angles_at(t), session.board_at(t))
        image = dataset.image("left_wide", row)
        assert image is not None
        np.testing.assert_array_equal(image[..., 0], expected)
    assert at_rest >= len(session.angles)
