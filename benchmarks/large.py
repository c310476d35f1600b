"""Large pairs looked at whole, on one thread and on two, beside OpenCV's ORB on the same pixels.

    python benchmarks/large.py [--sides 600,4000] [--methods sar-orb,sar-sift] [--features 2000] [--threads 2]
                               [--rounds 3] [--seed 0]

CPU time of the process over that of ORB's pair in the same round, on one thread, and how many times sooner two threads
have the result, by wall time: that column says something on an idle machine only, for which the load is printed.
"""

from __future__ import annotations

import argparse
import os
import time
from typing import Any

import cv2
import numpy as np
from measuring import machine, on_one_thread, round_count, table
from numpy.typing import NDArray

import featreg
from featreg.simulate import SimulatedPair, sar_pair

COLUMNS = (
    "side", "method", "CPU over ORB's (quartiles)", "ns a pixel", "times sooner", "status", "grid RMSE px",
)  # fmt: skip


def eight_bits(image: NDArray[Any]) -> NDArray[np.uint8]:
    top = float(np.percentile(image[::7, ::7], 99.5))
    return np.asarray(np.clip(image * (255 / top), 0, 255), np.uint8)


def orb(pair: tuple[NDArray[np.uint8], NDArray[np.uint8]], count: int) -> None:
    detector = cv2.ORB.create(count)
    (here, first), (there, second) = (detector.detectAndCompute(image, None) for image in pair)
    found = cv2.BFMatcher(cv2.NORM_HAMMING, True).match(first, second)
    points = np.array([(here[m.queryIdx].pt, there[m.trainIdx].pt) for m in found])
    cv2.estimateAffine2D(points[:, 0], points[:, 1], method=cv2.USAC_MAGSAC, ransacReprojThreshold=3)


def matched(pair: SimulatedPair, method: str, given: argparse.Namespace, threads: int) -> featreg.Registration:
    return featreg.match(
        pair.reference, pair.secondary, method=method, model="affine", n_features=given.features, seed=given.seed,
        block=False, threads=threads,
    )  # fmt: skip


def rows_of(side: int, given: argparse.Namespace) -> list[list[Any]]:
    pair = sar_pair((side, side), rotation_deg=6.0, scale=1.02, shift=(5.0, 3.0), seed=given.seed)
    small = eight_bits(pair.reference), eight_bits(pair.secondary)
    methods = given.methods.split(",")
    one: dict[str, list[tuple[float, float]]] = {name: [] for name in ("ORB", *methods)}
    two: dict[str, list[float]] = {name: [] for name in methods}
    results: dict[str, featreg.Registration] = {}
    for turn in range(given.rounds + 1):
        for name, samples in one.items():
            wall, start = time.perf_counter(), time.process_time()
            if name == "ORB":
                orb(small, given.features)
            else:
                results[name] = matched(pair, name, given, 1)
            spent = time.process_time() - start, time.perf_counter() - wall
            if name != "ORB" and given.threads > 1:
                wall = time.perf_counter()
                matched(pair, name, given, given.threads)
                wall = spent[1] / (time.perf_counter() - wall)
                two[name] += [wall] if turn else []
            samples += [spent] if turn else []
    found = []
    for name in methods:
        ratio = [mine / theirs for (mine, _), (theirs, _) in zip(one[name], one["ORB"], strict=True)]
        low, middle, high = np.percentile(ratio, [25, 50, 75])
        per_pixel = 1e9 * float(np.median([cpu for cpu, _ in one[name]])) / side**2
        sooner = f"{float(np.median(two[name])):.2f}" if two[name] else "-"
        registration = results[name]
        rmse = float(featreg.evaluate(registration, pair.truth).grid_rmse)
        spread = f"{middle:.2f} ({low:.2f} to {high:.2f})"
        found.append([side, name, spread, per_pixel, sooner, registration.status, rmse])
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sides", default="600,4000")
    parser.add_argument("--methods", default="sar-orb,sar-sift")
    parser.add_argument("--features", type=int, default=2000)
    parser.add_argument("--threads", type=int, default=2, help="of the column of wall times; 1 leaves it out")
    parser.add_argument("--rounds", type=round_count, default=3)
    parser.add_argument("--seed", type=int, default=0, help="of the images and of the methods")
    given = parser.parse_args()
    on_one_thread(pinned=given.threads == 1)
    rows = [row for side in given.sides.split(",") for row in rows_of(int(side), given)]
    load = f"load {os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else "load unknown"
    print(
        f"{given.features} features, refined, {given.threads} threads at most, seed {given.seed}; {machine()}; {load}\n"
    )
    print(table(COLUMNS, rows))


if __name__ == "__main__":
    main()
