"""Displacement fields beside OpenCV's matchTemplate with a parabola: time, errors; and time and memory of large images.

    python benchmarks/offsets.py [--side 600] [--step 16] [--window 64] [--search 16] [--rounds 5] [--seeds 0,1,2]
    python benchmarks/offsets.py --scene OUT [--sizes 2500x2750,10000x11000] [--workers 1]

The first compares on simulated glaciers. matchTemplate gets the same windows, the same largest shift and the same
band-passed log-amplitude, whose making is in its time. The second runs `featreg offsets` on 16-bit files of that size,
made by repeating a small pair with mirrored neighbours and kept in OUT, and measures it from outside, as scene.py does.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from measuring import machine, measure, on_one_thread, round_count, table
from numpy.typing import NDArray
from scene import run_measured

import featreg
from featreg.displacement.band import band
from featreg.displacement.cells import CellGrid
from featreg.simulate import DisplacedPair, displaced_pair

#: Side of the small pair that is repeated, px.
TILE = 600


def by_opencv(pair: DisplacedPair, grid: CellGrid, search: int) -> NDArray[np.float64]:
    """(rows, cols, 2) displacement of each cell by matchTemplate and a parabola along each axis; NaN at the rim."""
    first, second = (
        band(cv2.log(np.maximum(image, 1e-3)).astype(np.float32)) for image in (pair.reference, pair.secondary)
    )
    out = np.full((*grid.cells, 2), np.nan)
    height, width = first.shape
    for j, top in enumerate(grid.tops):
        for i, left in enumerate(grid.lefts):
            low, right = top + grid.window + search, left + grid.window + search
            if top < search or left < search or low > height or right > width:
                continue
            surface = cv2.matchTemplate(
                second[top - search : low, left - search : right],
                first[top : top + grid.window, left : left + grid.window],
                cv2.TM_CCOEFF_NORMED,
            )
            _, _, _, (x, y) = cv2.minMaxLoc(surface)
            if 0 < x < 2 * search and 0 < y < 2 * search:
                out[j, i] = (
                    x - search + vertex(surface[y, x - 1 : x + 2]),
                    y - search + vertex(surface[y - 1 : y + 2, x]),
                )
    return out


def vertex(values: NDArray[Any]) -> float:
    """Where the parabola through three equidistant values has its extreme, from the one in the middle."""
    before, here, after = (float(value) for value in values)
    bend = before - 2 * here + after
    return 0.0 if bend == 0 else (before - after) / (2 * bend)


def truth(pair: DisplacedPair, grid: CellGrid) -> NDArray[np.float32]:
    """(rows, cols, 2) displacement of the middles of the cells, between pixels for windows of even sides."""
    x, y = (n.astype(np.float32) for n in np.meshgrid(grid.x, grid.y))
    return np.asarray(cv2.remap(pair.displacement, x, y, cv2.INTER_LINEAR), np.float32)


def compared(given: argparse.Namespace) -> list[list[Any]]:
    """One line for each seed."""
    lines = []
    for seed in given.seeds.split(","):
        pair = displaced_pair("glacier", (given.side, given.side), seed=int(seed))
        grid = CellGrid(pair.reference.shape, given.step, given.window)

        def ours(pair: DisplacedPair = pair) -> featreg.Offsets:
            return featreg.offsets(
                pair.reference, pair.secondary, step=given.step, window=given.window, search=given.search, workers=1
            )

        def theirs(pair: DisplacedPair = pair, grid: CellGrid = grid) -> NDArray[np.float64]:
            return by_opencv(pair, grid, given.search)

        seconds = measure({"ours": ours, "theirs": theirs}, given.rounds)
        field, other, right = ours(), theirs(), truth(pair, grid)
        both = field.good & np.isfinite(other).all(axis=-1)
        errors = [np.hypot(*(moved - right)[both].T) for moved in (np.stack([field.dx, field.dy], axis=-1), other)]
        lines.append(
            [
                seed, str(seconds["ours"]), str(seconds["theirs"]),
                seconds["theirs"].median / seconds["ours"].median, int(both.sum()),
                *(float(np.median(e)) for e in errors), *(float(np.percentile(e, 95)) for e in errors),
            ]
        )  # fmt: skip
    return lines


def files_of(folder: Path, rows: int, cols: int) -> list[str]:
    """The two images of a size, made where they are not there yet."""
    import rasterio
    from rasterio.windows import Window

    pair = displaced_pair("glacier", (TILE, TILE), seed=0)
    names = []
    for kind, image in (("reference", pair.reference), ("secondary", pair.secondary)):
        path = folder / f"{kind}_{rows}x{cols}.tif"
        names.append(str(path))
        if path.exists():
            continue
        print(f"writing {path}", file=sys.stderr)
        tile = np.clip(np.rint(image * (200 / image.mean())), 1, 65535).astype(np.uint16)
        profile: Any = {"driver": "GTiff", "dtype": "uint16", "count": 1, "height": rows, "width": cols}
        profile |= {"tiled": True, "blockxsize": 256, "blockysize": 256}
        with rasterio.open(path, "w", **profile) as out:
            for j, top in enumerate(range(0, rows, TILE)):
                for i, left in enumerate(range(0, cols, TILE)):
                    part = tile[:: (-1) ** j, :: (-1) ** i][: rows - top, : cols - left]
                    out.write(part, 1, window=Window(left, top, part.shape[1], part.shape[0]))
    return names


def large(given: argparse.Namespace) -> None:
    """Print a line for each size."""
    given.scene.mkdir(parents=True, exist_ok=True)
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    for size in given.sizes.split(","):
        rows, cols = (int(n) for n in size.split("x"))
        command = ["offsets", *files_of(given.scene, rows, cols), "-o", str(given.scene / "offsets.tif")]
        command += ["--step", str(given.step), "--window", str(given.window), "--search", str(given.search)]
        figures = run_measured([*command, "--workers", str(given.workers)])
        figures["ns a pixel"] = round(1e9 * figures["processor s"] / (rows * cols), 1)
        print(json.dumps({"size": size, "workers": given.workers, **figures}), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--side", type=int, default=600)
    parser.add_argument("--step", type=int, default=16)
    parser.add_argument("--window", type=int, default=64)
    parser.add_argument("--search", type=int, default=16)
    parser.add_argument("--rounds", type=round_count, default=5)
    parser.add_argument("--seeds", default="0,1,2")
    parser.add_argument("--scene", type=Path)
    parser.add_argument("--sizes", default="2500x2750,10000x11000")
    parser.add_argument("--workers", type=int, default=1)
    given = parser.parse_args()
    if given.scene is not None:
        large(given)
        return
    on_one_thread()
    print(f"{machine()}\n{given.side} x {given.side} px, CPU ms with quartiles over {given.rounds} rounds\n")
    columns = ["seed", "featreg", "matchTemplate", "times as fast", "cells of both"]
    columns += ["median error px", "of matchTemplate", "95 % px", "of matchTemplate"]
    print(table(columns, compared(given)))


if __name__ == "__main__":
    main()
