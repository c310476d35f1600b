"""Memory and time of what a stack writes, against the size of its images: GeoTIFFs, one NetCDF cube, arrays.

    python benchmarks/stack.py [--sides 2000,6000] [--images 3] [--out DIR]

Images of Rayleigh speckle, of one float32 sample a pixel, turned by 0.2 degrees from date to date; the models are
given, nothing is matched. Every figure is of a process of its own: largest resident memory less that after the imports,
and processor time. The arrays of `Stack.warp()` without a folder are the result itself and are held whole.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from measuring import machine, table

from featreg import Stack
from featreg.geometry import Rigid
from featreg.io import write_geotiff

WAYS = ("tiffs", "cube", "arrays")


def made(folder: Path, side: int, count: int) -> Path:
    """The file of a stack of `count` images of `side` x `side` px."""
    names, models = [], []
    for k in range(count):
        rng = np.random.default_rng(k)
        path = folder / f"date{k}_{side}.tif"
        if not path.exists():
            write_geotiff(path, rng.rayleigh(1.0, (side, side)).astype(np.float32))
        names.append(str(path))
        models.append(Rigid(0.2 * k, 1.5 * k, -2.0 * k))
    stack = Stack(
        names, 0, (side, side), models, ["ok"] * count, [""] * count, np.zeros(count), [None] * count, [], [], [],
        {"options": {}, "pairs": None}, names,
    )  # fmt: skip
    stack.to_json(folder / f"stack_{side}.json")
    return folder / f"stack_{side}.json"


def written(file: Path, way: str, target: Path) -> dict[str, float]:
    """What one way of writing takes; in a process of its own."""
    import rasterio  # noqa: F401  # its share is not the product's

    stack = Stack.from_json(file)
    before, start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    if way == "tiffs":
        stack.warp(target / "aligned")
    elif way == "cube":
        stack.to_file(target / "cube.nc")
    else:
        stack.warp()
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    return {"MB": round(grown / 1024), "processor s": round(time.process_time() - start, 1)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sides", default="2000,6000")
    parser.add_argument("--images", type=int, default=3)
    parser.add_argument("--out", type=Path, help="folder in which the images are kept")
    parser.add_argument("--measure", nargs=3, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.measure:
        file, way, target = given.measure
        print(json.dumps(written(Path(file), way, Path(target))))
        return
    rows: list[list[Any]] = []
    with tempfile.TemporaryDirectory() as temporary:
        folder = given.out or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        for side in (int(n) for n in given.sides.split(",")):
            file = made(folder, side, given.images)
            for way in WAYS:
                with tempfile.TemporaryDirectory(dir=folder) as target:
                    command = [sys.executable, __file__, "--measure", str(file), way, target]
                    done = subprocess.run(command, capture_output=True, text=True, check=True)
                found = json.loads(done.stdout)
                rows.append([f"{given.images} x {side} x {side}", way, found["MB"], found["processor s"]])
    print(table(["images", "written as", "MB", "processor s"], rows))
    print(f"\n{machine()}")


if __name__ == "__main__":
    main()
