"""Reading and writing YAML for the formats that use it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, TypeVar

import yaml
from pydantic import BeforeValidator, FiniteFloat, TypeAdapter, ValidationError

from vergence.errors import VergenceError
from vergence.files import write_whole

T = TypeVar("T")


def _number(value: Any) -> Any:
    # YAML 1.1 takes 1e-5, without a point, for text; other programs write it so.
    return float(value) if isinstance(value, str) else value


Number = Annotated[FiniteFloat, BeforeValidator(_number)]


def dump(path: Path, content: dict[str, Any]) -> None:
    """Write YAML: lists of numbers in one line each, and floats so that they read back exactly."""
    text = yaml.safe_dump(content, default_flow_style=None, sort_keys=False, width=1000)
    write_whole(path, text)


def first_message(error: ValueError) -> str:
    """Return what is wrong, in one line without a full stop."""
    text = error.errors()[0]["msg"] if isinstance(error, ValidationError) else str(error)
    return " ".join(text.removeprefix("Value error, ").split()).rstrip(".")


def read(path: Path, adapter: TypeAdapter[T], what: str) -> T:
    """Read YAML and check it.

    Args:
        path: of the file.
        adapter: of the type that is expected.
        what: how a message calls such a file.

    Raises:
        VergenceError: the file is missing, not YAML, or not what was expected.
    """
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8-sig"))
        return adapter.validate_python(content)
    except OSError as error:
        raise VergenceError(f"Cannot read {path}: {error.strerror}.") from error
    except ValidationError as error:
        where = ".".join(map(str, error.errors()[0]["loc"])) or "the file"
        raise VergenceError(f"{path} is not {what}: {where}: {first_message(error)}.") from None
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        reason = " ".join(str(error).split()).rstrip(".")
        raise VergenceError(f"{path} is not valid YAML: {reason}.") from None
