"""How often the truth lies inside the ellipses that tie points state, and how far off a model is beside what is said.

    python benchmarks/covariances.py [--pairs 8] [--looks 1,4,16] [--methods sar-dense,sar-orb,sar-sift]
                                     [--scenes simulated,changed,real] [--side 400] [--windows 48] [--seed 0]
                                     [--blocks 200]

Pairs: simulated landscapes of which 5 % (`simulated`) or 40 % (`changed`) differ between the dates, and cuts of the
real scene (`real`), the second resampled by a known similarity; all under fresh speckle of so many looks, correlated as
the point response of a system has it. Turns up to 20 degrees, zooms up to 3 %, shifts up to 8 px, of any fraction.

Tie points: share of the true errors inside the ellipses of 50, 68, 95 and 99 %, of all that the matcher of `sar-dense`
gives and of the final ones of every method, each with the standard error by which the shares of single pairs scatter;
median squared Mahalanobis length over that of two Gaussian errors; root mean square error, and what the covariances say
of it. Model: the same shares over a 5 x 5 grid of the reference by `featreg.geometry.correlated_covariance`, and root
mean squares of its error, true and said.

Blocks: the gate `block_error` of a scene of `sar-dense`, what it says of a block that is displaced by so much, of
100 windows with errors of one standard deviation along each axis, some of which lie anywhere within the search.

`alike` is what windows tell of the weight by which they share their scatter (`precision.ALIKE`): one over the variance
among windows of the logarithm of independent samples, less what chance gives it.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from measuring import DATA, machine, on_one_thread, read, table
from numpy.typing import NDArray

import featreg
from featreg.geometry import Translation, correlated_covariance, inverse_variances
from featreg.interfaces import FailedFit
from featreg.io import as_image
from featreg.registry import create
from featreg.sar.orientation import precision
from featreg.scene.merge import Merged, block_errors
from featreg.simulate import sar_pair, similarity_matrix
from featreg.simulate.speckle_field import speckled_intensity
from featreg.types import Matches

F64 = NDArray[np.float64]
Pair = tuple[NDArray[np.float32], NDArray[np.float32], F64]
SHARES = np.array([0.50, 0.68, 0.95, 0.99])
#: Squared Mahalanobis length of two Gaussian errors that holds each share, and the median one.
LIMITS, MEDIAN = -2 * np.log(1 - SHARES), 2 * math.log(2)
CHANGED = {"simulated": 0.05, "changed": 0.4}
MARGIN = 100
#: Farthest that a window of `sar-dense` looks, px.
SEARCHED = 6.0


def pairs(scene: str, looks: int, count: int, side: int, seed: int) -> Iterator[Pair]:
    """Reference, secondary, truth (2, 3) of so many pairs."""
    for number in range(count):
        rng = np.random.default_rng([seed, number, looks])
        turn, zoom = float(rng.uniform(-20, 20)), float(rng.uniform(0.97, 1.03))
        shift = (float(rng.uniform(-8, 8)), float(rng.uniform(-8, 8)))
        if scene in CHANGED:
            made = sar_pair(
                (side, side), looks=looks, rotation_deg=turn, scale=zoom, shift=shift, change=CHANGED[scene],
                seed=int(rng.integers(2**31)),
            )  # fmt: skip
            yield made.reference, made.secondary, made.truth
        else:
            yield real_pair(rng, looks, side, similarity_matrix((side, side), turn, zoom, shift))


def real_pair(rng: np.random.Generator, looks: int, side: int, truth: F64) -> Pair:
    """A cut of the real scene, smoothed a little and resampled by the truth, under fresh speckle in both."""
    image = read(sorted((DATA / "sentinel1_mosaic").glob("*.png"))[0])
    wide = side + 2 * MARGIN
    top, left = (int(rng.integers(0, n - wide + 1)) for n in image.shape)
    power = cv2.GaussianBlur((image[top : top + wide, left : left + wide].astype(np.float32) + 1) ** 2, (0, 0), 0.7)
    within = np.column_stack([truth[:, :2], truth[:, 2] - truth[:, :2] @ [MARGIN, MARGIN]])
    moved = cv2.warpAffine(power, within, (side, side), flags=cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REFLECT)
    one, other = (
        np.sqrt(speckled_intensity(np.ascontiguousarray(np.maximum(view, 1), np.float32), None, looks, rng))
        for view in (power[MARGIN:-MARGIN, MARGIN:-MARGIN], moved)
    )
    return one, other, truth


@dataclass
class Tally:
    """Errors (N, 2) and covariances (N, 2, 2) of the pairs so far."""

    squared: list[F64] = field(default_factory=list)
    said: list[float] = field(default_factory=list)
    true: list[float] = field(default_factory=list)

    def add(self, error: F64, covariance: F64) -> None:
        if not len(error):
            return
        self.squared.append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error))
        self.said.append(float(np.trace(covariance, axis1=1, axis2=2).sum()))
        self.true.append(float((error**2).sum()))

    def row(self) -> list[Any]:
        """Number, shares with standard errors, median over that of Gaussian errors, rms true and said, px."""
        count = sum(len(part) for part in self.squared)
        if not count:
            return [0] + ["-"] * (len(SHARES) + 3)
        every = np.concatenate(self.squared)
        cells = []
        for limit in LIMITS:
            # The errors of one pair share its windows: pairs, not tie points, are independent.
            sizes = np.array([len(part) for part in self.squared])
            inside = np.array([np.count_nonzero(part <= limit) for part in self.squared])
            share = inside.sum() / sizes.sum()
            spread = (
                math.sqrt(float(((inside - share * sizes) ** 2).sum()))
                / count
                * math.sqrt(len(sizes) / max(1, len(sizes) - 1))
            )
            cells.append(f"{100 * share:.1f} ± {100 * spread:.1f}")
        rms = [math.sqrt(sum(part) / count) for part in (self.true, self.said)]
        return [count, *cells, float(np.median(every)) / MEDIAN, *rms]


def error_of(there: F64, here: F64, truth: F64) -> F64:
    return np.asarray(there - (here @ truth[:, :2].T + truth[:, 2]))


def of_model(tally: Tally, found: featreg.Registration, truth: F64, side: int) -> None:
    x, y = np.meshgrid(*[np.linspace(0, side - 1, 5)] * 2)
    grid, chosen = np.column_stack([x.ravel(), y.ravel()]), found.matches.take(found.inliers)
    if isinstance(found.model, FailedFit):
        return
    known = correlated_covariance(
        found.model, chosen.reference_xy, chosen.secondary_xy, inverse_variances(chosen.covariance), at=grid
    )
    if not isinstance(known, FailedFit):
        tally.add(error_of(found.model(grid), grid, truth), known.covariance)


def of_blocks(count: int, seed: int) -> str:
    """What a displaced block says of itself: median and 5 % quantile, px, and the share that says nothing."""
    rng, rows = np.random.default_rng(seed), []
    windows, zero, none = 100, Translation(0.0, 0.0), Matches.empty()
    here, owners = rng.uniform(0, 600, (count * windows, 2)), np.repeat(np.arange(count), windows)
    for noise in (0.3, 1.0, 2.0):
        for wild in (0.0, 0.2, 0.4, 0.6):
            cells = []
            for off in (0.0, 1.0, 2.0, 3.0, 5.0):
                away = rng.normal([0.6 * off, 0.8 * off], noise, here.shape)
                lost = rng.random(len(here)) < wild
                away[lost] = rng.uniform(-SEARCHED, SEARCHED, (int(lost.sum()), 2))
                points = Matches(here, here + away, np.ones(len(here)))
                merged = Merged(points, {}, owners, none, owners[:0], 0, (600, 600), none, owners[:0])
                said = block_errors(merged, zero, count)
                known = said[np.isfinite(said)]
                low, middle = np.percentile(known, [5, 50]) if len(known) else (math.nan, math.nan)
                cells.append(f"{middle:.2f} ({low:.2f}; {100 - 100 * len(known) / count:.0f} %)")
            rows.append([noise, wild, *cells])
    return table(["noise px", "anywhere", *(f"{off} px off" for off in (0, 1, 2, 3, 5))], rows)


class Watched:
    """Looks at what `precision` computes, to tell how alike the windows of a pair are."""

    def __init__(self) -> None:
        self.alike: list[float] = []
        self.local = precision._local

    def __enter__(self) -> Watched:
        precision._local = self
        return self

    def __exit__(self, *_: object) -> None:
        precision._local = self.local

    def __call__(self, scatter: precision.Scatter, curvature: F64, height: F64) -> tuple[F64, F64]:
        own = np.einsum("nij,nji->n", scatter.variance, np.linalg.inv(curvature)) / 2
        samples = np.log(own * height / np.maximum(1 - height**2, 1e-6))
        beyond = float(np.var(samples) - np.mean(1 / np.maximum(scatter.blocks - 1, 1)))
        self.alike.append(1 / max(beyond, 0.01))
        return self.local(scatter, curvature, height)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=8)
    parser.add_argument("--looks", default="1,4,16")
    parser.add_argument("--methods", default="sar-dense,sar-orb,sar-sift")
    parser.add_argument("--scenes", default="simulated,changed,real")
    parser.add_argument("--side", type=int, default=400)
    parser.add_argument("--windows", default="48", help="sides of the windows of sar-dense")
    parser.add_argument("--blocks", type=int, default=200, help="simulated blocks of a row; 0 for none")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    on_one_thread(pinned=False)
    print(machine())
    shares = [f"{100 * share:.0f} %" for share in SHARES]
    rows, alike = [], []
    for scene in filter(None, args.scenes.split(",")):
        for looks in (int(text) for text in args.looks.split(",")):
            if scene == "real" and not (DATA / "sentinel1_mosaic").is_dir():
                print("no real scene: left out")
                continue
            tallies: dict[str, Tally] = {}
            for one, other, truth in pairs(scene, looks, args.pairs, args.side, args.seed):
                for window in args.windows.split(",") if "sar-dense" in args.methods else ():
                    matcher = create("matcher", "orientation-correlation", window=int(window))
                    with Watched() as watched:
                        found = matcher.match(as_image(one, nodata=0), as_image(other, nodata=0))
                    alike += watched.alike
                    if found.covariance is not None:
                        error = error_of(found.secondary_xy, found.reference_xy, truth)
                        tallies.setdefault(f"windows of {window} px", Tally()).add(error, found.covariance)
                for method in args.methods.split(","):
                    result = featreg.match(one, other, method=method, model="affine", seed=0, nodata=0)
                    chosen = result.matches.take(result.inliers)
                    if chosen.covariance is not None:
                        error = error_of(chosen.secondary_xy, chosen.reference_xy, truth)
                        tallies.setdefault(method, Tally()).add(error, chosen.covariance)
                        of_model(tallies.setdefault(f"{method}: model", Tally()), result, truth, args.side)
            found_rows = [[scene, looks, name, *tally.row()] for name, tally in tallies.items()]
            print(table(["scene", "looks", "of", "number", *shares, "median", "rms px", "said px"], found_rows))
            rows += found_rows
    print(table(["scene", "looks", "of", "number", *shares, "median", "rms px", "said px"], rows))
    if alike:
        print(
            f"alike: {np.percentile(alike, 25):.3g}, {np.median(alike):.3g}, {np.percentile(alike, 75):.3g} (quartiles)"
        )
    if args.blocks:
        print(of_blocks(args.blocks, args.seed))


if __name__ == "__main__":
    main()
