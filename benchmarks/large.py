"""Large pairs looked at whole, on one thread and on two, beside OpenCV's ORB on the same pixels.

    python benchmarks/large.py [--sides 600,4000] [--methods sar-orb,sar-sift] [--features 2000] [--rounds 3] [--seed 0]

CPU time of the process over that of ORB's pair in the same round, on one thread; what a pixel costs more in a large
image than in a small one; and, of what two threads do, the share that ran beside something else, from the CPU time of
each of them: how much sooner an idle machine of two cores has the result.
"""

from __future__ import annotations

import argparse
import threading
import time
from typing import Any

import cv2
import numpy as np
from measuring import machine, on_one_thread, table
from numpy.typing import NDArray

import featreg
from featreg.simulate import SimulatedPair, sar_pair

COLUMNS = (
    "side", "method", "over ORB (quartiles)", "ns a pixel", "two threads: CPU over one", "busiest thread", "sooner",
    "status", "grid RMSE px",
)  # fmt: skip


def eight_bits(image: NDArray[Any]) -> NDArray[np.uint8]:
    top = float(np.percentile(image[::7, ::7], 99.5))
    return np.asarray(np.clip(image * (255 / top), 0, 255), np.uint8)


def orb(pair: tuple[NDArray[np.uint8], NDArray[np.uint8]], count: int) -> None:
    detector = cv2.ORB.create(count)
    (here, first), (there, second) = (detector.detectAndCompute(image, None) for image in pair)
    found = cv2.BFMatcher(cv2.NORM_HAMMING, True).match(first, second)
    points = [np.array(side, np.float64) for side in zip(*((here[m.queryIdx].pt, there[m.trainIdx].pt) for m in found))]
    cv2.estimateAffine2D(*points, method=cv2.USAC_MAGSAC, ransacReprojThreshold=3)


def matched(pair: SimulatedPair, method: str, given: argparse.Namespace, threads: int) -> featreg.Registration:
    return featreg.match(
        pair.reference, pair.secondary, method=method, model="affine", n_features=given.features, seed=given.seed,
        block=False, threads=threads,
    )  # fmt: skip


def threads_seconds() -> dict[int, float]:
    """CPU seconds of each thread of this process that is still there (Linux)."""
    found = {}
    for thread in threading.enumerate():
        if thread.ident is not None:
            found[thread.ident] = time.clock_gettime(time.pthread_getcpuclockid(thread.ident))
    return found
