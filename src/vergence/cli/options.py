"""Types of options, as `vergence COMMAND --help` shows them, and how numbers are parsed."""

from __future__ import annotations

from pathlib import Path
from types import NoneType
from typing import Annotated, Any, Literal, get_args, get_origin

import tyro
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

_ABSENT = tyro.conf.arg(help_behavior_hint="")
"""For an option whose description states what its absence means."""

Positional = tyro.conf.Positional
Flag = Annotated[bool, tyro.conf.FlagCreatePairsOff]
OptionalPath = Annotated[Path | None, _ABSENT]
OptionalText = Annotated[str | None, _ABSENT]
OptionalInt = Annotated[int | None, _ABSENT]
OptionalFloat = Annotated[float | None, _ABSENT]
OptionalFloats = Annotated[tuple[float, ...] | None, _ABSENT]
OptionalBoard = Annotated[
    tuple[int, int, float] | None,
    tyro.conf.arg(metavar="COLUMNS ROWS SQUARE_M", help_behavior_hint=""),
]
Points = Annotated[tuple[tuple[float, float, float], ...], tyro.conf.UseAppendAction]
Scene = Literal["room", "sparse", "moving"]
"""As in `twin.scene.room`, whose import needs OpenGL."""
OptionalScene = Annotated[Scene | None, _ABSENT]
Geometry = Literal["joints", "seen"]
"""As in `self_calibration.calibrator`, whose import needs numpy."""

NUMBERS = ConstructorRegistry()
"""Rules by which tyro parses numbers."""
_KINDS = {int: ("INT", "a whole number"), float: ("FLOAT", "a number without a unit")}


@NUMBERS.primitive_rule
def _numbers(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    """Parse a number or a tuple of numbers, optional or not."""
    kind: Any = info.type
    if NoneType in get_args(kind):
        (kind,) = (each for each in get_args(kind) if each is not NoneType)
    single = get_origin(kind) is not tuple
    members = (kind,) if single else get_args(kind)
    repeated = members[-1] is Ellipsis
    if not all(each in _KINDS for each in (members[:1] if repeated else members)):
        return None

    def parse(words: list[str]) -> Any:
        kinds = members[:1] * len(words) if repeated else members
        values = [_parse(*each) for each in zip(kinds, words, strict=True)]
        return values[0] if single else tuple(values)

    names = [_KINDS[each][0] for each in (members[:1] if repeated else members)]
    return PrimitiveConstructorSpec(
        nargs="*" if repeated else len(members),
        metavar=f"[{names[0]} [{names[0]} ...]]" if repeated else " ".join(names),
        instance_from_str=parse,
        is_instance=lambda value: isinstance(value, int | float | tuple),
        str_from_instance=lambda value: [*map(str, value if isinstance(value, tuple) else [value])],
    )


def _parse(kind: type, word: str) -> Any:
    try:
        return kind(word)
    except ValueError:
        raise ValueError(f"expected {_KINDS[kind][1]}, found {word!r}") from None
