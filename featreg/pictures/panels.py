"""The panels of a picture as plain arrays: one image, a checkerboard of two, a two-colour overlay of two."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from featreg.errors import InputError
from featreg.types import BoolArray, Image

Gray = NDArray[np.uint8]
#: Longest side in pixels of one panel.
PANEL = 900
#: Gray of pixels that hold no data, and the largest ratio of amplitudes shown, dark to bright (40 dB).
INVALID, SPAN = 40, 100.0
#: Share of its brightness that an image keeps under lines.
DIM = 0.72


def display(image: Image) -> Gray:
    """The image as it is best seen: logarithm of the amplitude between its 1st and 99.5th percentile.

    Returns
    -------
    (H, W) uint8; pixels without data are a constant dark gray
    """
    return _stretched(image.amplitude, image.mask)


def checkerboard(reference: Image, aligned: Image | ArrayLike, tiles: int = 8) -> Gray:
    """(h, w) uint8 alternating tiles of the two images, the upper left one from the reference, reduced to a panel."""
    a, b, _ = _pair(reference, aligned)
    side = max(1, round(max(a.shape) / tiles))
    rows, columns = np.indices(a.shape) // side
    return np.where((rows + columns) % 2 == 0, a, b)


def overlay(reference: Image, aligned: Image | ArrayLike) -> Gray:
    """(h, w, 3) uint8 RGB, the reference in red and blue, the secondary in green, reduced to a panel.

    Both are smoothed and stretched alike, so that equal images give gray. Where one has no data, the other is shown
    in dim gray.
    """
    a, b, common = _pair(reference, aligned, smooth=True)
    picture = np.stack([a, b, a], axis=-1)
    picture[~common] = (np.maximum(a, b)[~common] * 0.45).astype(np.uint8)[:, None]
    return picture


def views_to_draw_on(reference: Image, secondary: Image) -> list[Gray]:
    """Both images to draw upon, at one scale unless their sizes are very different."""
    factors = [_factor(image.shape) for image in (reference, secondary)]
    if max(factors) < 2.5 * min(factors):
        factors = [min(factors)] * 2
    views = []
    for image, factor in zip((reference, secondary), factors, strict=True):
        view = _stretched(*resized(image.amplitude, image.mask, factor))
        views.append((view * DIM).round().astype(np.uint8))
    return views


def _factor(shape: tuple[int, int]) -> float:
    """Size of a panel over size of the image: reduced to fit, or enlarged by 2 at most."""
    longest = max(shape)
    return PANEL / longest if longest > PANEL else float(min(2, PANEL // longest))


def resized(amplitude: NDArray[np.float32], mask: BoolArray, factor: float) -> tuple[NDArray[np.float32], BoolArray]:
    """Amplitude and mask at `factor` times their size, averaged over the valid pixels where that is smaller."""
    import cv2

    if factor == 1:
        return amplitude, mask
    size = tuple(max(1, round(n * factor)) for n in amplitude.shape[::-1])
    method = cv2.INTER_AREA if factor < 1 else cv2.INTER_NEAREST
    filled = cv2.resize(np.where(mask, amplitude, 0).astype(np.float32), size, interpolation=method)
    weight = cv2.resize(mask.astype(np.float32), size, interpolation=method)
    return np.asarray(filled / np.maximum(weight, 1e-6), dtype=np.float32), np.asarray(weight >= 0.5)


def _stretched(amplitude: NDArray[np.float32], mask: BoolArray, within: BoolArray | None = None) -> Gray:
    """Logarithmic stretch over the valid pixels, by the percentiles of those in `within`."""
    return tone(amplitude, mask, tone_limits(amplitude, mask if within is None else mask & within))


def tone_limits(amplitude: NDArray[np.float32], within: BoolArray) -> tuple[float, float] | None:
    """The amplitudes that are shown black and white, by the percentiles of those in `within`; None where all are 0."""
    step = max(1, max(amplitude.shape) // 4096)  # percentiles of a large image need not see every pixel
    seen = amplitude[::step, ::step]
    seen = seen[within[::step, ::step] & (seen > 0)]
    if seen.size == 0:
        return None
    low, high = np.percentile(seen, [1, 99.5])
    return max(low, high / SPAN), high


def tone(amplitude: NDArray[np.float32], mask: BoolArray, limits: tuple[float, float] | None) -> Gray:
    """(H, W) uint8, logarithmic between the limits; `INVALID` where there is no data."""
    if limits is None:
        return np.where(mask, 0, INVALID).astype(np.uint8)
    low, high = limits
    level = np.log(np.maximum(amplitude, low) / low) / max(np.log(high / low), 1e-3)
    return np.where(mask, np.clip(255 * level, 0, 255).round(), INVALID).astype(np.uint8)


def _pair(reference: Image, aligned: Image | ArrayLike, smooth: bool = False) -> tuple[Gray, Gray, BoolArray]:
    """Both images on one panel, stretched alike over what they have in common; also where both have data."""
    if isinstance(aligned, Image):
        amplitude, mask = aligned.amplitude, aligned.mask
    else:
        array = np.abs(np.asarray(aligned)).astype(np.float32)
        mask = np.isfinite(array)
        amplitude = np.where(mask, array, 0).astype(np.float32)
    if amplitude.shape != reference.shape:
        raise InputError(f"the aligned image must have the reference's shape {reference.shape}, got {amplitude.shape}")
    pictures = [(reference.amplitude, reference.mask), (amplitude, mask)]
    if smooth and max(reference.shape) <= PANEL:
        # speckle differs between the images and would cover the colours with noise
        pictures = [(_smoothed(a, m), m) for a, m in pictures]
    (a, valid_a), (b, valid_b) = (resized(a, m, _factor(reference.shape)) for a, m in pictures)
    common = valid_a & valid_b
    within = common if common.any() else None
    return _stretched(a, valid_a, within), _stretched(b, valid_b, within), common


def _smoothed(amplitude: NDArray[np.float32], mask: BoolArray) -> NDArray[np.float32]:
    """Gaussian mean over about 3 pixels of the valid neighbours only."""
    import cv2

    weight = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), 1.0)
    total = cv2.GaussianBlur(np.where(mask, amplitude, 0).astype(np.float32), (0, 0), 1.0)
    return np.asarray(total / np.maximum(weight, 1e-6), dtype=np.float32)
