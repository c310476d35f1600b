"""Time and memory of a pair of SICDs in blocks, with an elevation model; the error on the exactly known geometry.

    python benchmarks/sicd_scene.py OUT [--shape 12000x9000] [--relief 300] [--workers 2] [--block 600]

Simulates a pair of single-look scenes of that many rows (range) and columns (flight), kept in OUT, gives every pixel a
random phase and writes both as SICDs of complex64 by sarkit. Then `featreg match` runs on them as a user would, and is
measured from outside: wall and processor time, largest proportional memory of all its processes (Linux only), and the
error of the model, whose sensors are `SicdSensor`. Needs the extra `sicd`.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from scene import run_measured

from featreg.geolocation import SicdSensor
from featreg.results.registration import Registration
from featreg.simulate.orbit import RangeDoppler, Terrain
from featreg.simulate.scene import read_scene_truth, simulate_scene
from featreg.simulate.sicd import write_sicd

SEED = 11


def pair(folder: Path, rows: int, cols: int, relief: float) -> Path:
    """The folder of the pair, simulated where it is not there yet."""
    place = folder / f"{rows}x{cols}"
    if not (place / "truth.json").exists():
        print(f"simulating {rows} x {cols}", file=sys.stderr)
        simulate_scene(place, (cols, rows), relief=relief, looks=1, seed=SEED)
    truth = read_scene_truth(place / "truth.json")
    assert isinstance(truth.heights, Terrain)
    for index, name in enumerate(("reference", "secondary")):
        if not (place / f"{name}.nitf").exists():
            view = truth.reference if index == 0 else _unbiased(place, truth.secondary)
            assert isinstance(view, RangeDoppler)
            write_sicd(place / f"{name}.nitf", _samples(place / f"{name}.tif", index), view, truth.heights.level)
    return place


def _unbiased(place: Path, view: Any) -> Any:
    """What the secondary's file says of itself, which knows nothing of its bias."""
    from dataclasses import replace

    dx, dy = json.loads((place / "truth.json").read_text())["bias"]
    return replace(view, middle=(view.middle[0] - dx, view.middle[1] - dy))


def _samples(path: Path, index: int) -> Any:
    import rasterio

    with rasterio.open(path) as dataset:
        amplitude = dataset.read(1)
    rng = np.random.default_rng([SEED, index])
    samples = np.empty(amplitude.shape, np.complex64)
    for row, values in enumerate(amplitude):
        phase = rng.uniform(0, 2 * np.pi, len(values))
        samples[row] = values * np.exp(1j * phase)
    return samples


def projection(sensor: SicdSensor, shape: tuple[int, int], count: int = 200_000) -> dict[str, float]:
    """Points a second of the sensor's two directions, processor time on one thread."""
    xy = np.random.default_rng(0).uniform(0, [shape[1], shape[0]], (count, 2))
    heights = np.linspace(0.0, 3000.0, count)
    start = time.process_time()
    ground = sensor.image_to_ground(xy, heights)
    middle = time.process_time()
    back = sensor.ground_to_image(ground, heights)
    end = time.process_time()
    return {
        "to ground, points/s": round(count / (middle - start)),
        "to image, points/s": round(count / (end - middle)),
        "there and back, px": float(np.abs(back - xy).max()),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--shape", default="12000x9000")
    parser.add_argument("--relief", type=float, default=300.0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--block", type=int, default=600)
    given = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    rows, cols = (int(n) for n in given.shape.split("x"))
    place = pair(given.out, rows, cols, given.relief)
    out = place / "result.json"
    images = [str(place / f"{name}.nitf") for name in ("reference", "secondary")]
    command = ["match", *images, "--dem", str(place / "dem.tif"), "--model", "rpc-bias", "--block", str(given.block)]
    figures = run_measured([*command, "--workers", str(given.workers), "--json", str(out)])
    result = Registration.from_json(out)
    x, y = np.meshgrid(np.linspace(0.1, 0.9, 9) * cols, np.linspace(0.1, 0.9, 9) * rows)
    grid = np.column_stack([x.ravel(), y.ravel()])
    # The simulation counts range along x; the SICD has it along rows.
    off = (
        result.model(grid) - read_scene_truth(place / "truth.json")(grid[:, ::-1])[:, ::-1] if result.model else np.nan
    )
    figures |= {
        "size": f"{rows} x {cols}",
        "workers": given.workers,
        "status": result.status,
        "blocks": result.provenance["blocks"]["total"],
        "tie points": int(result.inliers.sum()),
        "grid RMSE px": round(float(np.sqrt(np.mean(np.sum(np.atleast_2d(off) ** 2, axis=1)))), 4),
    }
    sensor = getattr(result.model, "secondary", None)
    if isinstance(sensor, SicdSensor):
        figures |= projection(sensor, (rows, cols))
    print(json.dumps(figures), flush=True)


if __name__ == "__main__":
    main()
