"""Tables 2 and 3 of the SAR-ORB paper with our methods: one protocol for all, in the paper's own columns.

    python benchmarks/tables.py table2|table3 [--paper] [--features N] [--seed 0] [--methods a,b] [--workers 1]
                                [--block 600] [--size 1500x1600] [--scenes DIR] [--split prior|proportional]
                                [--time-limit 900] [--resume DIR] [--report FILE.html]

Table 2 is one small pair. Table 3 is scenes in blocks: simulated pairs with RPCs and relief whose incidence differs by
as much as in the paper's Table 1, and a real mosaic under a known warp. The paper's images cannot be had. Every method
has the same budget and the same filters, GMS in each block and FSC over all, so that NM is counted alike; --paper takes
the features as published. ACT is the mean time of one block, measured one after the other: detection, description,
pairing, GMS (and locating, where the method does that); what a scene costs around its blocks has a column of its own.
"""

from __future__ import annotations

import argparse
import tempfile
from contextlib import ExitStack
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from measuring import on_one_thread, real_pairs, simulated_pairs
from scenes import INCIDENCES, real_scene, simulated_scenes

from featreg import Experiment
from featreg.io import as_image
from featreg.study.layouts import NEEDS
from featreg.study.protocol import Protocol

METHODS = ("sar-sift", "rift", "bfsift", "s-gof", "m-gof", "sar-orb")
#: Warps of the small pair, of at most so many degrees, share of zoom, px.
WARP = (8.0, 0.03, 15.0)
#: Most features of an image, or of a block.
FEATURES = {"table2": 5000, "table3": 1000}


def small_pair(rng: np.random.Generator) -> list[dict[str, Any]]:
    """One real pair, the second date warped by a known affine; a simulated one where there are no real images."""
    found = list(islice(real_pairs(rng, *WARP), 1))
    if not found:
        print("No real images: FEATREG_DATA names no folder with any. A simulated pair, which is easier.\n")
        found = list(simulated_pairs(rng, 1, *WARP))
    return [
        {
            "name": pair.name,
            "reference": as_image(pair.reference, nodata=pair.nodata),
            "secondary": as_image(pair.secondary, nodata=pair.nodata),
            "truth": pair.truth,
        }
        for pair in found
    ]


def scene_pairs(folder: Path, given: argparse.Namespace) -> list[dict[str, Any]]:
    """The scenes of Table 3."""
    rows, columns = (int(n) for n in given.size.split("x"))
    made = list(simulated_scenes(folder, (rows, columns), given.seed, given.pairs))
    real = list(real_scene(folder, given.seed))
    if not real:
        print("No real mosaic: FEATREG_DATA names no folder with one. Simulated scenes only.\n")
    return made + real


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("table", choices=tuple(FEATURES))
    parser.add_argument("--paper", action="store_true", help="the features as in their papers, nothing located again")
    parser.add_argument("--features", type=int, help="most of an image (5000), or of a block (1000)")
    parser.add_argument("--seed", type=int, default=0, help="of the images, the warps and the methods")
    parser.add_argument("--methods", default=",".join(METHODS))
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--block", type=int, default=600)
    parser.add_argument("--size", default="1500x1600", help="rows x columns of the simulated scenes")
    parser.add_argument("--pairs", type=int, default=len(INCIDENCES), help="simulated scenes, at most 3")
    parser.add_argument("--scenes", type=Path, help="folder in which the scenes are kept")
    parser.add_argument("--split", default="prior", help="how the secondary is divided: prior or proportional")
    parser.add_argument("--time-limit", type=float, default=900.0)
    parser.add_argument("--resume", help="folder in which results are kept")
    parser.add_argument("--report", help="page to look at the results")
    given = parser.parse_args()
    blocks = {} if given.table == "table2" else {"block": given.block, "split": given.split}
    protocol = Protocol(
        n_features=given.features or FEATURES[given.table],
        filters=("gms", "fsc"),
        locate=False if given.paper else None,
        # Refined points are made from a model and are no matches.
        refine=False,
        time_limit=given.time_limit,
        **blocks,
    )
    with ExitStack() as stack:
        folder = given.scenes or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        pairs = small_pair(np.random.default_rng(given.seed)) if not blocks else scene_pairs(folder, given)
        experiment = Experiment(
            pairs,
            [{"method": f"{name}{'-paper' * given.paper}", "label": name} for name in given.methods.split(",") if name],
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
