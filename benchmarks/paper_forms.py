"""The methods of the SAR-ORB paper's comparison as published, before any model: the table of docs/papers.md.

    python benchmarks/paper_forms.py [--seeds 0,1] [--features 3000]

Simulated pairs of 400 x 400 px, 4 looks, turned by 4 degrees. NM are the matches at each method's own last filter, or
all where it has none that looks at neighbourhoods; correct ones lie within 1.5 px of the truth; the grid RMSE is that
of the affine fitted at the end.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any

from measuring import machine, on_one_thread, table

import featreg
from featreg.simulate import sar_pair

FORMS: Mapping[str, tuple[str, Mapping[str, Any]]] = {
    "sar-orb-paper": ("sar-orb-paper", {}),
    "the same, edges clipped, direction of the amplitude": (
        "sar-orb-paper", {"detector.clip": True, "detector.centroid": "amplitude"},
    ),
    "sar-sift-paper": ("sar-sift-paper", {}),
    "the same, one direction a point": ("sar-sift-paper", {"detector.second": 1.0}),
    "bfsift-paper": ("bfsift-paper", {}),
    "the same, without the finest octave": ("bfsift-paper", {"detector.skip": 3}),
    "s-gof-paper": ("s-gof-paper", {}),
    "m-gof-paper": ("m-gof-paper", {}),
    "rift-paper": ("rift-paper", {}),
}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="0,1", help="of the pairs")
    parser.add_argument("--features", type=int, default=3000)
    given = parser.parse_args()
    seeds = [int(seed) for seed in given.seeds.split(",")]
    pairs = [sar_pair((400, 400), rotation_deg=4.0, seed=seed) for seed in seeds]
    rows = []
    for label, (method, keywords) in FORMS.items():
        scores = [
            featreg.evaluate(
                featreg.match(p.reference, p.secondary, method=method, n_features=given.features, **keywords), p.truth
            )
            for p in pairs
        ]
        nm, ncm, grid = (
            ", ".join(text.format(getattr(s, name)) for s in scores)
            for name, text in (("nm", "{}"), ("ncm", "{}"), ("grid_rmse", "{:.2f}"))
        )
        rows.append([label, nm, ncm, grid])
    print(f"{machine()}; pairs of seeds {given.seeds}, {given.features} features\n")
    print(table(("method", "NM", "correct within 1.5 px", "affine, grid RMSE px"), rows))


if __name__ == "__main__":
    on_one_thread(pinned=False)
    main()
