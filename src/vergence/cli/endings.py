"""How a program of the command line ends: in one sentence and an exit code, never a traceback."""

from __future__ import annotations

import errno
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from vergence.errors import VergenceError
from vergence.writing import finished_files

FILES_NAMED = 10
"""Most files that a stopped command names of those that it has finished."""


@contextmanager
def plain_ending(program: str) -> Iterator[None]:
    """Run a program whose user sees no tracebacks.

    A mistake of the user ends in one sentence and exit code 2; Ctrl-C and SIGTERM end it with the
    names of the files that were finished, or with the note that was added to the interrupt.

    Args:
        program: its name, with which the sentence begins.
    """
    try:
        signal.signal(signal.SIGINT, _stop)
        signal.signal(signal.SIGTERM, _stop)
        try:
            yield
        finally:
            sys.stdout.flush()
    except VergenceError as error:
        print(f"{program}: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    except BrokenPipeError:  # whoever read the output has seen enough, such as `head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(128 + signal.SIGPIPE) from None
    except OSError as error:
        if error.errno != errno.ENOSPC or error.filename is not None:  # no file has been named
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        print(f"{program}: Cannot write to standard output: {error.strerror}.", file=sys.stderr)
        raise SystemExit(2) from None
    except KeyboardInterrupt as stop:
        done = finished_files()
        files = " ".join(map(str, done[-FILES_NAMED:]))
        files += f" and {len(done) - FILES_NAMED} more" if len(done) > FILES_NAMED else ""
        kept = f"finished before: {files}" if files else "nothing was written"
        kept = next(iter(getattr(stop, "__notes__", ())), kept)
        print(f"{program}: stopped; {kept}.", file=sys.stderr)
        raise SystemExit(128 + (stop.args[0] if stop.args else signal.SIGINT)) from None


def _stop(number: int, frame: object) -> None:
    """End as Ctrl-C does."""
    raise KeyboardInterrupt(number)
