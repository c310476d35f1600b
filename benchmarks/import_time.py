"""How long it takes until `featreg` can be used, each time in a fresh interpreter.

python benchmarks/import_time.py [--rounds 9]
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from typing import Any

from measuring import Timing, machine, round_count, table

BARE = "pass"
CASES = {
    "import featreg": ("import featreg", 0.3),
    "import featreg, featreg.match looked up": ("import featreg; featreg.match", None),
    "names of all plugins": ("import featreg; featreg.available('detector')", None),
    "import numpy, for comparison": ("import numpy", None),
    "import cv2, for comparison": ("import cv2", None),
}
COLUMNS = ("case", "ms beyond a bare interpreter, median (quartiles)", "at most", "met")


def seconds(code: str) -> float:
    start = time.perf_counter()
    subprocess.run([sys.executable, "-c", code], check=True)
    return time.perf_counter() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=round_count, default=9)
    given = parser.parse_args()
    codes = [BARE, *(code for code, _ in CASES.values())]
    samples: dict[str, list[float]] = {code: [] for code in codes}
    for number in range(given.rounds + 1):
        for code in codes:
            taken = seconds(code)
            if number:
                samples[code].append(taken)
    bare = Timing.of(samples[BARE]).median
    rows: list[list[Any]] = []
    for name, (code, most) in CASES.items():
        timing = Timing.of([taken - bare for taken in samples[code]])
        met = "" if most is None else "yes" if timing.median <= most else "NO"
        rows.append([name, timing, "" if most is None else f"{1e3 * most:.0f}", met])
    print(f"## Import\n\n{machine()}; wall time, {given.rounds} rounds\n\n{table(COLUMNS, rows)}\n")


if __name__ == "__main__":
    main()
