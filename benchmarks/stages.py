"""What locating the matches and refining add, each left out in turn.

    python benchmarks/stages.py [--methods sar-orb,rift] [--features 5000] [--simulated 3] [--rounds 3] [--seed 0]

NM, NCM, precision and RMSE are those of the matches: located where that is on, else as the local filters keep them; the
final tie points have columns of their own. Medians over pairs, change pairs apart from the dates of a stack; a missing
or refused model counts as infinitely wrong. Time is over that of the method with neither stage.
"""

from __future__ import annotations

import argparse
from functools import partial
from typing import Any

import numpy as np
from measuring import Pair, machine, measure, on_one_thread, real_pairs, simulated_pairs, table

import featreg

STAGES = {"neither": (False, False), "locate": (True, False), "refine": (False, True), "both": (True, True)}
COLUMNS = (
    "pairs", "method", "stages", "count", "ok", "NM", "NCM", "precision", "RMSE px", "final", "final RMSE px",
    "grid px", "time",
)  # fmt: skip


def registered(pair: Pair, method: str, stages: str, features: int, seed: int) -> featreg.Registration:
    locate, refine = STAGES[stages]
    return featreg.match(
        pair.reference, pair.secondary, method=method, model="affine", seed=seed, n_features=features,
        locate=locate, refine=refine, nodata=pair.nodata,
    )  # fmt: skip


def scored(found: featreg.Registration, pair: Pair) -> list[float]:
    matches, final = (featreg.evaluate(found, pair.truth, stage=stage) for stage in (None, "inliers"))
    grid = matches.grid_rmse if found.status == "ok" else np.inf
    return [matches.nm, matches.ncm, matches.precision, matches.rmse, final.nm, final.rmse, grid]


def rows(kind: str, pairs: list[Pair], methods: list[str], given: argparse.Namespace) -> list[list[Any]]:
    out: list[list[Any]] = []
    for method in methods:
        times: dict[str, list[float]] = {name: [] for name in STAGES}
        values: dict[str, list[list[float]]] = {name: [] for name in STAGES}
        ok = dict.fromkeys(STAGES, 0)
        for pair in pairs:
            runs = {name: partial(registered, pair, method, name, given.features, given.seed) for name in STAGES}
            spent = measure(runs, given.rounds) if given.rounds else {}
            for name, run in runs.items():
                found = run()
                ok[name] += found.status == "ok"
                values[name].append(scored(found, pair))
                if spent:
                    times[name].append(spent[name].median / spent["neither"].median)
        for name in STAGES:
            middle = [float(np.nanmedian(column)) for column in zip(*values[name], strict=True)]
            spent_on = float(np.median(times[name])) if times[name] else float("nan")
            out.append([kind, method, name, len(pairs), ok[name], *middle, spent_on])
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--methods", default="sar-orb,rift")
    parser.add_argument("--features", type=int, default=5000)
    parser.add_argument("--simulated", type=int, default=3)
    parser.add_argument("--rounds", type=int, default=3, help="of times; 0 for none")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    on_one_thread()
    rng = np.random.default_rng(given.seed)
    real = list(real_pairs(rng, 20, 0.1, 10, small=True))
    kinds = {
        "dates of a stack": [pair for pair in real if pair.place == "stack"],
        "change pairs": [pair for pair in real if pair.place not in ("stack", "floods")],
        "simulated": list(simulated_pairs(rng, given.simulated, 20, 0.1, 10)),
    }
    methods = given.methods.split(",")
    made = [row for kind, pairs in kinds.items() if pairs for row in rows(kind, pairs, methods, given)]
    print(f"seed {given.seed}, {given.features} features; {machine()}\n")
    print(table(COLUMNS, made))


if __name__ == "__main__":
    main()
