"""One command with two heads: the default one, and one of a common tilt, version and vergence.

python scenarios/two_heads.py budget --profile paper
python scenarios/two_heads.py foveate --trials 3
"""

import sys

from vergence import cli
from vergence.cli.terminal import plain_ending
from vergence.twin.head_file import models_folder


def main() -> None:
    for name in ("cbi_head", "shared_tilt_head"):
        described = models_folder() / name / "head.toml"
        report = cli.parsed([*sys.argv[1:], "--head", str(described)])()
        print(f"{name}\n\n{report.summary()}\n")


if __name__ == "__main__":
    with plain_ending("two_heads"):
        main()
