"""A bank of log-Gabor filters applied to an image by FFT, piece by piece.

References
----------
D. J. Field, "Relations between the statistics of natural images and the response properties of cortical cells",
J. Opt. Soc. Am. A 4 (1987) 2379, DOI 10.1364/JOSAA.4.002379. P. Kovesi, "Image features from phase congruency",
Videre 1 (1999) 1.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from featreg.runtime.parameters import checked
from featreg.sar.gradients.fourier import channels, fast_length, inverse_transform, transform

F32 = NDArray[np.float32]
C64 = NDArray[np.complex64]

#: What the parameters of a bank may be, wherever they stand.
Scales = Annotated[int, Interval(ge=1, le=8)]
Orientations = Annotated[int, Interval(ge=4, le=24)]
MinWavelength = Annotated[float, Interval(ge=2, lt=1e3)]
Multiplier = Annotated[float, Interval(gt=1, lt=10)]
Bandwidth = Annotated[float, Interval(gt=0, lt=1)]

# Frequencies above it, in cycles per pixel, lie in the corners of the spectrum, where directions are unequal.
CUT_OFF, SHARPNESS = 0.45, 15
# Largest side of a piece, px; two of its spectra stay in the processor's cache. Longer filters need larger ones.
PIECE = 256
LEAST_MARGINS = 6
# Reach of the finest filter, in wavelengths, where its amplitude is sampled, and side of the spectrum it is read from.
SAMPLED_REACH, SAMPLED_SIDE = 2.0, 16


@checked("LogGabor")
@dataclass(frozen=True)
class LogGabor:
    """The parameters of a bank.

    Parameters
    ----------
    scales, orientations : how many; orientation o has its normal at o * 180 / orientations degrees, x to y; with fewer
        than four a filter would see both sides of its direction
    min_wavelength : of the finest scale, px
    multiplier : ratio of the wavelengths of two neighbouring scales
    bandwidth : ratio of the standard deviation of a profile to its centre frequency; 0.75 is about one octave,
        0.55 about two, 0.35 three and a half

    Notes
    -----
    ``exp(-log(f / f0)^2 / (2 log(bandwidth)^2))`` along the radius; a raised cosine that falls to zero at two
    orientations' distance along the angle. The sum over the orientations is the same at every angle.
    """

    scales: Scales = 4
    orientations: Orientations = 6
    min_wavelength: MinWavelength = 3.0
    multiplier: Multiplier = 1.6
    bandwidth: Bandwidth = 0.75

    def wavelength(self, scale: int) -> float:
        """Wavelength in pixels of a scale's centre frequency."""
        return self.min_wavelength * self.multiplier**scale

    @property
    def margin(self) -> int:
        """Pixels by which a piece is wider on each side; beyond lies 3 % (rms) of the coarsest filter."""
        return math.ceil(self.wavelength(self.scales - 1) * (0.69 - 0.21 / math.log(self.bandwidth)))


@dataclass(frozen=True, eq=False)
class Piece:
    """A piece of an image whose responses can be computed.

    `rows`, `columns` are its slices of the image; they begin `margin` pixels within the arrays of responses, which hold
    nothing of use around them. All pieces share their working memory.
    """

    rows: slice
    columns: slice
    margin: int
    spectrum: C64
    transfers: F32
    parts: C64

    def responses(self, orientation: int) -> C64:
        """Return the scales' complex (scales, h, w) responses, even-symmetric + j * odd-symmetric, C-contiguous.

        They are overwritten by the next call.
        """
        from featreg.sar.gradients import congruency_kernels

        first = orientation * len(self.parts)
        # Whole products and transforms: to leave out where a filter is zero takes longer, for OpenCV off its fast path.
        for part, transfer in zip(self.parts, self.transfers[first : first + len(self.parts)], strict=True):
            congruency_kernels.filtered(
                self.spectrum.view(np.float32).ravel(), transfer.ravel(), part.view(np.float32).ravel()
            )
            inverse_transform(part)
        return self.parts


def pieces(view: F32, bank: LogGabor) -> Iterator[Piece]:
    """Cut an image into pieces that can be filtered one after the other; beyond its border it is reflected.

    Parameters
    ----------
    view : (H, W) float32
    bank : the filters

    Yields
    ------
    Piece
        To be used before the next one is taken.
    """
    import cv2

    (high, height), (wide, width) = (_cut(side, bank.margin) for side in view.shape)
    transfers = _transfers(height, width, bank)
    # New memory costs as much as a transform.
    spectrum, nothing = np.empty((height, width), np.complex64), np.zeros((height, width), np.float32)
    parts = np.empty((bank.scales, height, width), np.complex64)
    for top in range(0, view.shape[0], high):
        for left in range(0, view.shape[1], wide):
            # A real transform would give half of the spectrum, and filling in the other half takes longer.
            part = _surrounded(view, top - bank.margin, left - bank.margin, height, width)
            cv2.merge((part, nothing), dst=channels(spectrum))
            transform(spectrum)
            rows, columns = slice(top, min(top + high, view.shape[0])), slice(left, min(left + wide, view.shape[1]))
            yield Piece(rows, columns, bank.margin, spectrum, transfers, parts)


def finest_amplitude(view: F32, rows: slice, columns: slice, bank: LogGabor) -> F32:
    """Return the (orientations, n, m) amplitude of the finest scale in some rows and columns, summed in the image."""
    import cv2

    reach, kernels = _finest(bank)
    side = 2 * reach + 1
    wide = np.asarray(cv2.copyMakeBorder(view, *(reach,) * 4, cv2.BORDER_REFLECT), np.float32)
    windows = np.lib.stride_tricks.sliding_window_view(wide, (side, side))[rows, columns]
    even, odd = np.moveaxis(windows.reshape(*windows.shape[:2], side**2) @ kernels, 2, 0).reshape(
        2, bank.orientations, *windows.shape[:2]
    )
    return np.asarray(np.sqrt(even**2 + odd**2), np.float32)


def _cut(length: int, margin: int) -> tuple[int, int]:
    """Length of a piece without its margins, and the length that is transformed, so that little is done twice."""
    largest = max(PIECE, LEAST_MARGINS * margin)
    best = (math.inf, 0, 0)
    for count in range(1, length + 1):
        inner = -(-length // count)
        size = fast_length(inner + 2 * margin)
        if size <= largest:
            best = min(best, (count * size, inner, size))
            if inner < 2 * margin:
                break
    return best[1:]


def _surrounded(view: F32, top: int, left: int, height: int, width: int) -> F32:
    """The (height, width) part of an image from a corner on, which may reach beyond it."""
    import cv2

    bottom, right = top + height, left + width
    inside = view[max(top, 0) : bottom, max(left, 0) : right]
    beyond = max(-top, 0), max(bottom - view.shape[0], 0), max(-left, 0), max(right - view.shape[1], 0)
    return np.asarray(cv2.copyMakeBorder(inside, *beyond, cv2.BORDER_REFLECT), np.float32)


@lru_cache(maxsize=6)
def _transfers(height: int, width: int, bank: LogGabor) -> F32:
    """The (orientations * scales, H, W) transfer functions, divided by H * W: zero on one half of the spectrum."""
    y, x = np.meshgrid(np.fft.fftfreq(height), np.fft.fftfreq(width), indexing="ij")
    radius, direction = np.hypot(x, y), np.arctan2(y, x)
    radius[0, 0] = 1
    low_pass = 1 / (1 + (radius / CUT_OFF) ** (2 * SHARPNESS)) / (height * width)
    low_pass[0, 0] = 0
    steepness = -0.5 / math.log(bank.bandwidth) ** 2
    octaves = np.log(radius)
    radial = [low_pass * np.exp(steepness * (octaves + math.log(bank.wavelength(s))) ** 2) for s in range(bank.scales)]
    out = np.empty((bank.orientations, bank.scales, height, width), np.float32)
    for o in range(bank.orientations):
        away = np.abs((direction - math.pi * o / bank.orientations + math.pi) % (2 * math.pi) - math.pi)
        angular = (1 + np.cos(np.minimum(away * bank.orientations / 2, math.pi))) / 2
        for s in range(bank.scales):
            out[o, s] = radial[s] * angular
    out.flags.writeable = False
    return out.reshape(-1, height, width)


@lru_cache(maxsize=4)
def _finest(bank: LogGabor) -> tuple[int, F32]:
    """Reach in pixels of the finest scale's filters, and their ((2 reach + 1)^2, 2 * orientations) even and odd parts.

    As they are laid over the image, so turned by half a turn.
    """
    reach = math.ceil(SAMPLED_REACH * bank.min_wavelength)
    side = SAMPLED_SIDE * math.ceil(bank.min_wavelength)
    spectra = _transfers(side, side, bank)[:: bank.scales].astype(np.float64) * side**2
    grid = -np.arange(-reach, reach + 1) % side
    kernels = np.fft.ifft2(spectra)[:, grid[:, None], grid].reshape(bank.orientations, -1)
    # Cut off, they would see a constant.
    kernels -= kernels.mean(axis=1, keepdims=True)
    return reach, np.ascontiguousarray(np.concatenate([kernels.real, kernels.imag]).T, np.float32)
