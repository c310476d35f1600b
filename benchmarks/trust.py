"""How often a result is trusted that must not be, and how often one is refused that is right.

    python benchmarks/trust.py [--pairs 200] [--methods a,b] [--features 5000] [--model affine] [--workers 2] [--seed 0]
                               [--draws 0] [--unrelated 0]

Unrelated pairs are crops of different places: every "ok" is wrong. Related pairs are crops of two dates of one place,
the second warped by a known affine: "ok" with a model farther than 3 px from the truth is wrong, and a refused one is a
loss. Real images come from the folder that FEATREG_DATA names, else the landscapes are simulated.

`--draws N` adds N related pairs of every difficulty (`trials.py`), five combinations of method and model on each: how
far off is what is "ok", what do the results say of their own error, and how many right ones are refused?

`--unrelated N` adds N crops of different places, each tried by the next of the methods of `trials.py` with a model
drawn at random, translation too: none may be "ok".
"""

from __future__ import annotations

import argparse
import math
import re
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from typing import Any

import numpy as np
from measuring import machine, on_one_thread, random_affine, real_scenes, table, warped
from numpy.typing import NDArray
from trials import METHODS, MODELS, all_scenes, errors, trial

import featreg
from featreg.simulate import sar_pair
from featreg.study.measures import grid_rmse

WRONG_PX = 3.0
SMALLEST, LARGEST = 200, 600
#: A model this near to the truth over the overlap is right, px.
RIGHT_PX = 1.0
COLUMNS = ("method", "pairs", "count", "ok", "ok and wrong", "refused", "reasons of refusal")
DRAWN = (
    "trials", "ok", "ok, off > 1 px", "> 3 px", "> 5 px", "off > 1 px and stated < half of it",
    "stated / actual (quartiles)",
    "not ok", "of these right",
)  # fmt: skip
Scene = tuple[str, NDArray[Any], NDArray[Any]]


def scenes(seed: int) -> tuple[str, list[Scene]]:
    """What the pairs are cut from: (place, first date, second date)."""
    real = [(place, first, second) for _, place, first, second in real_scenes()]
    if real:
        return "real images", real
    made = [sar_pair((700, 700), looks=4, rotation_deg=0, scale=1, shift=(0, 0), seed=seed + i) for i in range(8)]
    return "simulated images", [(f"landscape {i}", p.reference, p.secondary) for i, p in enumerate(made)]


def crop(rng: np.random.Generator, shape: tuple[int, int], side: int) -> tuple[slice, slice]:
    top, left = (int(rng.integers(0, max(1, n - side + 1))) for n in shape)
    return slice(top, top + side), slice(left, left + side)


def nodata(image: NDArray[Any]) -> float | None:
    return None if image.dtype == np.uint8 else 0.0


def unrelated(rng: np.random.Generator, found: Sequence[Scene]) -> tuple[NDArray[Any], NDArray[Any], None]:
    while True:
        (place, first, _), (other, _, second) = (found[i] for i in rng.integers(0, len(found), 2))
        if place != other:
            break
    side = int(rng.integers(SMALLEST, LARGEST + 1))
    a, b = first[crop(rng, first.shape, side)], second[crop(rng, second.shape, side)]
    height, width = np.minimum(a.shape, b.shape)
    return a[:height, :width], b[:height, :width], None


def related(rng: np.random.Generator, found: Sequence[Scene]) -> tuple[NDArray[Any], NDArray[Any], NDArray[np.float64]]:
    _, first, second = found[int(rng.integers(len(found)))]
    height, width = np.minimum(first.shape, second.shape)
    cut = crop(rng, (int(height), int(width)), int(rng.integers(SMALLEST, LARGEST + 1)))
    a, b = first[:height, :width][cut], second[:height, :width][cut]
    truth = random_affine(rng, (a.shape[0], a.shape[1]), 20, 0.1, 10)
    return a, warped(b, truth), truth


def one(number: int, *, kind: str, method: str, features: int, model: str, seed: int) -> tuple[str, bool, str]:
    """Register pair `number` of a kind: (status, whether the model is wrong, reason)."""
    rng = np.random.default_rng([seed, number, kind == "related"])
    make = related if kind == "related" else unrelated
    reference, secondary, truth = make(rng, _found(seed))
    try:
        result = featreg.match(
            reference, secondary, method=method, model=model, n_features=features, seed=0, nodata=nodata(reference)
        )
    except featreg.FeatregError as error:
        return "unreliable", False, f"error: {error}"
    if truth is None:
        return result.status, result.status == "ok", result.reason
    shape = (reference.shape[0], reference.shape[1])
    wrong = not (result.model and grid_rmse(result.model, truth, shape) <= WRONG_PX)
    return result.status, wrong and result.status == "ok", result.reason


def drawn(number: int, *, seed: int) -> list[tuple[str, str, str, float, float, float, str]]:
    """Try draw `number`: (method, model, status, error over the overlap, over the image, stated one, reason) each."""
    made = trial(np.random.default_rng([seed, number]), _scenes_of_trials(seed))
    shape, rows = (made.reference.shape[0], made.reference.shape[1]), []
    for method, model in made.combinations:
        try:
            result = featreg.match(made.reference, made.secondary, method=method, model=model, seed=0)
        except featreg.FeatregError as error:
            rows.append((method, model, "unreliable", math.inf, math.inf, math.nan, f"error: {error}"))
            continue
        near, whole = errors(result.model, made.truth, shape) if result.model else (math.inf, math.inf)
        gate = result.gates.get("uncertainty")
        stated = math.nan if gate is None or gate.value is None else gate.value
        rows.append((method, model, result.status, near, whole, stated, result.reason))
    return rows


def alone(number: int, *, seed: int) -> tuple[str, str, str]:
    """Try unrelated pair `number`: (method, model, status)."""
    rng = np.random.default_rng([seed, number, 2])
    reference, secondary, _ = unrelated(rng, _found(seed))
    method, model = METHODS[number % len(METHODS)], str(rng.choice(("translation", *MODELS)))
    try:
        result = featreg.match(reference, secondary, method=method, model=model, seed=0, nodata=nodata(reference))
    except featreg.FeatregError:
        return method, model, "unreliable"
    return method, model, result.status


def of_draws(found: list[tuple[str, str, str, float, float, float, str]]) -> list[Any]:
    """One row of the table of the trials."""
    ok = [row for row in found if row[2] == "ok"]
    refused = [row for row in found if row[2] != "ok"]
    off = [sum(row[3] > limit for row in ok) for limit in (RIGHT_PX, 3.0, 5.0)]
    silent = sum(row[3] > RIGHT_PX and not row[5] >= row[4] / 2 for row in ok)
    ratios = [row[5] / row[4] for row in ok if row[4] > 0 and math.isfinite(row[5])]
    said = "{1:.2f} ({0:.2f} to {2:.2f})".format(*np.percentile(ratios, [25, 50, 75])) if ratios else "-"
    return [len(found), len(ok), *off, silent, said, len(refused), sum(row[3] <= RIGHT_PX for row in refused)]


_kept: dict[int, list[Scene]] = {}


def _found(seed: int) -> list[Scene]:
    """The scenes, read once per process."""
    if seed not in _kept:
        _kept[seed] = scenes(seed)[1]
    return _kept[seed]


_trials: dict[int, list[Scene]] = {}


def _scenes_of_trials(seed: int) -> list[Scene]:
    """What the draws are taken from, read once per process."""
    if seed not in _trials:
        _trials[seed] = all_scenes(seed)
    return _trials[seed]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=200, help="of each kind")
    parser.add_argument("--methods", default="sar-orb")
    parser.add_argument("--features", type=int, default=5000)
    parser.add_argument("--model", default="affine")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--draws", type=int, default=0, help="related pairs of every difficulty, five trials on each")
    parser.add_argument("--unrelated", type=int, default=0, help="crops of different places, over methods and models")
    parser.add_argument("--list", action="store_true", help="print every trial of the draws")
    given = parser.parse_args()
    rows: list[list[Any]] = []
    wrong: list[str] = []
    with ProcessPoolExecutor(given.workers, mp_context=get_context("spawn")) as pool:
        of_each = pool.map(partial(drawn, seed=given.seed), range(given.draws))
        trials = [row for rows_of_one in of_each for row in rows_of_one]
        strangers = list(pool.map(partial(alone, seed=given.seed), range(given.unrelated), chunksize=4))
        for method in given.methods.split(",") if given.pairs else ():
            for kind in ("unrelated", "related"):
                task = partial(
                    one, kind=kind, method=method, features=given.features, model=given.model, seed=given.seed
                )
                found = list(pool.map(task, range(given.pairs), chunksize=4))
                ok = sum(status == "ok" for status, _, _ in found)
                wrong += [f"{method}, {kind} pair {i}" for i, (_, bad, _) in enumerate(found) if bad]
                # Numbers differ from pair to pair; the first word says which gate it was.
                reasons = Counter(re.split(r" -?\d|:", r)[0] for s, _, r in found if s != "ok")
                said = "; ".join(f"{count} {reason}" for reason, count in reasons.most_common(3)) or "-"
                rows.append([method, kind, len(found), ok, sum(w for _, w, _ in found), len(found) - ok, said])
    if trials:
        print(f"## Related pairs of every difficulty\n\n{given.draws} draws, seed {given.seed}\n")
        print(table(DRAWN, [of_draws(trials)]), end="\n\n")
    if strangers:
        fooled = [f"{method} {model}" for method, model, status in strangers if status == "ok"]
        print(f"## Unrelated pairs over methods and models\n\n{len(strangers)} pairs, seed {given.seed}: ", end="")
        print(f"{len(fooled)} ok{': ' if fooled else ''}{'; '.join(fooled)}\n")
    if given.list:
        print(table(("method", "model", "status", "overlap", "image", "stated", "reason"), trials), end="\n\n")
    if not given.pairs:
        return
    print(f"## Trust\n\n{machine()}; {scenes(given.seed)[0]}, {given.features} features, model {given.model}, ", end="")
    print(f"seed {given.seed}\n\n{table(COLUMNS, rows)}\n")
    print(f"Trusted and wrong: {'; '.join(wrong) or 'none'}\n")


if __name__ == "__main__":
    on_one_thread(pinned=False)
    main()
