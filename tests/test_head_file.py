"""The description of a head beside its model: read whole, or refused with one sentence."""

from __future__ import annotations

import pytest

from vergence.errors import VergenceError
from vergence.twin.head_file import load_head_file


def test_the_default_head_states_its_model_cameras_and_lenses_only():
    stated, model = load_head_file()
    assert model.is_file()
    assert stated.model_fields_set == {"model", "cameras", "lenses"}
    assert list(stated.lenses) == ["2.8mm", "4.0mm"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "model: this field is missing"),
        ('model = "a.xml"\nbase = 3', "base: .* found 3"),
        ('model = "a.xml"\nbasis = "head"', "basis: unknown field"),
        ('model = "a.xml"\n[cameras.l]\nfov_deg = 500', "cameras.l.fov_deg: .* less than 179"),
        ('model = "a.xml"\n[cameras.l]\npos_m = [0, 0]', "cameras.l.pos_m: expected 3 numbers"),
        ("model = ", "Invalid value"),
    ],
)
def test_an_invalid_description_is_refused_with_its_place(tmp_path, text, message):
    (tmp_path / "head.toml").write_text(text)
    with pytest.raises(VergenceError, match=f"head.toml is not a description of a head: {message}"):
        load_head_file(tmp_path / "head.toml")
