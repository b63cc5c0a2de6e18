"""The command line: parses, calls, prints."""

from __future__ import annotations

import itertools
import os
import re
import sys
from collections.abc import Callable
from dataclasses import fields
from functools import partial, wraps
from inspect import Parameter, getdoc, signature
from typing import Annotated, Any, get_type_hints

import tyro

from vergence import __version__
from vergence.cli.accuracy import budget, design, plan
from vergence.cli.calibration import calibrate, evaluate, export, import_, self_calibrate
from vergence.cli.endings import plain_ending
from vergence.cli.experiments import (
    ExperimentOptions,
    depth,
    foveate,
    grasp,
    record,
    reproduce,
    track,
)
from vergence.cli.numbers import NUMBERS
from vergence.commands.invocation import invocation
from vergence.errors import VergenceError

CONFIG = (tyro.conf.DisallowNone,)
COMMANDS: dict[str, Callable[..., None]] = {
    "reproduce": reproduce,
    "record": record,
    "calibrate": calibrate,
    "self-calibrate": self_calibrate,
    "plan": plan,
    "design": design,
    "evaluate": evaluate,
    "budget": budget,
    "export": export,
    "import": import_,
    "foveate": foveate,
    "track": track,
    "grasp": grasp,
    "depth": depth,
}


def _hide_default_none(described: Any, names: list[str]) -> None:
    """Leave "(default: None)" out of the help of options whose text says what none means."""
    hints = get_type_hints(described, include_extras=True)
    silent = tyro.conf.arg(help_behavior_hint="")
    described.__annotations__ |= {name: Annotated[hints[name], silent] for name in names}


for _command in COMMANDS.values():
    # tyro would keep the line breaks in what is said of an option
    _command.__doc__ = re.sub(r"\n {8}", " ", getdoc(_command) or "")
    _parameters = signature(_command).parameters.values()
    _hide_default_none(_command, [each.name for each in _parameters if each.default is None])
_hide_default_none(
    ExperimentOptions, [each.name for each in fields(ExperimentOptions) if each.default is None]
)


def _check(arguments: list[str]) -> None:
    """Refuse an unknown command or option in one sentence."""
    if not arguments or arguments[0] in ("-h", "--help"):
        return
    name = arguments[0]
    if name not in COMMANDS:
        raise VergenceError(
            f"There is no command {name!r}; there are {', '.join(COMMANDS)}. "
            f"See {invocation('vergence', '--help')}."
        )
    known = options_of(COMMANDS[name])
    for before, argument in itertools.pairwise(arguments):
        if not argument or (argument.startswith("--") and argument.endswith("=")):
            raise VergenceError(
                f"The value after {(argument or before).rstrip('=')} is empty; a name or a number "
                f"belongs there. See {invocation('vergence', name, '--help')}."
            )
        option = argument.partition("=")[0].replace("_", "-")
        if option.startswith("--") and option not in (*known, "--help"):
            raise VergenceError(
                f"{name} has no option {argument!r}; it has {', '.join(known)}. "
                f"See {invocation('vergence', name, '--help')}."
            )


def _bound(name: str, arguments: list[str]) -> Callable[[], None]:
    """Return a command with the values of its options; exit or VergenceError where they are wrong.

    tyro would only list what is one argument too many, and would do so as an option.
    """
    command = COMMANDS[name]

    @wraps(command)
    def bind(*values: Any, **options: Any) -> Callable[[], None]:
        return partial(command, *values, **options)

    bound, surplus = tyro.cli(
        bind,
        prog=invocation("vergence", name),
        args=arguments,
        config=CONFIG,
        registry=NUMBERS,
        return_unknown_args=True,
    )
    if surplus:
        raise VergenceError(
            f"{name} does not take {surplus[0]!r}: it is one argument too many. "
            f"See {invocation('vergence', name, '--help')}."
        )
    return bound


def options_of(command: Callable[..., None]) -> list[str]:
    """Return the options of a command, with those that experiments have in common."""
    parameters = signature(command).parameters.values()
    names = [each.name for each in parameters if each.kind is Parameter.KEYWORD_ONLY]
    if names[-1] == "options":
        names[-1:] = [field.name for field in fields(ExperimentOptions)]
    return [f"--{name.replace('_', '-')}" for name in names]


def main() -> None:
    """Run the command line; a mistake of the user ends in one sentence and exit code 2."""
    if sys.argv[1:] == ["--version"]:
        print(f"vergence {__version__}")
        return
    # The matrices are small: threads of linear algebra would wait for each other. Before numpy.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # A damaged image is named in the report; OpenCV would print lines of its own source besides.
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
    with plain_ending("vergence"):
        arguments = sys.argv[1:]
        _check(arguments)
        if arguments and arguments[0] in COMMANDS:
            _bound(arguments[0], arguments[1:])()
            return
        tyro.extras.subcommand_cli_from_dict(
            COMMANDS,
            prog=invocation("vergence"),
            description="Active 3-D vision: calibration, stereo and gaze control, and a twin. "
            "`vergence --version` prints the version.",
            config=CONFIG,
        )
