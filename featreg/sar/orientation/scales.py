"""Windows on two scales: where speckle drowns the fine field, a coarser one, less noisy, speaks with it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from featreg.sar.orientation.levels import Level, aligned
from featreg.sar.orientation.precision import Part
from featreg.sar.orientation.windows import Surfaces, correlated_around
from featreg.sar.speckle import unlike
from featreg.types import Image

F32 = NDArray[np.float32]

#: Samples of a level in one of the coarser level along each axis, alpha of its gradients over that of the level in
#: samples of each, and the weight of its correlations against those of the level.
HALF, BROADER, WEIGHT = 2, 1.25, 1.5
#: Windows agree where the highest mean of their surfaces is so large a share of the mean of their own highest values.
AGREEING = 0.85
#: Speckle drowns the fine field where the windows of the coarser one correlate so many times as much.
DROWNED = 2.0


def with_coarser(
    reference: Image, secondary: Image, level: Level, found: Surfaces, samples: float, alpha: float
) -> Surfaces:
    """Return the surfaces of a level, or with those of a coarser level where windows disagree because of speckle.

    Parameters
    ----------
    reference, secondary : the images
    level, found : the level and its surfaces
    samples, alpha : by which it was made (`featreg.sar.orientation.levels.aligned`)

    Notes
    -----
    The coarser level has half the samples, its windows as many as those of the level: twice the side on the ground. All
    windows together say how much each level knows, by the highest mean of their surfaces. Structure that differs, as
    between an optical and a SAR image, differs on both levels: of 38 such pairs 37 have at most twice the correlation
    on the coarser level, and what these have in common there is less precise. So images of different kind stay with the
    finer level, and so do dates whose windows agree by themselves.
    """
    common = _common(found.values)
    if not len(found) or common >= AGREEING * float(found.values.max(axis=(1, 2)).mean()):
        return found
    if unlike(reference, secondary):
        return found
    coarse = aligned(reference, secondary, level.affine, samples / HALF, BROADER * alpha)
    values = correlated_around(coarse, level.reference_xy(found.xy), found.side, math.ceil(found.reach / HALF))
    if not _common(values) > DROWNED * common:
        return found
    both = (found.values + np.float32(WEIGHT) * finer(values, found.reach)) / np.float32(1 + WEIGHT)
    parts = (
        *(replace(part, weight=1 / (1 + WEIGHT)) for part in found.parts),
        Part(*_on_grid_of(level, coarse), HALF * found.side, WEIGHT / (1 + WEIGHT)),
    )
    return replace(found, values=np.asarray(both, np.float32), side=HALF * found.side, parts=parts)


def _on_grid_of(level: Level, coarse: Level) -> tuple[F32, F32]:
    """Both fields of a coarser level at the samples of a finer one."""
    import cv2

    onto = np.linalg.solve(coarse.to_reference, level.to_reference)[:2]
    here, there = (
        np.asarray(
            cv2.warpAffine(
                field, onto, level.valid.shape[::-1], flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP,
                borderMode=cv2.BORDER_CONSTANT,
            ),
            np.float32,
        )
        for field in (coarse.here, coarse.there)
    )  # fmt: skip
    return here, there


def _common(values: F32) -> float:
    """The highest mean over the windows of surfaces (N, K, K); 0 without any."""
    return float(values.mean(axis=0).max()) if len(values) else 0.0


def finer(values: F32, reach: int) -> F32:
    """Surfaces (N, 2 R + 1, 2 R + 1) at displacements of whole coarse samples, R of them, at those of whole fine ones.

    `reach` is the largest of these; between the samples the surface is interpolated by cubic convolution.
    """
    last = values.shape[1] - 1
    matrix = np.zeros((2 * reach + 1, last + 1), np.float32)
    for row, place in enumerate(np.arange(-reach, reach + 1) / HALF + last // 2):
        for column in range(math.floor(place) - 1, math.floor(place) + 3):
            # The surface goes on beyond its rim.
            matrix[row, min(max(column, 0), last)] += _cubic(abs(place - column))
    return np.asarray(matrix @ values @ matrix.T, np.float32)


def _cubic(distance: float) -> float:
    """The kernel of cubic convolution, Keys 1981, DOI 10.1109/TASSP.1981.1163711."""
    if distance < 1:
        return (1.5 * distance - 2.5) * distance**2 + 1
    return ((-0.5 * distance + 2.5) * distance - 4) * distance + 2 if distance < 2 else 0.0
