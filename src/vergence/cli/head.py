"""The command head: find the eyes of a model, and describe them in head.toml."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vergence.cli.options import Optional, Positional, check_outputs
from vergence.cli.report import Report
from vergence.cli.terminal import invocation
from vergence.errors import VergenceError
from vergence.files import markdown_table, results_folder, whole_file, write_whole

if TYPE_CHECKING:
    from vergence.twin.designed_head import DesignedHead

HEADING = "# Written by `vergence head`; docs/own_head.md explains the fields."


def head(model: Positional[Path], /, *, out: Optional[Path] = None) -> Report:
    """Find cameras, eyes and neck of a robot's model, and write a first head.toml into its folder.

    Args:
        model: MJCF or URDF file; or a head.toml, which is completed, checked and shown.
        out: Folder for a picture and a recording of the head with axes and views.
    """
    from vergence.twin.head_checks import disagreement, doubts, picture, sweep
    from vergence.twin.head_model import load_head_model

    target = model.parent / "head.toml" if model.suffix != ".toml" else None
    check_outputs(target, folder=out, names=("head.png", "head.rrd"), inputs=[model])
    if target is not None and target.exists():
        typed = invocation("vergence", "head", target)
        raise VergenceError(f"{target} exists and is not overwritten; type {typed} to check it.")
    found = load_head_model(model)
    lines = as_toml(found.stated.model_dump(exclude_unset=True))
    text, files = "\n".join([HEADING, *lines, ""]), []
    report = _report(found.designed, text, disagreement(found), doubts(found))
    if target is not None:
        write_whole(target, text)
        files.append(f"Wrote {target}.")
    if out is not None:
        from PIL import Image

        from vergence.twin.appearance import visual_geoms
        from vergence.viewer.head import record_head

        with results_folder(out):
            shown = visual_geoms(found.model), sweep(found), report.markdown()
            record_head(out / "head.rrd", found.designed.head, *shown)
            with whole_file(out / "head.png") as part:
                Image.fromarray(picture(found)).save(part, format="png")
        files.append(f"To view the recording: {invocation('rerun', out / 'head.rrd')}")
    return Report(report.title, report.parts, report.data, files="\n".join(files))


def _report(found: DesignedHead, toml: str, error: float, remarks: list[str]) -> Report:
    """Report what was found of a head, whose complete description is `toml`."""
    head, kinematics = found.head, found.head.kinematics
    axes = {
        name: (axis, {name: 1.0}) for name, axis in zip(found.neck, head.neck.axes, strict=True)
    }
    for eye, names in found.eyes.items():
        described = zip(names, kinematics.eyes[eye], strict=True)
        axes |= {name: (joint.axis, joint.readings) for name, joint in described}
    rows = [
        (
            name,
            "({:.3g}, {:.3g}, {:.3g})".format(*axis.round(9) + 0.0),
            " ".join(f"{factor:+.4g} {reading}" for reading, factor in readings.items()),
        )
        for name, (axis, readings) in axes.items()
    ]
    parts = [
        f"```toml\n{toml}```",
        markdown_table("joint | turns about, in frame head | angle", rows),
        f"The kinematics agree with MuJoCo's to {error:.0e} [m, 1] at 20 random postures.",
        *remarks,
    ]
    data = {"eyes": dict(found.eyes), "neck": found.neck, "disagreement": error}
    return Report("Head of a model", parts, data)


def as_toml(values: Mapping[str, Any], table: str = "") -> Iterator[str]:
    """Yield the lines of a TOML file, or of one of its tables."""
    inner = {key: value for key, value in values.items() if isinstance(value, Mapping)}
    if table and (len(inner) < len(values) or not values):
        yield from ("", f"[{table}]")
    for key, value in values.items():
        if key not in inner and value is not None:
            plain = getattr(value, "tolist", lambda same=value: same)()  # of an array
            # TOML writes strings, numbers and arrays as JSON does.
            yield f"{_key(key)} = {json.dumps(plain, ensure_ascii=False)}"
    for key, value in inner.items():
        yield from as_toml(value, f"{table}.{_key(key)}".lstrip("."))


def _key(name: str) -> str:
    return name if re.fullmatch("[A-Za-z0-9_-]+", name) else json.dumps(name)
