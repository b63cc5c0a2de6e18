"""The command line: parses arguments, calls a function of the same name, prints its report."""

from __future__ import annotations

import io
import itertools
import os
import re
import sys
from collections.abc import Callable
from contextlib import redirect_stderr
from functools import partial, wraps
from inspect import getdoc
from typing import Any

import tyro

from vergence.cli.accuracy import budget, design, plan
from vergence.cli.calibration import calibrate, evaluate, export, import_, self_calibrate
from vergence.cli.capture import capture
from vergence.cli.experiments import depth, foveate, grasp, record, reproduce, track
from vergence.cli.head import head
from vergence.cli.recordings import export_poses, import_recording
from vergence.cli.report import Report
from vergence.cli.terminal import invocation, plain_ending
from vergence.errors import VergenceError

Command = Callable[..., Report]
_COMMANDS: tuple[Command, ...] = (
    reproduce, record, capture, calibrate, self_calibrate, plan, design, evaluate, budget, export,
    import_, import_recording, export_poses, foveate, track, grasp, depth, head,
)  # fmt: skip
COMMANDS: dict[str, Command] = {
    each.__name__.rstrip("_").replace("_", "-"): each for each in _COMMANDS
}
for _command in _COMMANDS:
    # tyro would keep the line breaks in descriptions of options.
    _command.__doc__ = re.sub(r"\n {8}", " ", getdoc(_command) or "")


def main() -> None:
    """Run the command line. A mistake of the user ends in one sentence and exit code 2."""
    if sys.argv[1:] == ["--version"]:
        from vergence import __version__

        print(f"vergence {__version__}")
        return
    # Before numpy is imported: matrices are small, and threads of BLAS would wait for each other.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Reports name damaged images; OpenCV would print lines of its source code, too.
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
    # A viewer that was closed is no error; rerun would print lines of its log.
    os.environ.setdefault("RUST_LOG", "off")
    with plain_ending("vergence"):
        report = parsed(sys.argv[1:])()
        with report.shown:
            print(report.summary(), flush=True)


def parsed(arguments: list[str]) -> Callable[[], Report]:
    """Bind a command to its arguments, or exit after --help; VergenceError if they are wrong."""
    if not arguments or arguments[0] not in COMMANDS:
        return _one_sentence(
            tyro.extras.subcommand_cli_from_dict,
            COMMANDS,
            prog=invocation("vergence"),
            description="Active 3-D vision: calibration, stereo and gaze control, and a twin. "
            "`vergence --version` prints the version.",
            args=arguments,
        )
    name, *rest = arguments
    prog = invocation("vergence", name)
    for before, argument in itertools.pairwise(arguments):
        if not argument or (argument.startswith("--") and argument.endswith("=")):
            raise VergenceError(
                f"The value after {(argument or before).rstrip('=')} is empty; a name or a number "
                f"belongs there. See {prog} --help."
            )
    command = COMMANDS[name]

    @wraps(command)
    def bind(*values: Any, **options: Any) -> Callable[[], Report]:
        return partial(command, *values, **options)

    return _one_sentence(tyro.cli, bind, prog=prog, args=rest)


def _one_sentence(parse: Callable[..., Any], *arguments: Any, prog: str, **options: Any) -> Any:
    """Call one of tyro's parsers; turn its boxed message into a VergenceError of one line."""
    box = io.StringIO()
    try:
        with redirect_stderr(box):
            return parse(*arguments, prog=prog, config=(tyro.conf.DisallowNone,), **options)
    except SystemExit as stop:
        if not stop.code:
            raise
    # tyro explains invalid values in terms of Python; the option's help is clearer.
    text = re.sub(r"(Error parsing \S+):.*?helptext:", r"\1; expected:", box.getvalue(), flags=re.S)
    text = re.split("Argument helptext|For full helptext", text)[0]
    lines = [line.strip("│| ") for line in text.splitlines()[1:]]
    words = " ".join(line for line in lines if line.strip("─-╰╯+ "))
    raise VergenceError(f"{words.rstrip('.')}. See {prog} --help.")
