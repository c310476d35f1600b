"""A bank of log-Gabor filters applied to a whole image by FFT.

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
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from featreg.errors import ParameterError

F32 = NDArray[np.float32]
C64 = NDArray[np.complex64]

# A radial profile is taken as zero beyond so many of its standard deviations (0.2 % of its peak).
REACH = 3.5
# Frequencies above it, in cycles per pixel, lie in the corners of the spectrum, where directions are unequal.
CUT_OFF, SHARPNESS = 0.45, 15


@dataclass(frozen=True)
class LogGabor:
    """The parameters of a bank.

    Parameters
    ----------
    scales, orientations : how many; orientation o has its normal at o * 180 / orientations degrees, x to y
    min_wavelength : of the finest scale, px
    multiplier : ratio of the wavelengths of two neighbouring scales
    bandwidth : ratio of the standard deviation of a profile to its centre frequency; 0.75 is about one octave,
        0.55 about two

    Notes
    -----
    ``exp(-log(f / f0)^2 / (2 log(bandwidth)^2))`` along the radius; a raised cosine that falls to zero at two
    orientations' distance along the angle. The sum over the orientations is the same at every angle.
    """

    scales: int = 4
    orientations: int = 6
    min_wavelength: float = 3.0
    multiplier: float = 1.6
    bandwidth: float = 0.75

    def __post_init__(self) -> None:
        if not (1 <= self.scales <= 8 and 6 <= self.orientations <= 24):
            raise ParameterError(
                "log-Gabor filters need 1 to 8 scales and 6 to 24 orientations, got "
                f"{self.scales} and {self.orientations}"
            )
        if not (2 <= self.min_wavelength < 1e3 and 1 < self.multiplier < 10 and 0 < self.bandwidth < 1):
            raise ParameterError(
                "log-Gabor filters need min_wavelength >= 2, multiplier > 1 and bandwidth between 0 and 1, got "
                f"{self.min_wavelength}, {self.multiplier} and {self.bandwidth}"
            )

    def wavelength(self, scale: int) -> float:
        """Wavelength in pixels of a scale's centre frequency."""
        return self.min_wavelength * self.multiplier**scale

    @property
    def margin(self) -> int:
        """Pixels by which an image is continued on each side; together the coarsest wavelength."""
        return math.ceil(self.wavelength(self.scales - 1) / 2)


def responses(view: F32, bank: LogGabor) -> Iterator[C64]:
    """Yield, orientation by orientation, the complex responses of all scales.

    Parameters
    ----------
    view : (H, W) float32
    bank : the filters

    Yields
    ------
    (scales, H, W) complex64
        Even-symmetric response + j * odd-symmetric one.
    """
    height, width = view.shape
    for parts, top, left in padded_responses(view, bank):
        yield np.stack([part[top : top + height, left : left + width] for part in parts])


def padded_responses(view: F32, bank: LogGabor) -> Iterator[tuple[tuple[C64, ...], int, int]]:
    """Yield as `responses`, without a copy: the padded arrays of the scales, and where (row, column) the image begins.

    The same arrays, C-contiguous, are filled again for the next orientation; outside the image they hold no responses.

    Notes
    -----
    The image is continued by reflection up to a length that the FFT likes. A one-sided filter of six or more
    orientations lies in a half-plane of the spectrum, and within its radial reach: only that block is transformed
    along the first axis, and only the image's own rows (or columns) along the second.
    """
    from scipy import fft

    from featreg.sar import index_map_kernels

    height, width = view.shape
    padded, top, left = _continued(view, bank.margin)
    spectrum = np.asarray(fft.fft2(padded), np.complex64).view(np.float32)
    radial, angular, limits = _filters(padded.shape[0], padded.shape[1], bank)
    parts = tuple(np.empty(padded.shape, np.complex64) for _ in range(bank.scales))
    for o in range(bank.orientations):
        across = _across(o, bank.orientations)
        size = np.array(padded.shape)
        used = np.minimum(size, [[size[0], columns] if across else [rows, size[1]] for rows, columns in limits])
        index_map_kernels.filtered(spectrum, radial, angular[o], used, tuple(part.view(np.float32) for part in parts))
        for part, (rows, columns) in zip(parts, used, strict=True):
            # In place: fresh arrays would cost as much as the transforms.
            if across:
                _inverse(fft, part[:, :columns], 0)
                _inverse(fft, part[top : top + height], 1)
            else:
                _inverse(fft, part[:rows], 1)
                _inverse(fft, part[:, left : left + width], 0)
        yield parts, top, left


def _inverse(fft: ModuleType, block: C64, axis: int) -> None:
    """Inverse FFT of a block along one axis, in place."""
    result = fft.ifft(block, axis=axis, overwrite_x=True)
    if not np.shares_memory(result, block):  # `overwrite_x` is a permission, not a promise
        block[...] = result


def _across(orientation: int, orientations: int) -> bool:
    """Whether an orientation's filter lies in the half-plane of positive x frequencies, rather than of y."""
    angle = math.pi * orientation / orientations
    return abs(math.cos(angle)) > math.sin(angle) - 1e-9


def _continued(view: F32, margin: int) -> tuple[F32, int, int]:
    """The image continued by reflection to a fast size, and where it begins there (row, column)."""
    import cv2
    from scipy import fft

    before, sizes = [], []
    for n in view.shape:
        size = fft.next_fast_len(n + 2 * margin)
        # Rows whose length in bytes is a multiple of a page fall on one another in the cache.
        while size % 256 == 0:
            size = fft.next_fast_len(size + 1)
        sizes.append(size)
        before.append((size - n) // 2)
    top, left = before
    bottom, right = sizes[0] - view.shape[0] - top, sizes[1] - view.shape[1] - left
    border = cv2.BORDER_REFLECT if min(view.shape) > max(bottom, right) else cv2.BORDER_REPLICATE
    padded = cv2.copyMakeBorder(view, top, bottom, left, right, border)
    return np.asarray(padded, np.float32), top, left


@lru_cache(maxsize=4)
def _filters(height: int, width: int, bank: LogGabor) -> tuple[F32, F32, tuple[tuple[int, int], ...]]:
    """Radial (scales, H, W) and angular (orientations, H, W) factors, and the rows and columns each scale needs."""
    y, x = np.meshgrid(np.fft.fftfreq(height), np.fft.fftfreq(width), indexing="ij")
    radius = np.hypot(x, y)
    radius[0, 0] = 1
    low_pass = 1 / (1 + (radius / CUT_OFF) ** (2 * SHARPNESS))
    sigma = -math.log(bank.bandwidth)
    radial = np.empty((bank.scales, height, width), np.float32)
    limits = []
    for s in range(bank.scales):
        centre = 1 / bank.wavelength(s)
        radial[s] = low_pass * np.exp(-(np.log(radius / centre) ** 2) / (2 * sigma**2))
        radial[s, 0, 0] = 0
        highest = min(0.5, centre * math.exp(REACH * sigma))
        limits.append((math.ceil(highest * height) + 1, math.ceil(highest * width) + 1))
    direction = np.arctan2(y, x)
    angular = np.empty((bank.orientations, height, width), np.float32)
    for o in range(bank.orientations):
        angle = math.pi * o / bank.orientations
        # Of the two opposite halves, the one with positive x (or y) frequencies: the odd part only changes its sign.
        if _across(o, bank.orientations) and math.cos(angle) < 0:
            angle -= math.pi
        away = np.abs((direction - angle + math.pi) % (2 * math.pi) - math.pi)
        angular[o] = (1 + np.cos(np.minimum(away * bank.orientations / 2, math.pi))) / 2
    radial.flags.writeable = angular.flags.writeable = False
    return radial, angular, tuple(limits)
