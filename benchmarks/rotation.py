"""Figures 5, 6 and 7 of the OBCLS paper: the rotation found in couples of neighbouring 4-degree apertures.

    python benchmarks/rotation.py [--couples 90] [--rotation 4] [--contrast 10] [--seed 0] [--methods a,b] [--out DIR]

The secondary is the image of the next aperture, turned counter-clockwise about its centre by nearest neighbour as in
the paper (L. Pallotta, G. Giunta, C. Clemente, J. J. Soraghan, SAR Coregistration by Robust Selection of Extended
Targets and Iterative Outlier Cancellation). The circle is simulated (`featreg.simulate.circle`); couples of the real
Gotcha data are reported beside it where FEATREG_DATA/gotcha holds them: 4-degree apertures where there is enough of
the circle, else 1-degree ones. Every model counts, trusted or not, and the share of trusted ones is printed.
Methods that are not registered are left out, and said to be.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from measuring import DATA, machine, on_one_thread, table

import featreg
from featreg.focusing.backprojection import back_project
from featreg.focusing.ground_grid import GroundGrid
from featreg.focusing.phase_history import PhaseHistory
from featreg.focusing.phase_history_files import read_phase_history
from featreg.geometry import Rigid, as_model
from featreg.products.resample import resample
from featreg.simulate import similarity_matrix
from featreg.simulate.circle import circular_phase_history, parking_lot
from featreg.types import Image

APERTURE = 4.0
VARIANTS = ("c-obcls", "cc-obcls", "rc-obcls")
COLUMNS = (
    "method", "couples", "no model", "ok", "ok and > 0.25", "mean error", "median", "max", "<= 0.25 deg", "<= 0.15 deg",
    "shift median, px", "ms",
)  # fmt: skip


@dataclass(frozen=True)
class Run:
    """One curve of a figure."""

    label: str
    method: str
    keywords: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Couple:
    """Reference, secondary turned by the known angle, and the azimuth where the reference begins."""

    name: str
    azimuth: float
    reference: Image
    secondary: Image


@dataclass(frozen=True)
class Found:
    """Estimated rotation in degrees and shift error in px (NaN without a model), whether trusted, CPU seconds."""

    rotation: float
    shift: float
    ok: bool
    seconds: float


def figures() -> dict[str, list[Run]]:
    """Title -> curves. The paper's variants and baseline first, then what the package does by default."""
    plain = {"cancellation": False}
    paper = [f"{name}-paper" for name in VARIANTS]
    return {
        "Figure 5: variants of OBCLS": [Run(m, m, {}) for m in paper],
        "Figure 6: without outlier cancellation": [Run(f"{m}, no cancellation", m, plain) for m in paper],
        "Figure 7: CLS on a uniform grid": [
            Run("cls-paper, no cancellation", "cls-paper", plain),
            Run("cls-paper, cancellation", "cls-paper", {"cancellation": True}),
        ],
        "Beyond the paper: default settings": [Run(m, m, {}) for m in (*VARIANTS, "cls")],
    }


def turned(image: Image, degrees: float) -> Image:
    """The image after a counter-clockwise turn about its centre, nearest neighbour."""
    back = as_model(similarity_matrix(image.shape, -degrees, 1.0, (0.0, 0.0)))
    made = resample(image, back, image.shape, resampling="nearest")
    # The corners that the turn lays open are zeros in the paper's images, not missing data.
    return Image(made.pixels, np.ones(image.shape, np.bool_), None, image.name, "complex64", "complex")


def couples_of(name: str, images: Iterator[tuple[float, Image]], degrees: float) -> Iterator[Couple]:
    """Each image with the one after it; only two are in memory."""
    previous: tuple[float, Image] | None = None
    for azimuth, image in images:
        if previous is not None:
            yield Couple(name, previous[0], previous[1], turned(image, degrees))
        previous = azimuth, image


def simulated_images(couples: int, contrast_db: float, seed: int) -> Iterator[tuple[float, Image]]:
    """Apertures around the circle; after the last of the 90 comes the first again."""
    lot = parking_lot(contrast_db=contrast_db, seed=seed)
    for i in range(couples + 1):
        azimuth = APERTURE * i
        yield azimuth, back_project(circular_phase_history(lot, azimuth, azimuth + APERTURE))


def real_images() -> Iterator[tuple[float, Image]]:
    """Neighbouring apertures of the real data: 4 degrees each where at least two fit, else 1 degree."""
    history = read_phase_history(DATA / "gotcha", polarisation="HH")
    half = float(np.abs(history.relative_azimuth_deg).max())
    width = APERTURE if 2 * half > 2 * APERTURE - 0.1 else 1.0
    start = float(history.azimuth_deg[history.relative_azimuth_deg.argmin()])
    for i in range(max(1, round(2 * half / width))):
        part: PhaseHistory = history.select(start + i * width, start + (i + 1) * width)
        yield start + i * width, back_project(part, GroundGrid())


def measure(couple: Couple, run: Run, degrees: float, seed: int) -> Found:
    start = time.process_time()
    # A fresh image: maps that another method derived must not be found ready.
    pair = (
        Image(i.pixels, i.mask, None, i.name, i.source_dtype, i.scale) for i in (couple.reference, couple.secondary)
    )
    result = featreg.match(*pair, method=run.method, model="rigid", seed=seed, **run.keywords)
    seconds = time.process_time() - start
    if not isinstance(result.model, Rigid):
        return Found(math.nan, math.nan, False, seconds)
    height, width = couple.reference.shape
    centre = np.array([[(width - 1) / 2, (height - 1) / 2]])
    shift = float(np.hypot(*(result.model(centre) - centre)[0]))
    off = (result.model.rotation_deg - degrees + 180) % 360 - 180
    return Found(degrees + off, shift, result.status == "ok", seconds)


def row(label: str, found: Sequence[Found], degrees: float) -> list[Any]:
    errors = np.abs([f.rotation - degrees for f in found])
    made = np.isfinite(errors)
    none = not made.any()
    wrong = sum(f.ok and abs(f.rotation - degrees) > 0.25 for f in found)
    mean, median, largest = (math.nan if none else float(q(errors[made])) for q in (np.mean, np.median, np.max))
    shift = math.nan if none else float(np.nanmedian([f.shift for f in found]))
    # A couple without a model counts as wrong.
    near = [float(np.mean(np.where(made, errors, np.inf) <= limit)) for limit in (0.25, 0.15)]
    milliseconds = 1e3 * float(np.median([f.seconds for f in found]))
    trusted = float(np.mean([f.ok for f in found]))
    return [label, len(found), int((~made).sum()), trusted, wrong, mean, median, largest, *near, shift, milliseconds]


def plot(title: str, azimuth: Sequence[float], curves: Mapping[str, Sequence[Found]], degrees: float, to: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    low, high = degrees - 5, degrees + 3
    figure, axes = plt.subplots(figsize=(9, 4.5), layout="constrained")
    axes.axhline(degrees, color="0.7", linewidth=4, label="truth")
    for (label, found), marker in zip(curves.items(), "osd^", strict=False):
        shown = np.array([f.rotation for f in found])
        outside = int((~((shown >= low) & (shown <= high))).sum())
        text = f"{label} ({outside} outside or missing)" if outside else label
        axes.plot(azimuth, shown, marker, markersize=4, label=text, linestyle="-", linewidth=0.6)
    axes.set(title=title, xlabel="azimuth of the reference, degrees", ylabel="estimated rotation, degrees")
    axes.set_ylim(low, high)
    axes.legend(loc="upper left", fontsize="small")
    figure.savefig(to, dpi=120)
    plt.close(figure)


def score(couples: Iterator[Couple], titles: Mapping[str, list[Run]], args: argparse.Namespace) -> None:
    """Measure every run on every couple, then print the tables and write the figures."""
    found: dict[str, list[Found]] = {run.label: [] for runs in titles.values() for run in runs}
    azimuth: list[float] = []
    name = ""
    for couple in couples:
        name = couple.name
        azimuth.append(couple.azimuth)
        for runs in titles.values():
            for run in runs:
                found[run.label].append(measure(couple, run, args.rotation, args.seed))
    if not azimuth:
        return
    for title, runs in titles.items():
        if not runs:
            continue
        print(f"\n### {title}; {name}\n")
        print(table(COLUMNS, [row(run.label, found[run.label], args.rotation) for run in runs]))
        if args.out is not None:
            stem = title.split(":")[0].lower().replace(" ", "-")
            path = args.out / f"rotation-{stem}-{name.split(',')[0].replace(' ', '-').lower()}.png"
            curves = {run.label: found[run.label] for run in runs}
            plot(f"{title}; {name}", azimuth, curves, args.rotation, path)
            print(f"\n![{title}]({path})")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--couples", type=int, default=90, help="simulated couples, at most 90")
    parser.add_argument("--rotation", type=float, default=4.0, help="degrees, counter-clockwise")
    parser.add_argument("--contrast", type=float, default=10.0, help="vehicles over ground, dB")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--methods", help="only these presets, or any other ones, with a comma between")
    parser.add_argument("--out", type=Path, help="folder for the figures; without it, tables only")
    args = parser.parse_args()
    on_one_thread()
    if args.out is not None:
        args.out.mkdir(parents=True, exist_ok=True)
    known = set(featreg.available("method"))
    wanted = set(args.methods.split(",")) if args.methods else None
    titles = {
        title: [run for run in runs if run.method in known and (wanted is None or run.method in wanted)]
        for title, runs in figures().items()
    }
    listed = {run.method for runs in figures().values() for run in runs}
    titles["Other methods"] = [Run(m, m, {}) for m in sorted((wanted or set()) & known - listed)]
    absent = sorted((listed if wanted is None else wanted) - known)
    print(f"## Rotation by {args.rotation:g} degrees\n\n{machine()}; seed {args.seed}")
    if absent:
        print(f"\nNot registered, left out: {', '.join(absent)}")
    if any(titles.values()):
        count = min(args.couples, 90)
        images = simulated_images(count, args.contrast, args.seed)
        name = f"simulated circle, {count} couples, contrast {args.contrast:g} dB"
        score(couples_of(name, images, args.rotation), titles, args)
        if (DATA / "gotcha").is_dir():
            score(couples_of("Gotcha, real", real_images(), args.rotation), titles, args)
        else:
            print("\nNo real Gotcha data: only the simulated circle.")


if __name__ == "__main__":
    main()
