"""The entry of the command line: `vergence`, or `python -m vergence`.

Until the command line is imported, which takes half a second, Ctrl-C ends the process without a
traceback; from then on `cli.main` says what was finished.
"""

import signal


def main() -> None:
    """Run the command line."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    from vergence.cli import main as run

    run()


if __name__ == "__main__":
    main()
