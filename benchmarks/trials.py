"""Related pairs of every difficulty for `trust.py`: one scene twice, warped and spoiled at random."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from measuring import DATA, read, real_scenes
from numpy.typing import NDArray

from featreg.interfaces import Model
from featreg.simulate import sar_pair

Floats = NDArray[np.float64]
Scene = tuple[str, NDArray[Any], NDArray[Any]]

#: How strong warp and spoiling are, drawn anew for each pair.
DIFFICULTIES = (0.15, 0.3, 0.6, 1.0)
#: Half of all trials are of the first.
METHODS = (
    "sar-orb", "sar-sift", "rift", "s-gof", "m-gof", "bfsift", "orb", "sift", "akaze", "optical-sar", "rc-obcls",
)  # fmt: skip
MODELS = ("rigid", "similarity", "affine", "homography", "polynomial2")
#: Share of the trials whose model need not hold the warp.
ANY_MODEL = 0.15
#: Method-model combinations on each pair, and the side of the images at most.
COMBINATIONS, SIDE = 5, 600


@dataclass(frozen=True, eq=False)
class Trial:
    """A pair of float images, NaN = no data, the (3, 3) truth reference -> secondary, and what is tried on it."""

    place: str
    reference: Floats
    secondary: Floats
    truth: Floats
    combinations: tuple[tuple[str, str], ...]


def all_scenes(seed: int) -> list[Scene]:
    """(place, first, second) dates, change pairs and floods, and single images; simulated ones without real images."""
    found: list[Scene] = [(place, first, second) for _, place, first, second in real_scenes()]
    if not found:
        made = [sar_pair((700, 700), looks=4, rotation_deg=0, scale=1, shift=(0, 0), seed=seed + i) for i in range(8)]
        return [(f"landscape {i}", pair.reference, pair.secondary) for i, pair in enumerate(made)]
    for path in sorted((DATA / "sentinel1_mosaic").glob("*.*"))[:1]:
        image = read(path)
        found.append(("mosaic", image, image))
    return found + [(place, first, first) for place, first, _ in found[:6]]


def trial(rng: np.random.Generator, scenes: list[Scene]) -> Trial:
    """Draw a pair and what is tried on it."""
    place, first, second = scenes[int(rng.integers(len(scenes)))]
    height, width = (int(min(a, b, SIDE)) for a, b in zip(first.shape, second.shape, strict=True))
    top, left = (int(rng.integers(0, n - side + 1)) for n, side in zip(first.shape, (height, width), strict=True))
    if second.shape != first.shape:
        top = left = 0
    here, there = (
        np.where(image > 0, image, np.nan if image.dtype != np.uint8 else 0).astype(np.float64)
        for image in (image[top : top + height, left : left + width] for image in (first, second))
    )
    hard = float(rng.choice(DIFFICULTIES))
    kind = int(rng.integers(4))
    truth = warp_of(rng, (height, width), hard, kind)
    if first is second:
        here, there = speckled(rng, here, int(rng.integers(1, 5))), speckled(rng, there, int(rng.integers(1, 5)))
    moved = cv2.warpPerspective(there, truth, (width, height), flags=cv2.INTER_LINEAR, borderValue=float("nan"))
    combinations: list[tuple[str, str]] = []
    while len(combinations) < COMBINATIONS:
        method = METHODS[0] if rng.random() < 0.5 else str(rng.choice(METHODS[1:]))
        # What holds a warp stands after its own kind; a second degree follows the perspectives drawn here.
        combination = method, str(rng.choice(MODELS if rng.random() < ANY_MODEL else MODELS[kind:]))
        if combination not in combinations:
            combinations.append(combination)
    return Trial(
        place, spoiled(rng, here, hard), spoiled(rng, np.asarray(moved, np.float64), hard), truth, tuple(combinations)
    )


def warp_of(rng: np.random.Generator, shape: tuple[int, int], hard: float, kind: int) -> Floats:
    """(3, 3) about the image centre, of kind `MODELS[kind]`: every part up to its most times `hard`."""
    angle, zoom = rng.uniform(-np.pi, np.pi) * hard, 2.0 ** (rng.uniform(-1, 1) * hard * (kind > 0))
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    linear = zoom * turn @ (np.eye(2) + rng.uniform(-0.03, 0.03, (2, 2)) * hard * (kind > 1))
    matrix = np.eye(3)
    matrix[:2, :2] = linear
    matrix[:2, 2] = rng.uniform(-0.6, 0.6, 2) * hard * np.array(shape[::-1]) * rng.random()
    matrix[2, :2] = rng.uniform(-0.05, 0.05, 2) * hard / max(shape) * (kind > 2)
    centre = np.eye(3)
    centre[:2, 2] = (np.array(shape[::-1]) - 1) / 2
    return np.asarray(centre @ matrix @ np.linalg.inv(centre))


def speckled(rng: np.random.Generator, amplitude: Floats, looks: int) -> Floats:
    """The amplitude with fresh speckle of so many looks."""
    return np.asarray(amplitude * np.sqrt(rng.gamma(looks, 1 / looks, amplitude.shape)))


def spoiled(rng: np.random.Generator, image: Floats, hard: float) -> Floats:
    """A random set of what happens to products."""
    out, (height, width) = image.copy(), image.shape
    top = float(np.nanpercentile(out, 99.5)) if np.isfinite(out).any() else 1.0
    wanted = rng.random(7) < 0.2 + 0.3 * hard
    if wanted[0]:
        out = speckled(rng, out, int(rng.integers(1, 5)))
    if wanted[1]:
        out = top * (out / top) ** rng.uniform(0.5, 2)
    if wanted[2]:
        kept = np.isfinite(out)
        out = np.where(kept, cv2.GaussianBlur(np.where(kept, out, 0), (0, 0), rng.uniform(0.5, 1.5)), np.nan)
    if wanted[3]:
        out = np.clip(np.rint(255 * out / top), 0, 255)
        top = 255.0
    if wanted[4]:
        for row in rng.integers(0, height, int(rng.integers(1, 4))):
            out[row : row + int(rng.integers(1, 6))] = np.nan
    if wanted[5]:
        y, x = np.mgrid[0:height, 0:width]
        out[y / height + x / width * rng.uniform(0.5, 1.5) < rng.uniform(0.1, 0.5)] = np.nan
    if wanted[6] and rng.random() < 0.3:
        out = np.clip(top - out, 0, None)
    return np.asarray(out)


def errors(model: Model, truth: Floats, shape: tuple[int, int]) -> tuple[float, float]:
    """Root mean square error in pixels over a grid of the overlap, and over one of the whole reference."""
    x, y = np.meshgrid(np.linspace(0, shape[1] - 1, 15), np.linspace(0, shape[0] - 1, 15))
    grid = np.column_stack([x.ravel(), y.ravel()])
    right = np.asarray(cv2.perspectiveTransform(grid[None], truth)[0])
    squares = ((model(grid) - right) ** 2).sum(axis=1)
    inside = np.asarray(((right >= 0) & (right <= np.array(shape[::-1]) - 1)).all(axis=1), np.bool_)
    if not inside.any():
        inside = np.ones(len(grid), np.bool_)
    return float(np.sqrt(squares[inside].mean())), float(np.sqrt(squares.mean()))
