"""SAR images against SAR images of other dates: folders of co-registered pairs in, one table out.

    python benchmarks/sar_sar.py [--folder DIR ...] [--turn 180] [--zoom 0.1] [--shift 10] [--methods all|a,b]
                                 [--pairs 30] [--features 5000] [--limit 3] [--seed 0] [--known PX]
                                 [--out FILE.md|.csv|.json]

A folder holds co-registered images named in pairs (port_1.tif and port_2.tif, as for `featreg compare`). The second of
each is warped by a fresh similarity, a turn of up to --turn degrees either way, a zoom of up to --zoom and a shift of
up to --shift px; what the warp leaves empty is masked. The truth is that warp, as good as the co-registration: 0.1 px
for the Sentinel-1 stack, 0.5 to 1.2 px for the others, so that the limit is 3 px.

Without --folder the Sentinel-1 dates, the change pairs and the floods of FEATREG_DATA are taken.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from measuring import on_one_thread, read, real_scenes, warped
from numpy.typing import NDArray
from pair_protocol import KnownPair, arguments, run, spread

from featreg.simulate import similarity_matrix
from featreg.study.image_pairs import pairs_in

LIMIT = 3.0
Scene = tuple[str, str, NDArray[Any], NDArray[Any]]


def scenes_in(folders: list[Path] | None) -> list[Scene]:
    """(name, place, first date, second date)."""
    if folders is None:
        # The floods are many small pieces of one country, each a place of its own.
        return [(name, name if place == "floods" else place, a, b) for name, place, a, b in real_scenes()]
    found = [pair for folder in folders for pair in pairs_in(folder)]
    return [(p["name"], p["name"], read(Path(p["reference"])), read(Path(p["secondary"]))) for p in found]


def known_pairs(scenes: list[Scene], seed: int, turn: float, zoom: float, shift: float) -> Iterator[KnownPair]:
    """The pairs, the second image of each warped; the warp of a pair does not depend on which others there are."""
    for number, (name, place, first, second) in enumerate(scenes):
        rng = np.random.default_rng([seed, number])
        height, width = (int(n) for n in np.minimum(first.shape, second.shape))
        first, second = first[:height, :width], second[:height, :width]
        dx, dy = rng.uniform(-shift, shift, 2).tolist()
        truth = similarity_matrix(
            (height, width), float(rng.uniform(-turn, turn)), float(1 + rng.uniform(-zoom, zoom)), (dx, dy)
        )
        seen = cv2.warpAffine(np.ones((height, width), np.uint8), truth, (width, height), flags=cv2.INTER_NEAREST) > 0
        yield KnownPair(name, place, first, warped(second, truth), truth, seen)


def main() -> None:
    parser = arguments(__doc__, LIMIT, 30)
    parser.add_argument("--folder", type=Path, action="append")
    parser.add_argument("--turn", type=float, default=180.0)
    parser.add_argument("--zoom", type=float, default=0.1)
    parser.add_argument("--shift", type=float, default=10.0)
    given = parser.parse_args()
    scenes = spread(scenes_in(given.folder), given.pairs)
    pairs = known_pairs(scenes, given.seed, given.turn, given.zoom, given.shift)
    said = f"warps of up to {given.turn:g} degrees, {100 * given.zoom:g} %, {given.shift:g} px of co-registered dates"
    run("SAR against SAR", pairs, given, said)


if __name__ == "__main__":
    on_one_thread(pinned=False)
    main()
