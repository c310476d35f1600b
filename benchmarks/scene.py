"""Time and memory of a scene pair in blocks, against its area and the number of workers.

    python benchmarks/scene.py OUT [--sizes 2500x2750,5000x5500] [--workers 1,2] [--block PX] [--method sar-orb]
        [--rounds 3]
    python benchmarks/scene.py OUT --side 40000 [--kill] [--workers 2]

Simulates each pair once (kept in OUT; with `--side` a square pair of real texture, see `wide_pair.py`), then runs
`featreg match` on it as a user would and measures from outside: wall time, processor time of all processes, also of a
megapixel over that of OpenCV's ORB on the first megapixel (median and quartiles over the rounds and the tries of ORB
before and after each), largest proportional memory of the command and of all its processes together (Linux only), and
the error of the model on the truth. With `--kill` then as a run that keeps its blocks, loses a worker after a quarter
of the time and is killed after half of it, and as the run that goes on from there.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rasterio
from large import eight_bits, orb
from rasterio.windows import Window
from wide_pair import wide_pair

from featreg.geometry import Affine
from featreg.results.json_file import tie_point_file
from featreg.results.registration import Registration
from featreg.simulate.scene import read_scene_truth, simulate_scene


def pair(folder: Path, rows: int, cols: int) -> Path:
    """The folder of the pair of that size, simulated where it is not there yet."""
    place = folder / f"{rows}x{cols}"
    if not (place / "truth.json").exists():
        print(f"simulating {rows} x {cols}", file=sys.stderr)
        simulate_scene(place, (rows, cols), relief=100.0, seed=rows)
    return place


def proportional(process: int) -> int:
    """Proportional set size in bytes: shared pages count once over all processes that share them."""
    try:
        with open(f"/proc/{process}/smaps_rollup") as lines:
            return sum(int(line.split()[1]) * 1024 for line in lines if line.startswith("Pss:"))
    except OSError:
        return 0


def family(process: int) -> list[int]:
    """A process and all below it."""
    found, todo = [], [process]
    while todo:
        one = todo.pop()
        found.append(one)
        for children in Path(f"/proc/{one}/task").glob("*/children"):
            try:
                todo += [int(child) for child in children.read_text().split()]
            except OSError:
                continue
    return found


@dataclass
class Watched:
    """What a process and all below it took, seen from outside.

    `memory` holds rows of (seconds since the start, proportional bytes of the command, of all processes), `said` the
    last line on its standard error.
    """

    code: int
    wall_s: float
    processor_s: float
    memory: list[tuple[float, int, int]]
    said: str

    def figures(self) -> dict[str, Any]:
        """Wall and processor time and the largest memory."""
        return {
            "wall s": round(self.wall_s, 2),
            "processor s": round(self.processor_s, 2),
            "MB command": max((row[1] for row in self.memory), default=0) >> 20,
            "MB all": max((row[2] for row in self.memory), default=0) >> 20,
        }


def watched(arguments: list[str], *, every: float = 0.1, after: Callable[[float, int], None] | None = None) -> Watched:
    """Run `featreg` with these arguments to its end.

    Parameters
    ----------
    arguments : of the command
    every : seconds between two looks at the memory
    after : called at each look with the seconds since the start and the number of the process, to do it harm
    """
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    memory: list[tuple[float, int, int]] = []
    with tempfile.TemporaryFile() as said:
        start = time.perf_counter()
        process = subprocess.Popen(
            [sys.executable, "-m", "featreg", *arguments], stdout=subprocess.DEVNULL, stderr=said
        )
        while process.poll() is None:
            sizes = [proportional(p) for p in family(process.pid)]
            seconds = time.perf_counter() - start
            memory.append((seconds, sizes[0], sum(sizes)))
            if after is not None:
                after(seconds, process.pid)
            with suppress(subprocess.TimeoutExpired):
                process.wait(every)
        seconds = time.perf_counter() - start
        said.seek(0)
        lines = said.read().decode(errors="replace").splitlines()
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    used = ended.ru_utime + ended.ru_stime - before.ru_utime - before.ru_stime
    return Watched(process.returncode, seconds, used, memory, lines[-1] if lines else "")


def run_measured(arguments: list[str]) -> dict[str, Any]:
    """Run `featreg` with these arguments; wall and processor time and the largest proportional memory."""
    done = watched(arguments)
    if done.code not in (0, 3):  # 3: not trusted, and written
        raise SystemExit(f"featreg {arguments[0]} ended with {done.code}")
    return done.figures()


def truth_of(place: Path) -> Callable[[Any], Any]:
    """The map of a pair's truth.json, reference -> secondary."""
    known = json.loads((place / "truth.json").read_text())
    return Affine(np.array(known["matrix"])) if "matrix" in known else read_scene_truth(place / "truth.json")


def killed(place: Path, workers: int, block: int | None, method: str, seconds: float) -> tuple[Path, dict[str, Any]]:
    """Run the command so that it keeps its blocks, kill a worker after a quarter of `seconds` and all after half.

    Returns
    -------
    folder, row : of the blocks; what was there then
    """
    folder = place / "blocks"
    shutil.rmtree(folder, ignore_errors=True)
    dead: list[int] = []

    def harm(now: float, process: int) -> None:
        below = family(process)[1:]
        if now > seconds / 4 and below and not dead:
            dead.append(below[-1])
            os.kill(below[-1], signal.SIGKILL)
        if now > seconds / 2 and process not in dead:
            dead.append(process)
            os.kill(process, signal.SIGKILL)

    out = place / "result.json"
    done = watched([*command_of(place, workers, block, method, out), "--resume", str(folder)], after=harm)
    files = list(folder.glob("*.npz"))
    size = sum(file.stat().st_size for file in files)
    row = {"killed after s": round(done.wall_s, 1), "blocks kept": len(files), "MB of them": size >> 20}
    return folder, row


def orb_seconds(place: Path) -> list[float]:
    """Processor time of ORB's pair on the first megapixel of both scenes."""
    pair = []
    for role in ("reference", "secondary"):
        with rasterio.open(place / f"{role}.tif") as file:
            pair.append(eight_bits(file.read(1, window=Window(0, 0, 1000, 1000))))
    taken = []
    for _ in range(4):
        start = time.process_time()
        orb((pair[0], pair[1]), 2000)
        taken.append(time.process_time() - start)
    return taken[1:]


def command_of(place: Path, workers: int, block: int | None, method: str, out: Path) -> list[str]:
    """The command that registers a pair."""
    command = ["match", str(place / "reference.tif"), str(place / "secondary.tif"), "--method", method]
    command += ["--workers", str(workers), "--json", str(out)]
    if (place / "dem.tif").exists():
        command += ["--dem", str(place / "dem.tif"), "--model", "rpc-bias"]
    return command if block is None else [*command, "--block", str(block)]


def measured(
    place: Path, workers: int, block: int | None, method: str, rounds: int = 1, more: Sequence[str] = ()
) -> dict[str, Any]:
    """Run the command, with `more` options, on a pair, ORB before and after it; what it took and how well it did."""
    out = place / "result.json"
    command = [*command_of(place, workers, block, method, out), *more]
    yardstick, runs = orb_seconds(place), []
    for _ in range(rounds):
        runs.append(run_measured(command))
        yardstick += orb_seconds(place)
    runs.sort(key=lambda run: float(run["processor s"]))
    figures, seconds = runs[len(runs) // 2], np.array([run["processor s"] for run in runs])
    result = Registration.from_json(out)
    if result.reference is None:
        raise SystemExit(f"{out} does not say the size of its reference")
    height, width = result.reference.shape
    beside = tie_point_file(out)
    x, y = np.meshgrid(np.linspace(0.1, 0.9, 9) * width, np.linspace(0.1, 0.9, 9) * height)
    grid = np.column_stack([x.ravel(), y.ravel()])
    off = np.zeros(1) if not result.model else result.model(grid) - truth_of(place)(grid)
    blocks = result.provenance["blocks"]["total"]
    ratio = np.percentile(np.divide.outer(seconds / (width * height / 1e6), np.array(yardstick)), [50, 25, 75])
    return {
        "size": f"{height} x {width}",
        "method": method,
        "status": result.status,
        "workers": workers,
        "blocks": blocks,
        "px a block": result.provenance["blocks"]["size"],
        **figures,
        "ms a block": round(1000 * sum(result.provenance["block_seconds"].values()) / blocks, 1),
        "a megapixel over ORB's (quartiles)": "{:.2f} ({:.2f} to {:.2f})".format(*ratio),
        "ns a pixel": round(1e9 * figures["processor s"] / (width * height), 1),
        "reused": result.provenance["blocks"]["reused"],
        "MB result": (out.stat().st_size + (beside.stat().st_size if beside.exists() else 0)) >> 20,
        "s beside blocks": {k: round(v, 2) for k, v in result.timings.items() if k != "blocks"},
        "tie points": int(result.inliers.sum()),
        "grid RMSE px": round(float(np.sqrt(np.mean(np.sum(np.atleast_2d(off) ** 2, axis=1)))), 4),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--sizes", default="2500x2750,5000x5500")
    parser.add_argument("--workers", default="1,2")
    parser.add_argument("--side", type=int, help="of a square pair of real texture, in place of --sizes")
    parser.add_argument("--kill", action="store_true")
    parser.add_argument("--block", type=int, help="side of a block, px; what suits the scene where not given")
    parser.add_argument("--method", default="sar-orb")
    parser.add_argument("--rounds", type=int, default=3)
    given = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    cv2.setNumThreads(1)
    if given.side is None:
        places = [pair(given.out, *(int(n) for n in size.split("x"))) for size in given.sizes.split(",")]
    else:
        places = [wide_pair(given.out, (given.side, given.side))]
    for place in places:
        if given.side is None:
            measured(place, 1, given.block, given.method)  # compiled kernels and page cache
        for workers in given.workers.split(","):
            row = measured(place, int(workers), given.block, given.method, given.rounds)
            print(json.dumps(row), flush=True)
            if given.kill:
                folder, kept = killed(place, int(workers), given.block, given.method, row["wall s"])
                print(json.dumps(kept), flush=True)
                row = measured(place, int(workers), given.block, given.method, more=["--resume", str(folder)])
                print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
