"""What the benchmarks share: one thread, interleaved rounds, medians with spread, and the images.

The contract that they follow stands in benchmarks/README.md.
"""

from __future__ import annotations

import argparse
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from featreg.runtime.threads import THREAD_VARIABLES
from featreg.runtime.versions import versions
from featreg.simulate import sar_pair, similarity_matrix

DATA = Path(os.environ.get("FEATREG_DATA", Path(__file__).parents[2] / "shared" / "data"))

# Shortest time of one sample; quicker functions are repeated inside it.
SAMPLE_S = 0.005


def round_count(text: str) -> int:
    """A number of rounds, as argparse takes it: at least 1."""
    if int(text) < 1:
        raise argparse.ArgumentTypeError(f"at least 1 round is needed, got {text}")
    return int(text)


def on_one_thread(*, pinned: bool = True) -> None:
    """Start the script again with one thread for every library and, if `pinned` and possible, on one core."""
    if any(os.environ.get(name) != "1" for name in THREAD_VARIABLES):
        done = subprocess.run(
            [sys.executable, *sys.argv], env={**os.environ, **dict.fromkeys(THREAD_VARIABLES, "1")}, check=False
        )
        sys.exit(done.returncode)
    cv2.setNumThreads(1)
    if pinned and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})


def machine() -> str:
    """One line: processor, cores, system, versions."""
    name = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        models = [
            line.split(":", 1)[1].strip() for line in info.read_text().splitlines() if line.startswith("model name")
        ]
        name = models[0] if models else name
    made = ", ".join(f"{key} {value}" for key, value in versions().items())
    return f"{name}, {os.cpu_count()} cores, {platform.system()}; {made}"


@dataclass(frozen=True)
class Timing:
    """CPU seconds: median and quartiles over the rounds."""

    median: float
    low: float
    high: float

    @classmethod
    def of(cls, seconds: Sequence[float]) -> Timing:
        low, median, high = np.percentile(np.asarray(seconds, np.float64), [25, 50, 75])
        return cls(float(median), float(low), float(high))

    def __str__(self) -> str:
        """In milliseconds."""
        return f"{1e3 * self.median:.3g} ({1e3 * self.low:.3g} to {1e3 * self.high:.3g})"


def measure(functions: Mapping[str, Callable[[], Any]], rounds: int = 9) -> dict[str, Timing]:
    """Time every function once per round, in turn, after one warm-up round; CPU time of this process."""
    repeats = {}
    for name, function in functions.items():
        function()
        seconds = _seconds(function, 1)
        repeats[name] = max(1, int(SAMPLE_S / max(seconds, 1e-7)))
    samples: dict[str, list[float]] = {name: [] for name in functions}
    for _ in range(rounds):
        for name, function in functions.items():
            samples[name].append(_seconds(function, repeats[name]))
    return {name: Timing.of(values) for name, values in samples.items()}


def _seconds(function: Callable[[], Any], repeats: int) -> float:
    start = time.process_time()
    for _ in range(repeats):
        function()
    return (time.process_time() - start) / repeats


def table(columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """Return a Markdown table; floats with three digits."""
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join("| " + " | ".join(_cell(value) for value in line) + " |" for line in lines)


def _cell(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


@dataclass(frozen=True, eq=False)
class Pair:
    """Two images, the (2, 3) truth reference -> secondary, the place they show, and the value of nodata samples."""

    name: str
    place: str
    reference: NDArray[Any]
    secondary: NDArray[Any]
    truth: NDArray[np.float64]
    nodata: float | None


def read(path: Path) -> NDArray[Any]:
    """The first band of an image file as it is stored, 8-bit or float."""
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise FileNotFoundError(path)
    return np.ascontiguousarray(image[..., 0] if image.ndim == 3 else image)


def random_affine(rng: np.random.Generator, shape: tuple[int, int], turn: float, zoom: float, shift: float) -> Any:
    """(2, 3) matrix about the image centre: a turn within +-`turn` degrees, a zoom within 1 +- `zoom`, 1 % of shear."""
    dx, dy = rng.uniform(-shift, shift, 2)
    matrix = similarity_matrix(shape, rng.uniform(-turn, turn), 1 + rng.uniform(-zoom, zoom), (dx, dy))
    shear = np.array([[1, rng.uniform(-0.01, 0.01)], [0, 1 + rng.uniform(-0.01, 0.01)]])
    centre = (np.array(shape[::-1]) - 1) / 2
    at_centre = matrix[:, :2] @ centre + matrix[:, 2]
    linear = matrix[:, :2] @ shear
    return np.column_stack([linear, at_centre - linear @ centre])


def warped(image: NDArray[Any], truth: NDArray[np.float64]) -> NDArray[Any]:
    """The image after reference -> secondary = truth; 0 where it has no data."""
    height, width = image.shape
    return np.asarray(cv2.warpAffine(image, truth, (width, height), flags=cv2.INTER_LINEAR, borderValue=0))


def real_scenes() -> list[tuple[str, str, NDArray[Any], NDArray[Any]]]:
    """(name, place, first date, second date) of the co-registered real images; empty where there are none.

    Yellow River shows one place twice, so the two count as one.
    """
    found: list[tuple[str, str, NDArray[Any], NDArray[Any]]] = []
    dates = sorted((DATA / "sentinel1_stack").glob("*.tif"))
    for i, first in enumerate(dates):
        found += [
            (f"Sentinel-1 {i + 1}-{k + 1}", "stack", read(first), read(dates[k])) for k in range(i + 1, len(dates))
        ]
    for first in sorted((DATA / "bitemporal").glob("*_1.*")):
        second = first.with_name(first.name.replace("_1.", "_2."))
        if second.exists() and "sulzberger" not in first.name:
            name = first.name.split("_1.")[0]
            found.append((name, name.split("_")[0], read(first), read(second)))
    for first in sorted((DATA / "floods").glob("*_before.png")):
        second = first.with_name(first.name.replace("before", "after"))
        found.append((first.name.removesuffix("_before.png"), "floods", read(first), read(second)))
    return found


def real_pairs(
    rng: np.random.Generator, turn: float, zoom: float, shift: float, *, small: bool = False
) -> Iterator[Pair]:
    """The real images, the second date of each warped by a fresh known affine; those under 400 px only if `small`."""
    for name, place, first, second in real_scenes():
        height, width = np.minimum(first.shape, second.shape)
        if min(height, width) < (200 if small else 280):
            continue
        truth = random_affine(rng, (int(height), int(width)), turn, zoom, shift)
        nodata = None if first.dtype == np.uint8 else 0.0
        yield Pair(name, place, first[:height, :width], warped(second[:height, :width], truth), truth, nodata)


def simulated_pairs(rng: np.random.Generator, count: int, turn: float, zoom: float, shift: float) -> Iterator[Pair]:
    """Simulated 600 x 600 pairs of one to four looks, every one of another landscape."""
    for i in range(count):
        looks = (1, 2, 4)[i % 3]
        dx, dy = rng.uniform(-shift, shift, 2)
        pair = sar_pair(
            looks=looks,
            rotation_deg=float(rng.uniform(-turn, turn)),
            scale=float(1 + rng.uniform(-zoom, zoom)),
            shift=(float(dx), float(dy)),
            seed=int(rng.integers(2**31)),
        )
        name = f"simulated {i + 1}, {looks} looks"
        yield Pair(name, name, pair.reference, pair.secondary, pair.truth, None)
