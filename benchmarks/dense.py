"""`sar-dense` beside OpenCV's ORB in time, and what its parts are worth.

    python benchmarks/dense.py [--rounds 7] [--pairs 24] [--optical 12] [--seed 0] [--unrelated 24]
                               [--picture FILE.jpg]

Time: one 600 x 600 pair of real texture under fresh speckle of four looks, or a simulated one; `sar-dense`, the same
and `rawg` with a model known to 10 px, and `sar-orb`, as ratios to OpenCV's ORB + brute force + GMS + MAGSAC at 2000
features.

Parts: dates and change pairs, the second turned by any angle and scaled by up to 10 %, optical-SAR pairs of the data,
and crops of different places, with the global search, the verification or the further candidates left out, and with
locating or refinement, which are off for this method, put in.

Picture: hard simulated pairs, aligned by `sar-dense`, and what other methods say of them.
"""

from __future__ import annotations

import argparse
import math
import textwrap
from collections.abc import Callable, Iterator
from typing import Any

import cv2
import numpy as np
from measuring import DATA, Pair, machine, measure, on_one_thread, read, real_scenes, table, warped
from numpy.typing import NDArray
from optical_sar import LIMIT, known_pairs
from pairs import by_opencv
from trust import scenes, unrelated

import featreg
from featreg.geometry import Affine
from featreg.simulate import sar_pair
from featreg.simulate.pairs import similarity_matrix

FEATURES, SIDE, RIGHT_PX = 2000, 600, 3.0
#: The global search left out: from where both images lie, as far as windows reach at the coarsest level.
NO_SEARCH = "the global search"
#: What is left out -> keywords of `match`. A chance that nothing misses and an ambiguity of 1 decide nothing.
PARTS: dict[str, dict[str, Any]] = {
    "nothing": {},
    NO_SEARCH: {},
    "further candidates": {"candidates": 1},
    "the verification's decision": {"chance": -1e-6, "ambiguity": 1.0},
    "nothing, locating put in": {"locate": True},
    "nothing, refinement put in": {"refine": True},
}
#: Methods whose verdicts the picture shows.
SAID = ("sar-orb", "rift", "optical-sar", "sar-dense")
Image = NDArray[Any]


def speed_pair(rng: np.random.Generator) -> tuple[Image, Image, NDArray[np.float64]]:
    found = sorted((DATA / "sentinel1_mosaic").glob("*.png"))
    if not found:
        pair = sar_pair((SIDE, SIDE), looks=4, rotation_deg=8, scale=1.03, shift=(6, -4), seed=int(rng.integers(1000)))
        return pair.reference, pair.secondary, pair.truth
    image = read(found[0])
    top, left = (int(rng.integers(0, n - SIDE)) for n in image.shape)
    texture = image[top : top + SIDE, left : left + SIDE].astype(np.float32) + 1
    truth = similarity_matrix(texture.shape, float(rng.uniform(-12, 12)), 1.03, (6, -4))
    one, other = (
        (view * np.sqrt(rng.gamma(4, 0.25, view.shape))).astype(np.float32)
        for view in (texture, warped(texture, truth))
    )
    return one, other, truth


def times(rng: np.random.Generator, rounds: int) -> str:
    reference, secondary, truth = speed_pair(rng)
    common: dict[str, Any] = {"model": "affine", "seed": 0, "nodata": 0, "n_features": FEATURES}
    known = Affine(truth + np.array([[0, 0, 4.0], [0, 0, -3.0]]))
    runs: dict[str, Callable[[], Any]] = {
        "OpenCV ORB": by_opencv(Pair("speed", "speed", reference, secondary, truth, 0), FEATURES),
        "sar-orb": lambda: featreg.match(reference, secondary, method="sar-orb", **common),
        "sar-dense": lambda: featreg.match(reference, secondary, method="sar-dense", **common),
        "sar-dense, known to 10 px": lambda: featreg.match(
            reference, secondary, method="sar-dense", initial=known, search_radius=10, **common
        ),
        "rawg, known to 10 px": lambda: featreg.match(
            reference, secondary, method="rawg", initial=known, search_radius=10, **common
        ),
    }
    spent = measure(runs, rounds)
    rows = []
    for name, run in runs.items():
        result = run()
        error = error_of(result.model, truth, reference.shape) if isinstance(result, featreg.Registration) else math.nan
        rows.append([name, spent[name], spent[name].median / spent["OpenCV ORB"].median, error])
    return table(("method", "ms, median (quartiles)", "over ORB", "grid px"), rows)


def error_of(model: Any, truth: NDArray[np.float64], shape: tuple[int, ...]) -> float:
    """Root mean square error over the part of a grid that both images show; infinite without a model."""
    if not model:
        return math.inf
    x, y = np.meshgrid(np.linspace(0, shape[1] - 1, 15), np.linspace(0, shape[0] - 1, 15))
    grid = np.column_stack([x.ravel(), y.ravel()])
    there = grid @ truth[:, :2].T + truth[:, 2]
    inside = ((there >= 0) & (there <= np.array(shape[1::-1]) - 1)).all(axis=1)
    return float(np.sqrt(((model(grid[inside]) - there[inside]) ** 2).sum(axis=1).mean()))


def turned_pairs(rng: np.random.Generator, count: int) -> Iterator[tuple[Image, Image, NDArray[np.float64]]]:
    found = real_scenes()
    for i in range(count):
        if found:
            _, _, first, second = found[i * len(found) // count]
        else:
            pair = sar_pair((400, 400), looks=1, rotation_deg=0, scale=1, shift=(0, 0), seed=i)
            first, second = pair.reference, pair.secondary
        height, width = np.minimum(first.shape, second.shape)
        truth = similarity_matrix(
            (int(height), int(width)), float(rng.uniform(-180, 180)), float(rng.uniform(0.9, 1.1)), (5.0, -5.0)
        )
        yield first[:height, :width], warped(second[:height, :width], truth), truth


def parts(rng: np.random.Generator, related: int, optical: int, others: int, seed: int) -> str:
    turned, places = list(turned_pairs(rng, related)), scenes(seed)[1]
    folder = DATA / "optical_sar"
    unlike = list(known_pairs([folder], "outline", optical)) if optical and folder.is_dir() else []
    strangers = [unrelated(rng, places) for _ in range(others)]
    rows = []
    for name, keywords in PARTS.items():
        same, across = [], []
        for reference, secondary, truth in turned:
            mask = cv2.warpAffine(np.ones(reference.shape, np.uint8), truth, reference.shape[::-1]) > 0
            same.append(trusted_error(reference, secondary, truth, mask, name, keywords))
        for pair in unlike:
            across.append(
                trusted_error(pair.reference, pair.secondary, pair.truth, pair.secondary_mask, name, keywords)
            )
        false = sum(matched(one, other, name, keywords).status == "ok" for one, other, _ in strangers)
        rows.append([name, *said(same, RIGHT_PX), *said(across, LIMIT), f"{false} of {others}"])
    columns = ("right", "ok and wrong", "grid px")
    return table(
        ("left out", *columns, *(f"optical-SAR: {column}" for column in columns), "other places ok"),
        rows,
    )


def trusted_error(
    reference: Image, secondary: Image, truth: NDArray[np.float64], mask: Any, name: str, keywords: dict[str, Any]
) -> float:
    """Grid error of a trusted model, px; NaN where none is trusted."""
    result = matched(reference, secondary, name, {**keywords, "secondary_mask": mask})
    return error_of(result.model, truth, reference.shape) if result.status == "ok" else math.nan


def said(errors: list[float], limit: float) -> list[Any]:
    """How many of the errors are right, how many trusted and wrong, and the median of the right ones."""
    right = [error for error in errors if error <= limit]
    wrong = sum(error > limit for error in errors)
    return [f"{len(right)} of {len(errors)}", wrong, float(np.median(right)) if right else "-"]


def matched(reference: Image, secondary: Image, name: str, keywords: dict[str, Any]) -> Any:
    if name == NO_SEARCH:
        same = Affine(np.array([[1.0, 0, 0], [0, 1, 0]]))
        keywords = {**keywords, "initial": same, "search_radius": 12 * max(reference.shape) / 128}
    return featreg.match(reference, secondary, method="sar-dense", model="similarity", seed=0, **keywords)


def hard_pairs(seed: int) -> Iterator[tuple[str, Image, Image, NDArray[np.float64] | None]]:
    """(title, reference, secondary, truth or None where there is none) of simulated pairs, 300 x 300."""
    shape = (300, 300)
    pair = sar_pair(shape, looks=1, rotation_deg=137, scale=0.8, shift=(12, -9), seed=seed)
    yield "one look, turned by 137 degrees, scale 0.8", pair.reference, pair.secondary, pair.truth
    pair = sar_pair(shape, looks=4, rotation_deg=-64, scale=1.2, shift=(4, 9), seed=seed + 1)
    smooth = cv2.blur(pair.secondary, (5, 5))
    reverse = np.where(smooth > 0, smooth.mean() ** 2 / np.maximum(smooth, 1e-3), 0).astype(np.float32)
    yield "contrast reversed, smoothed, turned by -64 degrees", pair.reference, reverse, pair.truth
    pair = sar_pair(shape, looks=2, rotation_deg=0, scale=1, shift=(140, 130), seed=seed + 2)
    yield "a third of the area in common", pair.reference, pair.secondary, pair.truth
    other = sar_pair(shape, looks=4, rotation_deg=0, scale=1, shift=(0, 0), seed=seed + 3)
    yield "two places", pair.reference, other.reference, None


def picture(path: str, seed: int) -> None:
    """Write the hard pairs as rows: reference, secondary, chessboard of both as `sar-dense` aligns them, verdicts."""
    rows = []
    for title, reference, secondary, truth in hard_pairs(seed):
        lines, board = [*textwrap.wrap(title, 27), ""], None
        for method in SAID:
            result = featreg.match(reference, secondary, method=method, model="similarity", seed=0, nodata=0)
            error = error_of(result.model, truth, reference.shape) if truth is not None else math.inf
            told = f"{error:.2f} px off" if math.isfinite(error) else "there is none"
            lines.append(f"{method}: {result.status}" + (f", {told}" if result.status == "ok" else ""))
            if method == "sar-dense" and result.status == "ok":
                aligned = featreg.warp(result, secondary, like=reference.shape)
                y, x = np.indices(reference.shape)
                view = to_bytes(np.nan_to_num(np.asarray(aligned, np.float64)))
                board = np.where((y // 50 + x // 50) % 2 == 0, to_bytes(reference), view)
        # The picture is shown at half its size; its words are read there too.
        panel = np.full((300, 470), 255, np.uint8)
        for i, line in enumerate(lines):
            cv2.putText(panel, line, (12, 40 + 36 * i), cv2.FONT_HERSHEY_SIMPLEX, 0.85, 0, 2, cv2.LINE_AA)
        blank = np.full((300, 300), 235, np.uint8)
        views = [to_bytes(reference), to_bytes(secondary), blank if board is None else board, panel]
        rows.append(np.hstack([cv2.copyMakeBorder(view, 4, 4, 4, 4, cv2.BORDER_CONSTANT, value=255) for view in views]))
    shown = cv2.resize(np.vstack(rows), None, fx=2 / 3, fy=2 / 3, interpolation=cv2.INTER_AREA)
    cv2.imwrite(path, shown, [cv2.IMWRITE_JPEG_QUALITY, 75])


def to_bytes(image: Image) -> NDArray[np.uint8]:
    """An image as 8 bits, half of the range for its median."""
    valid = image[image > 0]
    scale = 90 / float(np.median(valid)) if valid.size else 1.0
    return np.clip(image * scale, 0, 255).astype(np.uint8)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=7, help="of times; 0 for none")
    parser.add_argument("--pairs", type=int, default=24)
    parser.add_argument("--optical", type=int, default=12, help="optical-SAR pairs")
    parser.add_argument("--unrelated", type=int, default=24)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--picture", help="JPEG of hard pairs to write")
    given = parser.parse_args()
    rng = np.random.default_rng(given.seed)
    print(f"{machine()}; seed {given.seed}\n")
    if given.rounds:
        print(f"{times(rng, given.rounds)}\n")
    if given.pairs:
        print(parts(rng, given.pairs, given.optical, given.unrelated, given.seed))
    if given.picture:
        picture(given.picture, given.seed)


if __name__ == "__main__":
    on_one_thread()
    main()
