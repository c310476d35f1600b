"""What networks cost on one thread of a processor: the figures of docs/learned.md.

    python benchmarks/learned.py [--rounds 3] [--features 2000]

CPU time. Networks that find and describe points look at an image of 600 x 600 px; LightGlue pairs the points of two;
whole methods register a pair of 512 x 515 px, the size of the Sentinel-1 dates, and so does `sar-orb` beside them. All
images are simulated: content hardly matters. Methods whose weights are not there are named and left out.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from typing import Any

from measuring import machine, measure, on_one_thread, round_count, table
from numpy.typing import NDArray

import featreg
from featreg.errors import FeatregError
from featreg.interfaces import Detector
from featreg.io import as_image
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=round_count, default=3)
    parser.add_argument("--features", type=int, default=2000)
    given = parser.parse_args()
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
