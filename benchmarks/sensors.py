"""Range-Doppler sensors against the geolocation grids of Sentinel-1 annotations, and their speed.

    python benchmarks/sensors.py FOLDER

FOLDER holds SAFE products, whose measurements need not be there. Public ones: the test data of
https://github.com/bopen/xarray-sentinel (Apache-2.0). The grid gives longitude, latitude and height of points of known
pixel, line, azimuth time and slant range. A line of a TOPS image may be given in the neighbouring burst, so the azimuth
is compared by its time.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np
from measuring import table

from featreg.geolocation import RangeDopplerSensor, sensor_from_dict
from featreg.io.products.sentinel1 import grid_of, parsed, sensor_of_annotation


def compared(path: Path) -> list[Any]:
    """One row of the table: what the sensor of an annotation is off by on its grid."""
    sensor = sensor_from_dict(sensor_of_annotation(path))
    assert isinstance(sensor, RangeDopplerSensor)
    root = parsed(path)
    grid = np.array(list(grid_of(root)))
    seen = sensor.ground_to_image(grid[:, 2:4], grid[:, 4])
    when, _ = sensor.zero_doppler(grid[:, 2:4], grid[:, 4])
    across = np.abs(seen[:, 0] - grid[:, 0])
    along = np.abs(when - grid[:, 5]) / abs(sensor.line_interval)
    if sensor.bursts is None:
        along = np.maximum(along, np.abs(seen[:, 1] - grid[:, 1]))
    orbit = root.findtext("imageAnnotation/processingInformation/orbitSource") or ""
    name = " ".join(path.stem.upper().split("-")[:4])
    return [name, orbit.lower(), len(grid), f"{across.max():.4f}", f"{along.max():.4f}"]


def speed(path: Path, count: int = 1_000_000) -> dict[str, int]:
    """Points a second in both directions, processor time on one thread."""
    sensor = sensor_from_dict(sensor_of_annotation(path))
    height, width = sensor_of_annotation(path)["shape"]
    xy = np.random.default_rng(0).uniform(0, [width, height], (count, 2))
    ground = sensor.image_to_ground(xy[:10], 0.0)
    sensor.ground_to_image(ground, 0.0)
    start = time.process_time()
    ground = sensor.image_to_ground(xy, 500.0)
    middle = time.process_time()
    sensor.ground_to_image(ground, 500.0)
    end = time.process_time()
    return {"to ground": round(count / (middle - start)), "to image": round(count / (end - middle))}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    given = parser.parse_args()
    files = sorted(given.folder.glob("**/*.SAFE/annotation/*.xml"))
    if not files:
        raise SystemExit(f"{given.folder}: holds no annotation of a SAFE product")
    heads = ["product", "orbit", "points", "range, worst px", "azimuth, worst px"]
    print(table(heads, [compared(path) for path in files]))
    for path in files[:1] + files[-1:]:
        print(path.stem, speed(path))


if __name__ == "__main__":
    main()
