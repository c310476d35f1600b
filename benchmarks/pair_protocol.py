"""One protocol for pairs of images with a known truth: who is right, who is wrong, who refuses, in what time.

A result is "trusted" where its status is "ok". Its grid error is the RMS distance of its model from the truth on
15 x 15 points of the reference that the secondary shows. "within t px" is the share of pairs with a trusted model whose
grid error is at most t: a refusal and a failure count as not within. "wrong" are trusted models beyond the limit of the
set. Intervals are 95 % of the studentised bootstrap over places, as pairs of one place are no independent witnesses.
Time is CPU time on one thread of the whole call, reading left out, and its ratio to `orb` on the same pair; medians.

With --known every method is given the truth, displaced at random, as a model known beforehand.
"""

from __future__ import annotations

import argparse
import json
import time
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from measuring import machine, table
from numpy.typing import NDArray

import featreg
from featreg.errors import FeatregError
from featreg.geometry import Affine
from featreg.interfaces import FailedFit
from featreg.matching import check_keywords
from featreg.runtime.files import write_atomic
from featreg.study.intervals import interval
from featreg.types import BoolArray

WITHIN = (1.0, 3.0, 5.0, 10.0)
COLUMNS = ("method", "pairs", "trusted", "wrong", *(f"within {t:g} px" for t in WITHIN), "grid px", "CPU s", "x orb")
SUFFIXES = (".md", ".csv", ".json")


@dataclass(frozen=True, eq=False)
class KnownPair:
    """Two images, the (2, 3) truth reference -> secondary, the place they show, and which secondary pixels are data."""

    name: str
    place: str
    reference: NDArray[Any]
    secondary: NDArray[Any]
    truth: NDArray[np.float64]
    secondary_mask: BoolArray | None = None


@dataclass(frozen=True)
class Answer:
    """What a method says of a pair: "ok", "unreliable" or "failed"; grid error in px (NaN without a model), CPU s."""

    pair: str
    place: str
    method: str
    status: str
    error: float
    seconds: float
    reason: str


def arguments(text: str | None, limit: float, pairs: int) -> argparse.ArgumentParser:
    """The options that both benchmarks share."""
    parser = argparse.ArgumentParser(description=text, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--methods", default="all", help="names, or all that can run here without a download")
    parser.add_argument("--pairs", type=int, default=pairs, help="at most so many, spread over the set")
    parser.add_argument("--features", type=int, default=5000)
    parser.add_argument("--limit", type=float, default=limit, help="px beyond which a trusted model is wrong")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--known", type=float, help="px to which every method is told the model beforehand")
    parser.add_argument("--out", type=Path, help="write the table (.md, .csv), or it and every answer (.json)")
    return parser


def methods_of(text: str) -> tuple[list[str], list[str]]:
    """The methods that are run, and lines that say why others are not."""
    if text != "all":
        asked = [name for name in text.split(",") if name]
        for name in asked:
            try:
                check_keywords({"method": name})
            except FeatregError as error:
                raise SystemExit(f"--methods: {error}") from error
        return asked, []
    found, left_out = [], []
    for name in featreg.available("method"):
        try:
            check_keywords({"method": name})
        except FeatregError as error:
            left_out.append(f"{name}: {error}")
        else:
            found.append(name)
    return found, left_out


def spread(pairs: Sequence[Any], count: int) -> list[Any]:
    """At most `count` of them, evenly over all."""
    if len(pairs) <= count:
        return list(pairs)
    return [pairs[i] for i in np.unique(np.linspace(0, len(pairs) - 1, count).round().astype(int))]


def grid_error(model: Any, pair: KnownPair, count: int = 15) -> float:
    """RMS distance in px of a model from the truth where both images show the ground; NaN without a model."""
    if isinstance(model, FailedFit):
        return float("nan")
    (height, width), (there_h, there_w) = pair.reference.shape, pair.secondary.shape
    share = np.linspace(0.03, 0.97, count)
    x, y = np.meshgrid(share * (width - 1), share * (height - 1))
    points = np.column_stack([x.ravel(), y.ravel()])
    wanted = points @ pair.truth[:, :2].T + pair.truth[:, 2]
    shown = ((wanted >= 0) & (wanted <= (there_w - 1, there_h - 1))).all(axis=1)
    off = np.asarray(model(points[shown])) - wanted[shown]
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))


def told(pair: KnownPair, known: float | None, seed: int) -> dict[str, Any]:
    """Keywords of `match` by which a method knows the truth to `known` px: displaced by no more along any direction."""
    if known is None:
        return {}
    rng = np.random.default_rng([seed, zlib.crc32(pair.name.encode())])
    angle, length = rng.uniform(0, 2 * np.pi), known * np.sqrt(rng.uniform())
    away = length * np.array([[0, 0, np.cos(angle)], [0, 0, np.sin(angle)]])
    return {"initial": Affine(pair.truth + away), "search_radius": known}


def ask(method: str, pair: KnownPair, given: argparse.Namespace, **keywords: Any) -> Answer:
    """Match a pair; an error is an answer too."""
    keywords |= told(pair, given.known, given.seed)
    start = time.process_time()
    try:
        made = featreg.match(
            pair.reference, pair.secondary, method=method, seed=given.seed, n_features=given.features,
            secondary_mask=pair.secondary_mask, **keywords,
        )  # fmt: skip
    except Exception as error:
        seconds = time.process_time() - start
        why = f"{type(error).__name__}: {error}".splitlines()[0]
        return Answer(pair.name, pair.place, method, "failed", float("nan"), seconds, why)
    seconds = time.process_time() - start
    return Answer(pair.name, pair.place, method, made.status, grid_error(made.model, pair), seconds, made.reason)


def run(title: str, pairs: Iterable[KnownPair], given: argparse.Namespace, truth: str, **keywords: Any) -> None:
    """Ask every method about every pair, print protocol and table, write what was asked for."""
    if given.out is not None and given.out.suffix not in SUFFIXES:
        raise SystemExit(f"--out must end in {', '.join(SUFFIXES)}, got '{given.out}'")
    methods, left_out = methods_of(given.methods)
    asked = list(dict.fromkeys(["orb", *methods]))
    answers: list[Answer] = []
    for number, pair in enumerate(pairs):
        for method in list(asked):
            if number == 0:
                first = ask(method, pair, given, **keywords)  # compiling does not count
                cannot = first.reason.startswith(("PluginUnavailableError", "InputError"))
                if given.methods == "all" and first.status == "failed" and cannot:
                    # Complex images or weights that are not here: it cannot run on this set.
                    left_out.append(f"{method}: {first.reason}")
                    asked.remove(method)
                    methods.remove(method)
                    continue
            answers.append(ask(method, pair, given, **keywords))
    if not answers:
        raise SystemExit("no pairs: FEATREG_DATA names no folder with such images, and --folder none either")
    rows = [row(method, [a for a in answers if a.method == method], answers, given.limit) for method in methods]
    rows.sort(key=lambda line: (-float(str(line[COLUMNS.index("within 5 px")]).split()[0]), str(line[0])))
    names = list(dict.fromkeys(a.pair for a in answers))
    places = len({a.place for a in answers})
    what = ", ".join(f"{name}={value}" for name, value in keywords.items())
    protocol = [
        f"{len(names)} pairs of {places} places; truth: {truth}; n_features {given.features}; seed {given.seed}"
        + (f"; {what}" if what else "")
        + (f"; known beforehand to {given.known:g} px" if given.known is not None else ""),
        *((__doc__ or "").split("\n\n")[1].replace("\n", " ").strip().splitlines()),
        f"wrong: trusted and beyond {given.limit:g} px",
        *(f"{a.method} failed on {a.pair}: {a.reason}" for a in answers if a.status == "failed"),
        *(f"left out: {line}" for line in left_out),
        machine(),
    ]
    text = f"## {title}\n\n{table(COLUMNS, rows)}\n\n" + "\n".join(f"- {line}" for line in protocol) + "\n"
    print(text)
    if given.out is not None:
        write(given.out, text, rows, protocol, answers)


def row(method: str, own: Sequence[Answer], answers: Sequence[Answer], limit: float) -> list[Any]:
    """One line of the table."""
    trusted = [a for a in own if a.status == "ok"]
    wrong = sum(not a.error <= limit for a in trusted)
    places = list(dict.fromkeys(a.place for a in own))
    shares = []
    for t in WITHIN:
        groups = [[float(a.status == "ok" and a.error <= t) for a in own if a.place == place] for place in places]
        share = float(np.mean([value for group in groups for value in group]))
        found = interval(groups, bounds=(0.0, 1.0))
        known = found.told and found.low is not None and found.high is not None
        shares.append(f"{share:.2f}" + (f" [{found.low:.2f}, {found.high:.2f}]" if known else ""))
    good = [a.error for a in trusted if a.error <= limit]
    orb = {a.pair: a.seconds for a in answers if a.method == "orb"}
    ratio = float(np.median([a.seconds / max(orb[a.pair], 1e-9) for a in own]))
    seconds = float(np.median([a.seconds for a in own]))
    return [method, len(own), len(trusted), wrong, *shares, float(np.median(good)) if good else "-", seconds, ratio]


def write(path: Path, text: str, rows: Sequence[Sequence[Any]], protocol: list[str], answers: list[Answer]) -> None:
    """The table as Markdown or CSV, or with every answer as JSON, in which what is not known is null."""
    if path.suffix == ".md":
        content = text
    elif path.suffix == ".csv":
        content = "\n".join(",".join(f'"{cell}"' for cell in line) for line in (COLUMNS, *rows)) + "\n"
    else:
        said = [{**vars(a), "error": a.error if np.isfinite(a.error) else None} for a in answers]
        lines = [dict(zip(COLUMNS, line, strict=True)) for line in rows]
        content = json.dumps({"protocol": protocol, "table": lines, "answers": said}, indent=1) + "\n"
    write_atomic(path, content.encode())
