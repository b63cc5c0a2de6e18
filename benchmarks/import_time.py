"""How long `import vergence` takes, as a multiple of importing the libraries that it needs.

    python benchmarks/import_time.py [--rounds 15]

Each import runs in a process of its own. The two alternate, so that a busy machine slows both; the
time of starting an interpreter without any import is subtracted from each. Prints the ratio of the
medians, and exits with 1 when it is above the bar.
"""

import subprocess
import sys
import time
from statistics import median

import tyro

LIBRARIES = "import numpy, scipy.spatial, cv2, pydantic"
BAR = 1.5


def seconds(statement: str) -> float:
    """Return the time that a new interpreter takes for a statement [s]."""
    begin = time.perf_counter()
    subprocess.run([sys.executable, "-c", statement], check=True)
    return time.perf_counter() - begin


def main(rounds: int = 15) -> None:
    """Compare the two imports.

    Args:
        rounds: measurements of each.
    """
    statements = ("pass", LIBRARIES, "import vergence")
    for statement in statements:
        seconds(statement)  # files and their bytecode are read once before any is timed
    times = [[seconds(statement) for statement in statements] for _ in range(rounds)]
    start, libraries, package = (median(column) for column in zip(*times, strict=True))
    ratio = (package - start) / (libraries - start)
    print(f"import vergence: {ratio:.2f} times {LIBRARIES.removeprefix('import ')} (bar {BAR})")
    print(f"medians of {rounds}: {package - start:.3f} s and {libraries - start:.3f} s")
    sys.exit(ratio > BAR)


if __name__ == "__main__":
    tyro.cli(main)
