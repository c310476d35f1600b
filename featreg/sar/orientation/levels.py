"""Two images on one grid: the reference made smaller, the secondary resampled onto it, and the fields of both."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from featreg.sar.orientation.field import field_of, orientation_field
from featreg.sar.pyramid import reduced
from featreg.sar.speckle import mean_amplitude
from featreg.types import BoolArray, FloatArray, Image

F32 = NDArray[np.float32]

#: Stands for a sample that is not there.
OUTSIDE = np.float32(-1e30)


@dataclass(frozen=True, eq=False)
class Level:
    """The aligned fields of two images.

    Parameters
    ----------
    here, there : (h, w, 2) float32 fields of the reference and of the aligned secondary
    valid : (h, w) bool, samples that both hold
    to_reference : (3, 3) samples of the level -> px of the reference
    affine : (2, 3) the alignment, px of the reference -> px of the secondary
    """

    here: F32
    there: F32
    valid: BoolArray
    to_reference: FloatArray
    affine: FloatArray

    @property
    def factor(self) -> float:
        """Samples of the level per pixel of the reference."""
        return 1 / float(self.to_reference[0, 0])

    def reference_xy(self, xy: FloatArray) -> FloatArray:
        """Map (N, 2) samples to the reference."""
        return np.asarray(xy @ self.to_reference[:2, :2].T + self.to_reference[:2, 2])

    def secondary_xy(self, xy: FloatArray) -> FloatArray:
        """Map (N, 2) samples to the secondary by the alignment."""
        return np.asarray(self.reference_xy(xy) @ self.affine[:, :2].T + self.affine[:, 2])

    def moved(self, within: FloatArray) -> FloatArray:
        """The (2, 3) alignment after a (2, 3) map of samples of the reference to those of the aligned secondary."""
        back = np.linalg.inv(self.to_reference)
        return np.asarray((_square(self.affine) @ self.to_reference @ _square(within) @ back)[:2])


def aligned(reference: Image, secondary: Image, affine: FloatArray, side: float, alpha: float) -> Level:
    """Return the fields of two images under an alignment, at `side` samples along the longer side of the reference.

    No image is enlarged: where a pixel of either is larger on the ground, the level is coarser. The secondary is
    reduced first, by a power of the square root of two, and then resampled; its field is that of the resampled
    amplitude, so that both see the ground along the same axes.
    """
    import cv2

    scale = math.sqrt(abs(float(np.linalg.det(affine[:, :2]))))
    factor = min(1.0, side / max(reference.shape), scale)
    first = reduced(reference, factor)
    second = reduced(secondary, min(1.0, 2 ** (math.ceil(2 * math.log2(factor / scale) - 1e-9) / 2)))
    up, down = _to_base(first, reference), np.linalg.inv(_to_base(second, secondary))
    into = (down @ _square(affine) @ up)[:2]
    values: F32 = second.amplitude if second.all_valid else np.where(second.mask, second.amplitude, OUTSIDE)
    # What is interpolated from a sample outside, with however small a weight, is far below 0.
    pixels = np.asarray(
        cv2.warpAffine(
            values, into, first.shape[::-1], flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_CONSTANT, borderValue=float(OUTSIDE),
        ),
        np.float32,
    )  # fmt: skip
    covered = np.asarray(pixels >= 0, np.bool_)
    pixels[~covered] = mean_amplitude(second)
    there = field_of(pixels, alpha, covered)
    return Level(orientation_field(first, alpha), there, first.mask & covered, up, np.asarray(affine, np.float64))


def _to_base(level: Image, base: Image) -> FloatArray:
    """(3, 3) pixels of a reduced image -> those of the image."""
    sx, sy = base.shape[1] / level.shape[1], base.shape[0] / level.shape[0]
    return np.array([[sx, 0, 0.5 * sx - 0.5], [0, sy, 0.5 * sy - 0.5], [0, 0, 1.0]])


def _square(affine: FloatArray) -> FloatArray:
    return np.vstack([affine, [0, 0, 1.0]])
