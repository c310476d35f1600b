"""Tables 2 and 3 of the SAR-ORB paper with our methods: one protocol for all, in the paper's own columns.

    python benchmarks/tables.py table2|table3 [--paper] [--features 5000] [--seed 0] [--methods a,b] [--workers 1]
                                [--time-limit 300] [--resume DIR] [--report FILE.html]

Table 2 is one small pair, Table 3 at most ten. The paper's images cannot be had: real co-registered dates from the
folder that FEATREG_DATA names take their place, the second of each warped by a known affine, and simulated pairs where
there are none. Every method has the same budget; without --paper also the same filters, GMS and FSC.
"""

from __future__ import annotations

import argparse
from itertools import islice
from pathlib import Path

import numpy as np
from measuring import on_one_thread, real_pairs, simulated_pairs

from featreg import Experiment
from featreg.io import as_image
from featreg.study.layouts import NEEDS
from featreg.study.protocol import Protocol

METHODS = ("sar-sift", "rift", "bfsift", "s-gof", "m-gof", "sar-orb")
PAIRS = {"table2": 1, "table3": 10}
#: Warps of at most so many degrees, share of zoom, px.
WARP = (8.0, 0.03, 15.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("table", choices=tuple(PAIRS))
    parser.add_argument(
        "--paper", action="store_true", help="the methods as in their papers, each with its own filters"
    )
    parser.add_argument("--features", type=int, default=5000)
    parser.add_argument("--seed", type=int, default=0, help="of the warps and of the methods")
    parser.add_argument("--methods", default=",".join(METHODS))
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--time-limit", type=float, default=300.0)
    parser.add_argument("--resume", help="folder in which results are kept")
    parser.add_argument("--report", help="page to look at the results")
    given = parser.parse_args()
    count, rng = PAIRS[given.table], np.random.default_rng(given.seed)
    found = list(islice(real_pairs(rng, *WARP), count))
    if not found:
        print("No real images: FEATREG_DATA names no folder with any. Simulated pairs, which are easier.\n")
        found = list(simulated_pairs(rng, count, *WARP))
    pairs = [
        {
            "name": pair.name,
            "reference": as_image(pair.reference, nodata=pair.nodata),
            "secondary": as_image(pair.secondary, nodata=pair.nodata),
            "truth": pair.truth,
        }
        for pair in found
    ]
    suffix = "-paper" if given.paper else ""
    protocol = Protocol(
        n_features=given.features,
        # The paper counts what GMS kept; refined points are made from a model and no matches.
        filters=None if given.paper else ("gms", "fsc"),
        refine=False,
        time_limit=given.time_limit,
    )
    experiment = Experiment(
        pairs,
        [{"method": f"{name}{suffix}", "label": name} for name in given.methods.split(",") if name],
        seeds=[given.seed],
        protocol=protocol,
        metrics=NEEDS[given.table],
    )
    study = experiment.run(workers=given.workers, resume=given.resume)
    table = study.table()
    print(f"## {given.table.replace('table', 'Table ')}, {len(pairs)} pair{'s' * (len(pairs) > 1)}\n")
    print(table.to_markdown(layout=given.table))
    if given.report:
        from featreg.report.from_study import write_study_report

        write_study_report(Path(given.report), study)
    if table.failed:
        raise SystemExit(4)


if __name__ == "__main__":
    on_one_thread(pinned=False)
    main()
