"""The pieces of a method beside what they cost elsewhere: copying the image, or OpenCV's function for the same job.

python benchmarks/pieces.py [--rounds 9] [--seed 0] [--large 4000]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import cycle
from typing import Any

import cv2
import numpy as np
from measuring import Timing, machine, measure, on_one_thread, random_affine, round_count, table
from numpy.typing import NDArray

import featreg
from featreg.geometry import Affine
from featreg.sar.correlation import local_correlations
from featreg.sar.gradients.ratio import quantised_edges, roewa
from featreg.sar.keypoints.corners import fast_corners
from featreg.simulate import sar_pair

COLUMNS = ("piece", "ms, median (quartiles)", "against", "ms, median (quartiles)", "ratio", "at most", "met", "result")
POINTS = 5000
# Bytes of images through which the copies go round.
COPIED = 24 << 20


@dataclass(frozen=True)
class Row:
    """One piece, its yardstick, the ratio of their times and the most that it may be."""

    piece: str
    timing: Timing
    against: str
    yardstick: Timing
    most: float | None = None
    result: str = ""

    def cells(self) -> list[Any]:
        ratio = self.timing.median / self.yardstick.median
        met = "" if self.most is None else "yes" if ratio <= self.most else "NO"
        most = "" if self.most is None else self.most
        return [self.piece, self.timing, self.against, self.yardstick, ratio, most, met, self.result]


def ratio_gradients(side: int, rng: np.random.Generator, rounds: int) -> Iterator[Row]:
    """ROEWA in multiples of copying the image, at two scales: the cost must not grow with alpha.

    The copies go round several buffers: one small image copied onto the same place again and again never leaves the
    innermost cache, which no image in use does. That quickest of all copies is the last row.
    """
    image = rng.gamma(4, 0.25, (side, side)).astype(np.float32)
    places = cycle([(image.copy(), np.empty_like(image)) for _ in range(max(1, COPIED // image.nbytes))])
    copy = np.empty_like(image)

    def copied() -> None:
        source, target = next(places)
        np.copyto(target, source)

    functions: dict[str, Callable[[], Any]] = {"copy": copied, "same copy": lambda: np.copyto(copy, image)}
    for alpha in (2.0, 8.0):
        functions[f"alpha {alpha:g}"] = partial(roewa, image, alpha)
    found = measure(functions, rounds)
    for alpha in (2.0, 8.0):
        name = f"alpha {alpha:g}"
        yield Row(f"ratio gradients {side} x {side}, {name}", found[name], "copy of the image", found["copy"], 12.0)
    yield Row(f"ratio gradients {side} x {side}, alpha 8", found["alpha 8"], "the same, alpha 2", found["alpha 2"], 1.3)
    yield Row(
        f"ratio gradients {side} x {side}, alpha 8", found["alpha 8"], "copy within the cache", found["same copy"]
    )


def fast(rng: np.random.Generator, rounds: int) -> Iterator[Row]:
    pair = sar_pair(seed=int(rng.integers(2**31)))
    edges = quantised_edges(featreg.as_image(pair.reference), alpha=2.0)
    allowed = np.ones(edges.shape, np.bool_)
    theirs = cv2.FastFeatureDetector.create(threshold=20)
    found = measure(
        {"ours": lambda: fast_corners(edges, 20, allowed, edges.size), "cv2": lambda: theirs.detect(edges)}, rounds
    )
    counts = f"{len(fast_corners(edges, 20, allowed, edges.size)[0])} and {len(theirs.detect(edges))} corners"
    yield Row("FAST 600 x 600, threshold 20", found["ours"], "cv2.FastFeatureDetector", found["cv2"], None, counts)


def features(descriptors: NDArray[Any], norm: str) -> featreg.Features:
    n = len(descriptors)
    none = np.zeros(n)
    return featreg.Features(np.zeros((n, 2)), none, none, none, none.astype(np.int64), descriptors, norm)


def nearest(rng: np.random.Generator, rounds: int) -> Iterator[Row]:
    bits = [rng.integers(0, 256, (POINTS, 32), dtype=np.uint8) for _ in range(2)]
    reals = [rng.random((POINTS, 128), dtype=np.float32) for _ in range(2)]
    one_way = featreg.create("nearest", "brute-force", mutual=False)
    both_ways = featreg.create("nearest", "brute-force", mutual=True)
    ratio = featreg.create("nearest", "brute-force", mutual=False, ratio=0.8)
    a, b = (features(d, "hamming") for d in bits)
    x, y = (features(d, "l2") for d in reals)
    hamming, crossed = cv2.BFMatcher(cv2.NORM_HAMMING), cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True)
    euclid = cv2.BFMatcher(cv2.NORM_L2)
    found = measure(
        {
            "one": lambda: one_way.match_features(a, b),
            "cv2 one": lambda: hamming.match(*bits),
            "both": lambda: both_ways.match_features(a, b),
            "cv2 both": lambda: crossed.match(*bits),
            "l2": lambda: ratio.match_features(x, y),
            "cv2 l2": lambda: euclid.knnMatch(reals[0], reals[1], 2),
        },
        rounds,
    )
    size = f"{POINTS} x {POINTS}"
    same = sum(m.trainIdx == j for m, (_, j) in zip(hamming.match(*bits), one_way.match_features(a, b)[0], strict=True))
    yield Row(f"Hamming {size}", found["one"], "cv2.BFMatcher", found["cv2 one"], 1 / 8, f"{same} of {POINTS} equal")
    yield Row(f"Hamming {size}, mutual", found["both"], "cv2.BFMatcher, crossCheck", found["cv2 both"], 1 / 8)
    yield Row(f"L2 {size} x 128, ratio", found["l2"], "cv2.BFMatcher.knnMatch", found["cv2 l2"])


def tie_points(rng: np.random.Generator, share: float) -> tuple[featreg.Matches, NDArray[np.float64]]:
    """Tie points of a 600 x 600 pair with a share of good ones (0.5 px of noise) and their truth.

    All lie well inside both images: OpenCV's GMS writes out of bounds for points outside.
    """
    truth = random_affine(rng, (600, 600), 8, 0.03, 15)
    reference = rng.uniform(80, 519, (POINTS, 2))
    secondary = reference @ truth[:, :2].T + truth[:, 2] + rng.normal(0, 0.5, (POINTS, 2))
    good = rng.random(POINTS) < share
    secondary[~good] = rng.uniform(1, 598, (int((~good).sum()), 2))
    return featreg.Matches(reference, secondary, good + rng.normal(0, 1, POINTS)), truth


def motion_statistics(rng: np.random.Generator, rounds: int) -> Iterator[Row]:
    matches, _ = tie_points(rng, 0.3)
    keypoints = [
        [cv2.KeyPoint(float(x), float(y), 1.0) for x, y in xy] for xy in (matches.reference_xy, matches.secondary_xy)
    ]
    pairs = [cv2.DMatch(i, i, 0) for i in range(POINTS)]
    context = featreg.FilterContext((600, 600), (600, 600), Affine)
    for rotation in (False, True):
        keeper = featreg.create("filter", "gms", rotation=rotation)

        def ours(keeper: featreg.Filter = keeper) -> Any:
            return keeper.keep(matches, context)

        def theirs(rotation: bool = rotation) -> Any:
            return cv2.xfeatures2d.matchGMS(
                (600, 600), (600, 600), keypoints[0], keypoints[1], pairs, rotation, False, 6.0
            )

        found = measure({"ours": ours, "cv2": theirs}, rounds)
        kept = f"{int(ours().sum())} and {len(theirs())} kept"
        name = f"GMS {POINTS} matches{', rotation' * rotation}"
        yield Row(name, found["ours"], "cv2.xfeatures2d.matchGMS", found["cv2"], None, kept)


def consensus(rng: np.random.Generator, rounds: int) -> Iterator[Row]:
    matches, truth = tie_points(rng, 0.4)
    fsc = featreg.create("filter", "fsc", threshold=3.0)
    grid = np.stack(np.meshgrid(np.linspace(30, 570, 9), np.linspace(30, 570, 9)), -1).reshape(-1, 2)
    wanted = grid @ truth[:, :2].T + truth[:, 2]

    def ours() -> Any:
        context = featreg.FilterContext((600, 600), (600, 600), Affine, np.random.default_rng(0))
        return fsc.keep(matches, context)

    def theirs() -> Any:
        return cv2.estimateAffine2D(
            matches.reference_xy, matches.secondary_xy, method=cv2.USAC_MAGSAC, ransacReprojThreshold=3.0
        )[0]

    found = measure({"ours": ours, "cv2": theirs}, rounds)
    kept = ours()
    fit = Affine.from_estimate(matches.reference_xy[kept], matches.secondary_xy[kept])
    errors = []
    for mapped in (fit(grid) if fit else np.full_like(grid, np.nan), grid @ theirs()[:, :2].T + theirs()[:, 2]):
        errors.append(float(np.sqrt(np.mean(np.sum((mapped - wanted) ** 2, axis=1)))))
    result = f"grid RMSE {errors[0]:.3f} and {errors[1]:.3f} px"
    yield Row(f"FSC {POINTS}, 60 % outliers", found["ours"], "cv2 USAC_MAGSAC", found["cv2"], None, result)


def correlation(rng: np.random.Generator, rounds: int) -> Iterator[Row]:
    half, search = 24, 2
    white = rng.standard_normal((600, 600), dtype=np.float32)
    image: NDArray[np.float32] = np.asarray(cv2.GaussianBlur(white, (0, 0), 1.5), np.float32)
    moved = np.roll(image, (1, -1), (0, 1)) + np.float32(0.05) * rng.standard_normal(image.shape, dtype=np.float32)
    reach = half + search + 1
    at = rng.integers(reach, 600 - reach, (POINTS, 2))

    def ours() -> Any:
        return local_correlations(image, moved, at, half, search)

    def theirs() -> Any:
        out = np.empty((POINTS, 2 * search + 1, 2 * search + 1), np.float32)
        for i, (x, y) in enumerate(at.tolist()):
            window = image[y - half : y + half + 1, x - half : x + half + 1]
            wide = half + search
            out[i] = cv2.matchTemplate(
                moved[y - wide : y + wide + 1, x - wide : x + wide + 1], window, cv2.TM_CCOEFF_NORMED
            )
        return out

    found = measure({"ours": ours, "cv2": theirs}, max(3, rounds // 3))
    difference = f"largest difference {np.abs(ours() - theirs()).max():.1e}"
    name = f"local correlation {POINTS} points, 49 x 49, 25 shifts"
    yield Row(name, found["ours"], "cv2.matchTemplate per point", found["cv2"], None, difference)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=round_count, default=9)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--large", type=int, default=4000, help="side of the large image")
    given = parser.parse_args()
    rng = np.random.default_rng(given.seed)
    rows = [
        *ratio_gradients(600, rng, given.rounds),
        *ratio_gradients(given.large, rng, max(3, given.rounds // 3)),
        *fast(rng, given.rounds),
        *nearest(rng, given.rounds),
        *motion_statistics(rng, given.rounds),
        *consensus(rng, given.rounds),
        *correlation(rng, given.rounds),
    ]
    print(f"## Pieces\n\n{machine()}; one thread, CPU time, {given.rounds} rounds, seed {given.seed}\n")
    print(table(COLUMNS, [row.cells() for row in rows]) + "\n")


if __name__ == "__main__":
    on_one_thread()
    main()
