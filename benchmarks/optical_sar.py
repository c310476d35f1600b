"""Optical images against SAR images: folders of pairs in, one table out.

    python benchmarks/optical_sar.py [--folder DIR ...] [--truth outline|identity] [--methods all|a,b] [--pairs 40]
                                     [--features 5000] [--limit 5] [--seed 0] [--known PX]
                                     [--out FILE.md|.csv|.json]

A folder holds images named in pairs (port_1.png and port_2.png, as for `featreg compare`). "identity": both lie on one
grid. "outline": the second image shows the first one's place turned about the centre of its frame, as in the SRIF set,
whose published turns are wrong: centre and scale are taken as published, the turn is read from the black corners
(`outline.py`), and pairs whose corners are none of a turned square are left out, which is said. That truth is good to
about half a degree, which is 1.5 px on 256 x 256 px: the limit is 5 px, and "within 1 px" says little.

Without --folder the pairs of FEATREG_DATA/optical_sar are taken.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from measuring import DATA, on_one_thread, read
from outline import outline_of, turned_about_centres
from pair_protocol import KnownPair, arguments, run, spread

from featreg.study.image_pairs import pairs_in

LIMIT = 5.0


def known_pairs(folders: list[Path], truth: str, count: int) -> Iterator[KnownPair]:
    """The pairs of the folders whose truth can be had."""
    found = [pair for folder in folders for pair in pairs_in(folder)]
    usable = []
    for pair in found:
        first, second = read(Path(pair["reference"])), read(Path(pair["secondary"]))
        if truth == "identity":
            same = np.eye(3)[:2]
            usable.append(KnownPair(pair["name"], pair["name"], first, second, same))
            continue
        if first.shape[0] != first.shape[1] or second.shape[0] != second.shape[1] or second.dtype != np.uint8:
            print(f"left out: {pair['name']} is not square")
            continue
        seen = outline_of(second)
        if not seen.clear:
            print(
                f"left out: {pair['name']}, its black corners agree with a turned square by {seen.agreement:.2f} only"
            )
            continue
        # The set turns counter-clockwise, by less than a quarter, which the outline alone cannot tell.
        matrix = turned_about_centres((first.shape[0], first.shape[1]), len(second), seen.turn_deg)
        usable.append(KnownPair(pair["name"], pair["name"], first, second, matrix, seen.mask))
    yield from spread(usable, count)


def main() -> None:
    parser = arguments(__doc__, LIMIT, 40)
    parser.add_argument("--folder", type=Path, action="append")
    parser.add_argument("--truth", default="outline", choices=("outline", "identity"))
    given = parser.parse_args()
    folders = given.folder or [DATA / "optical_sar"]
    said = {"outline": "the turn by the outline, centre and scale as published", "identity": "one grid"}[given.truth]
    run("Optical against SAR", known_pairs(folders, given.truth, given.pairs), given, said, model="similarity")


if __name__ == "__main__":
    on_one_thread(pinned=False)
    main()
