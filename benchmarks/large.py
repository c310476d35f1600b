"""Large pairs looked at whole, on one thread and on two, beside OpenCV's ORB on the same pixels.

    python benchmarks/large.py [--sides 600,4000] [--methods sar-orb,sar-sift] [--features 2000] [--threads 2]
                               [--rounds 3] [--seed 0]

CPU time of the process over that of ORB's pair in the same round, on one thread; how many times sooner two threads
have the result, by wall time; and how many times as much two processes get done that do the same on one thread each,
by what one loses while the other runs: what processors share, memory first of all, lets no program on two of them do
better by much. The last two columns say something on an idle machine only, for which the load is printed.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
from measuring import machine, on_one_thread, round_count, table
from numpy.typing import NDArray

import featreg
from featreg.simulate import SimulatedPair, sar_pair

COLUMNS = (
    "side", "method", "CPU over ORB's (quartiles)", "ns a pixel", "times sooner (quartiles)", "two processes",
    "status", "grid RMSE px",
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


class Neighbour:
    """Another process that does the same on one thread, again and again, while it is asked to."""

    def __init__(self, pair: SimulatedPair, method: str, given: argparse.Namespace, folder: str) -> None:
        context = multiprocessing.get_context("spawn")
        self.busy, self.idle, self.over = context.Event(), context.Event(), context.Event()
        paths = [str(Path(folder, f"{name}.npy")) for name in ("reference", "secondary")]
        for path, image in zip(paths, (pair.reference, pair.secondary), strict=True):
            np.save(path, image)
        parts = paths, method, given, self.busy, self.idle, self.over
        self.process = context.Process(target=_busy, args=parts, daemon=True)
        self.process.start()
        self._rests()

    def _rests(self) -> None:
        """Wait until it does nothing."""
        while not self.idle.wait(1):
            if not self.process.is_alive():
                raise RuntimeError("the other process ended, as it says above")

    @contextmanager
    def beside(self) -> Iterator[None]:
        """It is at work inside, and rests afterwards."""
        self.idle.clear()
        self.busy.set()
        time.sleep(0.05)
        try:
            yield
        finally:
            self.busy.clear()
            self._rests()

    def end(self) -> None:
        self.over.set()
        self.busy.set()
        self.process.join()


def _busy(paths: list[str], method: str, given: argparse.Namespace, busy: Any, idle: Any, over: Any) -> None:
    on_one_thread(pinned=False)
    reference, secondary = (np.load(path) for path in paths)
    while not over.is_set():
        featreg.match(
            reference, secondary, method=method, model="affine", n_features=given.features, seed=given.seed,
            block=False, threads=1,
        )  # fmt: skip
        if not busy.is_set():
            idle.set()
            busy.wait()


def shares(pair: SimulatedPair, method: str, given: argparse.Namespace) -> tuple[list[float], list[float]]:
    """In each round, how many times sooner threads have the result, and how much more two processes get done."""
    sooner, ceiling = [], []

    def wall(threads: int) -> float:
        start = time.perf_counter()
        matched(pair, method, given, threads)
        return time.perf_counter() - start

    with TemporaryDirectory() as folder:
        neighbour = Neighbour(pair, method, given, folder)
        for turn in range(given.rounds + 1):
            alone, together = wall(1), wall(given.threads)
            with neighbour.beside():
                beside = wall(1)
            if turn:
                sooner.append(alone / together)
                ceiling.append(2 * alone / beside)
        neighbour.end()
    return sooner, ceiling


def quartiles(values: list[float]) -> str:
    if not values:
        return "-"
    low, middle, high = np.percentile(values, [25, 50, 75])
    return f"{middle:.2f} ({low:.2f} to {high:.2f})"


def rows_of(side: int, given: argparse.Namespace) -> list[list[Any]]:
    pair = sar_pair((side, side), rotation_deg=6.0, scale=1.02, shift=(5.0, 3.0), seed=given.seed)
    small = eight_bits(pair.reference), eight_bits(pair.secondary)
    methods = given.methods.split(",")
    one: dict[str, list[float]] = {name: [] for name in ("ORB", *methods)}
    results: dict[str, featreg.Registration] = {}
    for turn in range(given.rounds + 1):
        for name, samples in one.items():
            start = time.process_time()
            if name == "ORB":
                orb(small, given.features)
            else:
                results[name] = matched(pair, name, given, 1)
            samples += [time.process_time() - start] if turn else []
    found = []
    for name in methods:
        ratio = [mine / theirs for mine, theirs in zip(one[name], one["ORB"], strict=True)]
        per_pixel = 1e9 * float(np.median(one[name])) / side**2
        sooner, ceiling = shares(pair, name, given) if given.threads > 1 else ([], [])
        registration = results[name]
        rmse = float(featreg.evaluate(registration, pair.truth).grid_rmse)
        columns = quartiles(ratio), per_pixel, quartiles(sooner), quartiles(ceiling)
        found.append([side, name, *columns, registration.status, rmse])
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sides", default="600,4000")
    parser.add_argument("--methods", default="sar-orb,sar-sift")
    parser.add_argument("--features", type=int, default=2000)
    parser.add_argument("--threads", type=int, default=2, help="of the columns of wall times; 1 leaves them out")
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
