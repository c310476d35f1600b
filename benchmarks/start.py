"""From the shell to the result: CPU seconds of whole commands, each time in a fresh process.

    python benchmarks/start.py [--rounds 5] [--numba]

"first" commands find nothing that an earlier one kept: they use the machine code that was prepared when the package was
built here, as another processor they make it of the bitcode beside the kernels (`FEATREG_KERNELS=bitcode`), or numba
makes it (`FEATREG_KERNELS=numba`, half a minute, with --numba). All cases run in turn within each round.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from measuring import Timing, machine, round_count, table

from featreg.simulate import sar_pair

COLUMNS = ("command", "CPU ms, median (quartiles)", "at most", "met")
COMMAND = "from featreg.cli.main import main; raise SystemExit(main())"


def seconds(arguments: list[str], **variables: str) -> float:
    """CPU seconds of one command."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    done = subprocess.run(
        [sys.executable, *arguments], env=kept | variables, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise SystemExit(f"{arguments}: {done.stderr}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return (after.ru_utime - before.ru_utime) + (after.ru_stime - before.ru_stime)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=round_count, default=5)
    parser.add_argument("--numba", action="store_true", help="also the first command by numba alone, once")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        pair = sar_pair((600, 600), seed=3)
        for name, image in (("a", pair.reference), ("b", pair.secondary)):
            np.save(root / f"{name}.npy", image)
        match = ["-c", COMMAND, "match", str(root / "a.npy"), str(root / "b.npy"), "--seed", "0"]
        first = "featreg match, 600 x 600, first"
        other = f"{first}, as on another processor"
        cases: dict[str, tuple[list[str], float | None]] = {
            "python, for comparison": (["-c", "pass"], None),
            "import numpy, cv2 and rasterio, for comparison": (["-c", "import numpy, cv2, rasterio"], None),
            "featreg --help": (["-c", COMMAND, "--help"], 0.15),
            "featreg match, 600 x 600, warm": (match, 1.0),
            first: (match, 15.0),
            other: (match, 15.0),
        }
        samples: dict[str, list[float]] = {name: [] for name in cases}
        # Bytecode of an installation is there already.
        shared = {"PYTHONPYCACHEPREFIX": str(root / "bytecode"), "NUMBA_CACHE_DIR": str(root / "warm")}
        for number in range(given.rounds + 1):
            for name, (arguments, _) in cases.items():
                variables = dict(shared)
                if name in (first, other):
                    variables["NUMBA_CACHE_DIR"] = str(root / f"{len(name)}-{number}")
                if name == other:
                    variables["FEATREG_KERNELS"] = "bitcode"
                taken = seconds(arguments, **variables)
                if number:
                    samples[name].append(taken)
        rows: list[list[Any]] = []
        for name, (_, most) in cases.items():
            timing = Timing.of(samples[name])
            met = "" if most is None else "yes" if timing.median <= most else "NO"
            rows.append([name, timing, "" if most is None else f"{1e3 * most:.0f}", met])
        if given.numba:
            fresh = {"NUMBA_CACHE_DIR": str(root / "numba"), "FEATREG_KERNELS": "numba"}
            rows.append([f"{first}, numba", f"{1e3 * seconds(match, **(shared | fresh)):.0f}", "", ""])
    print(f"## Start\n\n{machine()}; CPU time of whole processes, {given.rounds} rounds\n\n{table(COLUMNS, rows)}\n")


if __name__ == "__main__":
    main()
