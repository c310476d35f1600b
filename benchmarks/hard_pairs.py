"""Pairs that are hard for keypoints, kind by kind: who is right, who refuses, who is trusted and wrong.

    python benchmarks/hard_pairs.py [--methods sar-dense,auto,sar-orb] [--repeat 12] [--seed 0] [--kinds turned,strips]

turned: change pairs and floods, the second date at any rotation and 0.9 to 1.1 of the scale; further: the same under
one further look of speckle in either image. The others are cuts of one large scene, of 400 x 400 px where nothing else
is said, at any rotation and 0.9 to 1.1 of the scale, each under fresh speckle of its own: looks (one against one or
sixteen, another gamma), overlap (four looks, of the area in common 25 to 65 %, 18 to 22 %, 14 to 16 %), strips (four
looks; of 1000 x 110 and 1400 x 110 px, turned by up to 4 degrees) and chips (four looks; of 160 and 128 px).

Right is a trusted model within 3 px of the truth (RMS over a grid of what both images show), wrong is trusted and
beyond; the model is an affine one. Real images come from the folder that FEATREG_DATA names, else the scene is
simulated and change pairs are left out.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import cv2
import numpy as np
from dense import Image, error_of, said
from measuring import DATA, machine, on_one_thread, read, real_scenes, table, warped
from numpy.typing import NDArray

import featreg
from featreg.errors import FeatregError
from featreg.simulate import sar_pair
from featreg.simulate.pairs import similarity_matrix

Case = tuple[Image, Image, NDArray[np.float64]]
Drawn = Callable[[np.random.Generator, Image], Iterator[Case]]

LIMIT, SIDE, STRIP_TURN = 3.0, 400, 4.0
OVERLAPS = ((0.25, 0.65), (0.18, 0.22), (0.14, 0.16))
STRIPS, CHIPS = ((110, 1000), (110, 1400)), (160, 128)


def scene() -> Image:
    """The large scene, amplitude."""
    for path in sorted((DATA / "sentinel1_mosaic").glob("*.png")):
        return read(path).astype(np.float32) + 1
    return sar_pair((1600, 1600), looks=math.inf, rotation_deg=0, scale=1, shift=(0, 0), seed=0).reference


def speckled(rng: np.random.Generator, image: Image, looks: float) -> Image:
    return np.asarray(image * np.sqrt(rng.gamma(looks, 1 / looks, image.shape)), np.float32)


def similarity(rng: np.random.Generator, shape: tuple[int, int], turn: float = 180.0) -> NDArray[np.float64]:
    return similarity_matrix(
        shape, float(rng.uniform(-turn, turn)), float(rng.uniform(0.9, 1.1)), tuple(rng.uniform(-10, 10, 2))
    )


def dates(rng: np.random.Generator, _whole: Image, count: int, looks: float | None = None) -> Iterator[Case]:
    """Change pairs and floods spread over those at hand, where there are any."""
    found = [(first, second) for _, place, first, second in real_scenes() if place != "stack"]
    for i in range(min(count, len(found))):
        first, second = found[i * len(found) // count]
        height, width = (int(n) for n in np.minimum(first.shape, second.shape))
        truth = similarity(rng, (height, width))
        one, other = first[:height, :width], warped(second[:height, :width], truth)
        yield (one, other, truth) if looks is None else (speckled(rng, one, looks), speckled(rng, other, looks), truth)


def cut(
    rng: np.random.Generator, whole: Image, shape: tuple[int, int], looks: tuple[float, float], *,
    turn: float = 180.0, common: tuple[float, float] | None = None, gamma: float = 1.0,
) -> Case:  # fmt: skip
    """A window of the scene, and one of its size elsewhere in it that shows a part of the same, 0 beyond the scene."""
    height, width = shape
    # Away from the border as far as the other window may reach, where the scene has room for that.
    rims = [min(side, (n - side - 1) // 2) for n, side in zip(whole.shape, shape, strict=True)]
    top, left = (int(rng.integers(r, n - side - r)) for r, n, side in zip(rims, whole.shape, shape, strict=True))
    truth = similarity(rng, shape, turn)
    if common is not None:
        at = rng.uniform(0, 2 * math.pi)
        along = np.array([math.cos(at), math.sin(at)])
        far = np.arange(0, 1.5, 0.005)
        shares = np.clip(1 - far[:, None] * np.abs(along), 0, 1).prod(axis=1)
        truth[:, 2] -= truth[:, :2] @ (far[np.argmax(shares <= rng.uniform(*common))] * along * [width, height])
    from_whole = np.column_stack([truth[:, :2], truth[:, 2] - truth[:, :2] @ [left, top]])
    other = cv2.warpAffine(whole, from_whole, (width, height), flags=cv2.INTER_LINEAR, borderValue=0)
    one = whole[top : top + height, left : left + width]
    return speckled(rng, one, looks[0]), speckled(rng, other**gamma, looks[1]), truth


def cuts(rng: np.random.Generator, whole: Image, repeat: int, shape: tuple[int, int], **drawn: Any) -> Iterator[Case]:
    """Pairs of windows of four looks."""
    return (cut(rng, whole, shape, (4, 4), **drawn) for _ in range(repeat))


def unlike(rng: np.random.Generator, whole: Image, repeat: int) -> Iterator[Case]:
    """One look against one and sixteen in turn, the second image with another gamma."""
    for i in range(repeat):
        yield cut(rng, whole, (SIDE, SIDE), (1, (1, 16)[i % 2]), gamma=float(rng.uniform(0.6, 1.4)))


def kinds(repeat: int) -> dict[str, tuple[str, Drawn]]:
    """Title -> its group, and the pairs that are drawn of it."""
    square = partial(cuts, repeat=repeat, shape=(SIDE, SIDE))
    return {
        "change pairs and floods": ("turned", partial(dates, count=repeat)),
        "the same, one further look": ("further", partial(dates, count=repeat, looks=1.0)),
        "one look against one or sixteen": ("looks", partial(unlike, repeat=repeat)),
        **{
            f"{100 * a:.0f} to {100 * b:.0f} % in common": ("overlap", partial(square, common=(a, b)))
            for a, b in OVERLAPS
        },
        **{
            f"strips of {width} x {height} px": (
                "strips",
                partial(cuts, repeat=repeat, shape=(height, width), turn=STRIP_TURN),
            )
            for height, width in STRIPS
        },
        **{f"chips of {n} px": ("chips", partial(cuts, repeat=repeat, shape=(n, n))) for n in CHIPS},
    }


def trusted_error(method: str, reference: Image, secondary: Image, truth: NDArray[np.float64]) -> float:
    """Grid error of a trusted model, px; NaN where none is trusted."""
    mask = warped(np.ones(reference.shape, np.uint8), truth) > 0
    try:
        found = featreg.match(reference, secondary, method=method, secondary_mask=mask & (secondary > 0), seed=0)
    except FeatregError:
        return math.nan
    return error_of(found.model, truth, reference.shape) if found.status == "ok" else math.nan


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--methods", default="sar-dense,auto,sar-orb")
    parser.add_argument("--repeat", type=int, default=12, help="pairs of each kind")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kinds", default="turned,further,looks,overlap,strips,chips")
    given = parser.parse_args()
    methods, whole, rows = given.methods.split(","), scene(), []
    for title, (group, drawn) in kinds(given.repeat).items():
        if group not in given.kinds.split(","):
            continue
        pairs = list(drawn(np.random.default_rng(given.seed), whole))
        for method in methods if pairs else ():
            rows.append([title, method, *said([trusted_error(method, *pair) for pair in pairs], LIMIT)])
    print(f"seed {given.seed}; {machine()}\n")
    print(table(("pairs", "method", "right", "ok and wrong", "grid px"), rows))


if __name__ == "__main__":
    on_one_thread()
    main()
