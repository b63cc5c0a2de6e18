"""The command head: find the eyes of a model, and describe them in head.toml."""

from __future__ import annotations

import os
from pathlib import Path

from vergence.cli.options import Optional, Positional, check_outputs
from vergence.cli.report import Report
from vergence.cli.terminal import invocation
from vergence.errors import VergenceError
from vergence.files import results_folder, write_whole

RESULTS = "head.png", "head.rrd", "report.md"


def head(
    model: Positional[Path],
    /,
    *,
    cameras: tuple[str, ...] = (),
    toml: Optional[Path] = None,
    out: Optional[Path] = None,
) -> Report:
    """Find cameras, eyes and neck of a robot's model, and write a first head.toml.

    Args:
        model: MJCF or URDF file, or a head.toml, which is checked and shown.
        cameras: Cameras or links of the eyes, where the model has others, too.
        toml: File to write; default: head.toml beside the model, which is never overwritten.
        out: Folder for a drawing and a recording of the head with axes and views.
    """
    from vergence.cli.head_report import as_toml, head_report
    from vergence.twin.designed_head import designed_head
    from vergence.twin.head_checks import disagreement, doubts
    from vergence.twin.head_file import HeadFile, load_head_file
    from vergence.twin.head_guess import completed, named_cameras
    from vergence.twin.head_lens import lens_of
    from vergence.twin.model_file import load_model

    described = model.suffix == ".toml"
    target = (model.parent / "head.toml" if toml is None else toml) if not described else None
    check_outputs(target, folder=out, names=RESULTS, inputs=[model])
    if target is not None and target.exists():
        raise VergenceError(
            f"{target} exists and is not overwritten; type {invocation('vergence', 'head', target)}"
            " to check it, or name another file to write after --toml."
        )
    if described:
        stated, path = load_head_file(model)
    else:
        stated, path = HeadFile(model=model.name), model
    compiled = load_model(path).compile()
    if cameras:
        stated = stated.model_copy(update={"cameras": named_cameras(compiled, cameras)})
    full = completed(stated, compiled)
    folder = model.parent
    found = designed_head(
        compiled, full, {n: lens_of(full, folder, n, compiled) for n in full.cameras}
    )
    error = disagreement(compiled, found)
    report = head_report(full, found, error, [*doubts(compiled, full, found)])
    files = []
    if target is not None:
        beside = os.path.relpath(path.resolve(), target.resolve().parent)
        write_whole(target, as_toml(full.model_copy(update={"model": beside}), found))
        files.append(f"Wrote {target}.")
    if out is not None:
        from vergence.twin.appearance import visual_geoms
        from vergence.twin.head_sweep import sweep
        from vergence.viewer.head import record_head
        from vergence.viewer.plots.head import draw_head

        with results_folder(out):
            moved = sweep(compiled, found)
            geoms = [each for each in visual_geoms(compiled) if each.body in moved.bodies]
            draw_head(out / "head.png", found.head, geoms, moved, path.name)
            record_head(out / "head.rrd", found.head, geoms, moved, report.markdown())
            write_whole(out / "report.md", report.markdown())
        files.append(f"To view the recording: {invocation('rerun', out / 'head.rrd')}")
    return Report(report.title, report.parts, report.data, files="\n".join(files))
