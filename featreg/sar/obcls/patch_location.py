"""Tie points by patch correlation, pass by pass: each pass aligns the secondary by what the one before found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from featreg.errors import InputError
from featreg.sar.correlation import Peaks
from featreg.sar.obcls.alignment import aligned
from featreg.sar.obcls.association import Fit, Map
from featreg.sar.obcls.cancellation import cancelled_fit
from featreg.sar.obcls.patches import patch_shifts
from featreg.sar.obcls.targets import covered
from featreg.sar.speckle import mean_amplitude
from featreg.types import BoolArray, FloatArray, Image, IntArray, Matches

#: A further pass is not worth its time where the last one moved no corner by more than this, px.
STILL = 0.02
#: Shifts in px within which the peaks of aligned patches are taken for good at first.
NEAR = 8.0
Samples = Literal["cc", "rc"]


def check_samples(samples: str, reference: Image, secondary: Image) -> None:
    """Raise `InputError` where a complex correlation is asked for of images that are not complex."""
    for role, image in (("reference", reference), ("secondary", secondary)):
        if samples == "cc" and not image.is_complex:
            raise InputError(
                f"the {role} '{image.name}' holds amplitudes: complex correlation (cc) needs two complex images, "
                "amplitude correlation (rc) takes any"
            )


@dataclass(frozen=True)
class PatchLocation:
    """How tie points are located by the correlation of patches.

    Parameters
    ----------
    samples : "cc" (peak of the modulus of the complex correlation) or "rc" (of the correlation of the amplitudes)
    size : (H, W) of the patches, px; smaller where an image is
    passes : most passes
    subpixel : whether the peak is interpolated
    each : without alignment, each patch lies around its own point; else both around that of the reference
    zeros_are_data : whether areas of exactly zero amplitude are data
    """

    samples: str = "rc"
    size: tuple[int, int] = (64, 64)
    passes: int = 1
    subpixel: bool = True
    each: bool = False
    zeros_are_data: bool = False

    def locate(
        self,
        reference: Image,
        secondary: Image,
        here: FloatArray,
        there: FloatArray,
        fit: Fit,
        start: Map | None = None,
    ) -> Matches:
        """Return one tie point for each reference point whose patches hold something, wrong ones included.

        Parameters
        ----------
        reference, secondary : the images
        here : (N, 2) points of the reference
        there : (N, 2) their counterparts; (N, 2) of anything where `start` is given or patches lie around `here`
        fit : of the map that aligns the images between passes; linear
        start : a map that aligns them already
        """
        current, result = start, Matches.empty()
        for _ in range(self.passes):
            inside = np.ones(len(here), np.bool_)
            if current is not None:
                mapped = current(here)
                last = np.array(secondary.shape[::-1]) - 1
                inside = np.asarray(((mapped >= 0) & (mapped <= last)).all(axis=1))
            result, again = self._pass(reference, secondary, here[inside], there[inside], fit, current)
            if again is None:
                break
            before, current = current, again
            if before is not None and _distance(before, again, reference.shape) < STILL:
                break
        return result

    def _pass(
        self, reference: Image, secondary: Image, here: FloatArray, there: FloatArray, fit: Fit, current: Map | None
    ) -> tuple[Matches, Map | None]:
        """Tie points around the points `here`, and the map of the good ones."""
        first, first_valid = self._view(reference, None, reference.shape)
        second, second_valid = self._view(secondary, current, reference.shape)
        shape = (min(first.shape[0], second.shape[0]), min(first.shape[1], second.shape[1]))
        size = (min(self.size[0], shape[0]), min(self.size[1], shape[1]))
        at = other = _corners(here, size, shape)
        if current is None and self.each:
            at, other = _corners(here, size, first.shape), _corners(there, size, second.shape)
        found = patch_shifts(
            first, second, at, other, size, first_valid=first_valid, second_valid=second_valid, padded=current is None
        )
        moved = here + other - at + (found.shift if self.subpixel else np.rint(found.shift))
        usable = found.height > 0
        here, there = here[usable], (moved if current is None else current(moved))[usable]
        found = Peaks(*(getattr(found, name)[usable] for name in Peaks.__dataclass_fields__))
        near = None if current is None else np.hypot(*found.shift.T) <= NEAR
        again, keep = cancelled_fit(fit, here, there, near)
        covariance = None if again is None else _covariance(found, there - again(here), keep)
        return Matches(here, there, np.clip(found.height, 0, 1), covariance), again

    def _view(self, image: Image, current: Map | None, shape: tuple[int, int]) -> tuple[NDArray[Any], BoolArray | None]:
        """Samples and which are data (None for all), aligned to the (H, W) grid `shape` by a map where there is one."""
        valid = image.mask if self.zeros_are_data else covered(image)
        pixels = image.pixels if self.samples == "cc" else image.amplitude
        # Relative to the mean, so that energies stay in float32's range whatever the image's calibration.
        pixels = pixels * np.float32(1 / max(mean_amplitude(image), 1e-30))
        if current is not None:
            return aligned(pixels, valid, _matrix(current), shape)
        return pixels, (None if valid.all() else valid)


def _matrix(linear: Map) -> FloatArray:
    """(2, 3) matrix of a linear map."""
    origin, x, y = linear(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    return np.column_stack([x - origin, y - origin, origin])


def _corners(xy: FloatArray, size: tuple[int, int], shape: tuple[int, ...]) -> IntArray:
    """(N, 2) first pixel of patches of (H, W) around points, moved into the image of (H, W)."""
    half = np.array([size[1] // 2, size[0] // 2])
    last = np.array([shape[1] - size[1], shape[0] - size[0]])
    return np.asarray(np.clip(np.rint(xy).astype(np.int64) - half, 0, last))


def _distance(first: Map, second: Map, shape: tuple[int, int]) -> float:
    """Largest distance in pixels between two maps at the corners of the reference."""
    height, width = shape
    corners = np.array([[0, 0], [width - 1, 0], [0, height - 1], [width - 1, height - 1]], np.float64)
    return float(np.hypot(*(first(corners) - second(corners)).T).max())


def _covariance(found: Peaks, residuals: FloatArray, keep: BoolArray) -> FloatArray:
    """(M, 2, 2) px^2: (1 - rho^2) over the curvature, times one factor for all; NaN where the peak is not sound."""
    sound = found.sound
    out = np.full((len(sound), 2, 2), np.nan)
    spread = np.maximum(1 - found.height[sound, None, None] ** 2, 1e-6)
    out[sound] = spread * np.linalg.inv(found.curvature[sound])
    judged = keep & sound
    if judged.sum() >= 3:
        squared = np.einsum("ni,nij,nj->n", residuals[judged], np.linalg.inv(out[judged]), residuals[judged])
        # The median squared Mahalanobis length of two Gaussian errors is 2 ln 2.
        out *= max(float(np.median(squared)) / (2 * np.log(2)), 1e-12)
    return out
