"""What networks cost on one thread of a processor: the figures of docs/learned.md.

    python benchmarks/learned.py [--rounds 3] [--features 2000] [--memory 792 1024 1192]

CPU time. Networks that find and describe points look at an image of 600 x 600 px; LightGlue pairs the points of two;
whole methods register a pair of 512 x 515 px, the size of the Sentinel-1 dates, and so does `sar-orb` beside them. All
images are simulated: content hardly matters. Methods whose weights are not there are named and left out.

With --memory what a process takes that finds, describes and pairs the points of two images of such sides, beyond one
that did so on 256 x 256 px; each in a process of its own.
"""

from __future__ import annotations

import argparse
import resource
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from typing import Any

from measuring import machine, measure, on_one_thread, round_count, table
from numpy.typing import NDArray

import featreg
from featreg.errors import FeatregError
from featreg.interfaces import Detector
from featreg.io import as_image
from featreg.pipeline.assembly import assemble
from featreg.simulate import sar_pair
from featreg.types import Features

DETECTORS = {
    "ALIKED t16": ("kornia-aliked", {"model": "aliked-t16"}),
    "ALIKED n16": ("kornia-aliked", {}),
    "DISK": ("kornia-disk", {}),
    "XFeat": ("kornia-xfeat", {}),
}  # fmt: skip
PAIRINGS = {"LightGlue, ALIKED n16": ("ALIKED n16", "aliked"), "LightGlue, DISK": ("DISK", "disk")}
METHODS = ("sar-orb", "kornia-xfeat", "xfeat-lighterglue", "kornia-aliked-lightglue", "kornia-disk-lightglue")


def _detected(detector: Detector, pixels: NDArray[Any]) -> Features:
    """Of an image of its own each time: maps are kept with it."""
    return detector.detect_features(as_image(pixels))


IN_MEMORY = (*METHODS, "kornia-hessian-mkd", "kornia-dog-sift")


def peak_memory(method: str, side: int, features: int) -> float:
    """GB that this process takes for images of such a side beyond what small ones took, as the system counts it."""
    matcher = assemble(method, n_features=features, blocks=True).matcher
    assert matcher is not None
    peaks = []
    for size in (256, side):
        pair = sar_pair((size, size), rotation_deg=2.0, seed=0)
        matcher.match(as_image(pair.reference), as_image(pair.secondary))
        peaks.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024))
    return (peaks[1] - peaks[0]) / 1e9


def memory_table(sides: list[int], features: int) -> str:
    """One row a method, one column a side; "-" where its weights are not there."""
    rows = []
    for method in IN_MEMORY:
        row: list[Any] = [method]
        for side in sides:
            with ProcessPoolExecutor(1, get_context("spawn")) as pool:
                try:
                    row.append(f"{pool.submit(peak_memory, method, side, features).result():.2f}")
                except FeatregError:
                    row.append("-")
        rows.append(row)
    return table(("GB", *map(str, sides)), rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=round_count, default=3)
    parser.add_argument("--features", type=int, default=2000)
    parser.add_argument("--memory", type=int, nargs="+", default=[], help="sides, px")
    given = parser.parse_args()
    if given.memory:
        print(f"{machine()}; {given.features} features\n\n{memory_table(given.memory, given.features)}")
        return
    square, dates = (sar_pair(size, rotation_deg=3.0, seed=0) for size in ((600, 600), (512, 515)))
    images = [square.reference, square.secondary]
    functions: dict[str, Callable[[], Any]] = {}
    found: dict[str, list[Features]] = {}
    for label, (name, parameters) in DETECTORS.items():
        try:
            detector = featreg.create("detector", name, n_features=given.features, **parameters)
            found[label] = [_detected(detector, image) for image in images]
        except FeatregError as error:
            print(f"{label}: {error}")
            continue
        functions[f"{label}, 600 x 600"] = partial(_detected, detector, images[0])
    for label, (of, kind) in PAIRINGS.items():
        if of in found:
            pairing = featreg.create("nearest", "kornia-lightglue", features=kind)
            functions[f"{label}, {len(found[of][0])} x {len(found[of][1])}"] = partial(
                pairing.match_features, *found[of]
            )
    for method in METHODS:
        call = partial(
            featreg.match, dates.reference, dates.secondary, method=method, n_features=given.features, refine=False
        )
        try:
            call()
        except FeatregError as error:
            print(f"{method}: {error}")
            continue
        functions[f"{method}, 512 x 515"] = call
    timings = measure(functions, given.rounds)
    print(f"{machine()}; {given.rounds} rounds, {given.features} features\n")
    print(table(("what", "CPU s"), [[label, timing.median] for label, timing in timings.items()]))


if __name__ == "__main__":
    on_one_thread(pinned=False)
    main()
