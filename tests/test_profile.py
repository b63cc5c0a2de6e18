"""Error profiles: what ships loads, what is wrong is refused by name."""

from pathlib import Path

import pytest

from vergence.errors import VergenceError
from vergence.twin.profile import load_profile, shipped


@pytest.fixture
def write(tmp_path: Path):
    def write(text: str | bytes) -> str:
        path = tmp_path / "mine.toml"
        path.write_bytes(text.encode() if isinstance(text, str) else text)
        return str(path)

    return write


@pytest.mark.parametrize("name", shipped())
def test_what_ships_loads_under_its_own_name(name: str):
    profile = load_profile(name)
    assert profile.name == name
    assert profile.description.endswith(".")


def test_values_arrive_where_they_belong(write):
    profile = load_profile(
        write("[joints]\ndelay_ms = -26\ngain_percent = [1, 2, 3, 4]\n[optics]\ndistortion = false")
    )
    assert profile.joints.delay_ms == -26
    assert profile.joints.gain_percent == (1, 2, 3, 4)
    assert profile.optics.distortion is False


WRONG = {
    "[joints]\nnoise_degree = 1": "joints.noise_degree",
    "[sensors]\nnoise_deg = 1": "sensors",
    "[joints]\nnoise_deg = -1": "joints.noise_deg = -1",
    "[joints]\nnoise_deg = 'much'": "joints.noise_deg = 'much'",
    "[joints]\ngain_percent = [1, 2]": "joints.gain_percent",
    "[joints]\ncounts_per_turn = 4096.5": "joints.counts_per_turn = 4096.5",
    "[joints]\nbacklash_deg = 90": "joints.backlash_deg = 90",
    "[joints]\ndelay_ms = 1000": "joints.delay_ms = 1000",
    "[mounting]\nbaseline_mm = 0": "mounting.baseline_mm = 0",
    "[image]\nnoise_grey = 300": "image.noise_grey = 300",
    "[image]\nblur_px = -1": "image.blur_px = -1",
    "[calibration]\nwide_lens = 'mirror'": "calibration.wide_lens = 'mirror'",
    "[[fitted]]\nname = 'x'": "fitted.0.value",
}


@pytest.mark.parametrize("text", WRONG)
def test_an_unknown_or_impossible_value_is_refused_by_name(write, text: str):
    with pytest.raises(VergenceError, match=r"mine\.toml is not an error profile") as caught:
        load_profile(write(text))
    field, _, found = WRONG[text].partition(" = ")
    assert f": {field}" in str(caught.value)
    assert found in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["perfect", "Ideal", "", "ideal.yaml", "../ideal"])
def test_an_unknown_name_is_answered_with_the_known_ones(name: str):
    with pytest.raises(VergenceError, match=r"there are ideal, noise-only, paper"):
        load_profile(name)
