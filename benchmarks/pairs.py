"""Methods on pairs with a known warp: how many correct matches, how good a model, in what time.

    python benchmarks/pairs.py [--features 5000] [--simulated 3] [--draws 1] [--rounds 3] [--seed 0] [--all]
                               [--methods a,b+refine]

Real pairs come from the folder that FEATREG_DATA names; simulated ones are always run. "+refine" scores the final tie
points of a refined result; without it, the matches that the method's local filter kept, as in the published tables.
The yardstick of time is OpenCV's own ORB, brute-force matcher, GMS and USAC_MAGSAC, called without this package.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from typing import Any

import cv2
import numpy as np
from measuring import Pair, Timing, machine, on_one_thread, real_pairs, round_count, simulated_pairs, table
from numpy.typing import NDArray

import featreg
from featreg.geometry import as_model
from featreg.sar.normalise import to_uint8
from featreg.study.measures import grid_rmse, match_errors, score_errors

METHODS = "sar-orb,sar-orb+refine,sar-orb-paper,orb,sift,akaze"
YARDSTICK = "cv2 ORB"
COLUMNS = ("method", "ok", "NM", "NCM", "precision", "RMSE, px", "grid RMSE, px", "ms", "time / cv2 ORB")
Scores = dict[str, float]


def by_featreg(method: str, pair: Pair, features: int, seed: int) -> Callable[[], featreg.Registration]:
    name, _, refine = method.partition("+")
    return lambda: featreg.match(
        pair.reference,
        pair.secondary,
        method=name,
        refine=bool(refine),
        n_features=features,
        seed=seed,
        nodata=pair.nodata,
    )


def scores_of(result: featreg.Registration, method: str, pair: Pair) -> Scores:
    found = featreg.evaluate(result, pair.truth, stage="inliers" if "+" in method else None)
    scores = {"ok": float(result.status == "ok"), "nm": found.nm, "ncm": found.ncm, "precision": found.precision}
    return {**scores, "rmse": found.rmse, "grid": found.grid_rmse}


def by_opencv(pair: Pair, features: int) -> Callable[[], tuple[NDArray[Any], NDArray[Any], NDArray[Any] | None]]:
    images = [featreg.as_image(image, nodata=pair.nodata) for image in (pair.reference, pair.secondary)]
    eight_bit = [to_uint8(image) for image in images]
    sizes = [(image.shape[1], image.shape[0]) for image in eight_bit]

    def run() -> tuple[NDArray[Any], NDArray[Any], NDArray[Any] | None]:
        orb = cv2.ORB.create(features, fastThreshold=5)
        found = [orb.detectAndCompute(image, None) for image in eight_bit]
        matches = cv2.BFMatcher(cv2.NORM_HAMMING).match(found[0][1], found[1][1])
        kept = cv2.xfeatures2d.matchGMS(sizes[0], sizes[1], found[0][0], found[1][0], matches, True, False, 6.0)
        reference = np.array([found[0][0][m.queryIdx].pt for m in kept]).reshape(-1, 2)
        secondary = np.array([found[1][0][m.trainIdx].pt for m in kept]).reshape(-1, 2)
        matrix = None
        if len(kept) >= 4:
            matrix = cv2.estimateAffine2D(reference, secondary, method=cv2.USAC_MAGSAC, ransacReprojThreshold=3)[0]
        return reference, secondary, matrix

    return run


def scores_of_opencv(made: tuple[NDArray[Any], NDArray[Any], NDArray[Any] | None], pair: Pair) -> Scores:
    reference, secondary, matrix = made
    nm, ncm, precision, rmse = score_errors(match_errors(reference, secondary, pair.truth))
    shape = (pair.reference.shape[0], pair.reference.shape[1])
    try:
        grid = np.nan if matrix is None else grid_rmse(as_model(matrix), pair.truth, shape)
    except featreg.errors.InputError:  # OpenCV may return a matrix that cannot be inverted
        grid = np.nan
    return {"ok": float(matrix is not None), "nm": nm, "ncm": ncm, "precision": precision, "rmse": rmse, "grid": grid}


def run_pair(pair: Pair, methods: Sequence[str], features: int, rounds: int, seed: int) -> dict[str, Scores]:
    """Score every method once and time all of them in turn, after a round that is not counted."""
    calls: dict[str, Callable[[], Any]] = {YARDSTICK: by_opencv(pair, features)}
    calls |= {method: by_featreg(method, pair, features, seed) for method in methods}
    found: dict[str, Scores] = {}
    seconds: dict[str, list[float]] = {name: [] for name in calls}
    for name, call in calls.items():
        found[name] = scores_of_opencv(call(), pair) if name == YARDSTICK else scores_of(call(), name, pair)
    for _ in range(rounds):
        for name, call in calls.items():
            start = time.process_time()
            call()
            seconds[name].append(time.process_time() - start)
    yardstick = Timing.of(seconds[YARDSTICK]).median
    for name, scores in found.items():
        scores["ms"] = 1e3 * Timing.of(seconds[name]).median
        scores["ratio"] = scores["ms"] / 1e3 / yardstick
    return found


def summary(rows: Sequence[Scores]) -> list[str]:
    """Medians and quartiles over the pairs; a model that is missing counts as infinitely wrong."""
    cells = [f"{int(sum(row['ok'] for row in rows))} of {len(rows)}"]
    for name in ("nm", "ncm", "precision", "rmse", "grid", "ms", "ratio"):
        values = np.array([row[name] for row in rows], np.float64)
        if name == "grid":
            values[np.isnan(values)] = np.inf
        values = np.sort(values[~np.isnan(values)])
        if not len(values):
            cells.append("-")
            continue
        # Not np.percentile: between two pairs, one of them infinite, it gives NaN.
        low, middle, high = (values[round(q * (len(values) - 1))] for q in (0.25, 0.5, 0.75))
        cells.append(f"{middle:.3g} ({low:.3g} to {high:.3g})")
    return cells


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--features", type=int, default=5000)
    parser.add_argument("--simulated", type=int, default=3, help="how many simulated pairs")
    parser.add_argument("--draws", type=int, default=1, help="warps of each real pair")
    parser.add_argument("--rounds", type=round_count, default=3)
    parser.add_argument("--seed", type=int, default=0, help="of the warps and of the methods")
    parser.add_argument("--methods", default=METHODS)
    parser.add_argument("--all", action="store_true", help="the many small real pairs too")
    given = parser.parse_args()
    methods = [name for name in given.methods.split(",") if name]
    rng = np.random.default_rng(given.seed)
    groups: dict[str, list[Pair]] = {}
    for pair in (one for _ in range(given.draws) for one in real_pairs(rng, 8, 0.03, 15, small=given.all)):
        groups.setdefault({"stack": "Sentinel-1 stack", "floods": "floods"}.get(pair.place, "bitemporal"), []).append(
            pair
        )
    groups["simulated"] = list(simulated_pairs(rng, given.simulated, 8, 0.03, 15))
    print(
        f"## Pairs\n\n{machine()}; one thread, CPU time; {given.features} features, seed {given.seed}; warps of at most"
    )
    print("8 degrees, 3 % and 15 px; median (quartiles) over the pairs, times the median of rounds\n")
    if len(groups) == 1:
        print("No real images: FEATREG_DATA names no folder with any.\n")
    for title, pairs in groups.items():
        found: dict[str, list[Scores]] = {}
        for pair in pairs:
            for name, scores in run_pair(pair, methods, given.features, given.rounds, given.seed).items():
                found.setdefault(name, []).append(scores)
        print(f"### {title}, {len(pairs)} pairs\n")
        print(table(COLUMNS, [[name, *summary(rows)] for name, rows in found.items()]) + "\n", flush=True)


if __name__ == "__main__":
    on_one_thread()
    main()
