"""Isolated invalid samples are bridged for feature maps, so that no single one acts like a border of the image."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.sar.absurd import absurd_samples
from featreg.types import BoolArray, Image, Matches, read_only

F32 = NDArray[np.float32]

#: Widest gap that is bridged, px: stripes of so many missing rows, dropped lines, scattered samples.
GAP = 16
#: Least share of valid pixels in the square of 2 * GAP + 1 px around a bridged one.
LEAST_SHARE = 1 / 3

# Of the square of NEAR px around a sample that stands alone, more than this share is valid.
NEAR, SPARSE = 5, 0.5
# Draws at each distance until a valid sample is met.
TRIES = 3


def bridged(image: Image) -> Image:
    """Return the image as features are looked for in it; itself where no sample stands alone.

    Samples in gaps of at most `GAP` pixels take the weighted mean of the valid ones around them: they count as valid in
    `mask`, and `filled` names them, because no tie point lies on one. Wider holes, and gaps that are open to the border
    of the image, stay invalid. Samples of an absurd level (see `absurd_samples`) count as invalid.
    """
    absurd = image.derive(absurd_samples)
    if image.all_valid and absurd is None:
        return image
    invalid = ~image.mask if absurd is None else ~image.mask | absurd
    gaps = _gaps(invalid)
    if absurd is None and not gaps.any():
        return image
    valid = ~invalid
    pixels: NDArray[Any] = np.where(valid, image.pixels, image.pixels.dtype.type(0))
    if gaps.any():
        amplitude = _around(np.abs(pixels), valid)[gaps]
        pixels[gaps] = amplitude if not image.is_complex else amplitude * _phase_around(pixels, valid)[gaps]
        _roughen(pixels, valid, gaps)
    return replace(image, pixels=read_only(pixels), mask=read_only(valid | gaps), filled=read_only(gaps))


def on_samples(matches: Matches, reference: Image, secondary: Image) -> Matches:
    """Return the tie points without those that lie on a bridged sample of either image."""
    if reference.filled is None and secondary.filled is None:
        return matches
    good = on_sample(matches.reference_xy, reference) & on_sample(matches.secondary_xy, secondary)
    return matches if good.all() else matches.take(np.flatnonzero(good))


def on_sample(xy: NDArray[Any], image: Image) -> BoolArray:
    """(N,) whether points (N, 2) lie on no bridged sample of an image."""
    if image.filled is None:
        return np.ones(len(xy), np.bool_)
    x, y = np.clip(np.rint(xy), 0, [image.shape[1] - 1, image.shape[0] - 1]).astype(np.int64).T
    return np.asarray(~image.filled[y, x])


def _gaps(invalid: BoolArray) -> BoolArray:
    """Invalid pixels that belong to no wide hole, and around which enough is valid."""
    import cv2

    if not _has_narrow(invalid):
        return np.zeros(invalid.shape, np.bool_)
    side, pad = GAP + 1, 2 * GAP
    holes = cv2.copyMakeBorder(invalid.view(np.uint8), pad, pad, pad, pad, cv2.BORDER_CONSTANT, value=1)
    wide = cv2.morphologyEx(holes, cv2.MORPH_OPEN, np.ones((side, side), np.uint8))
    # What is joined to a wide hole within a gap's width is part of it: its corners, its frayed rim.
    count = cv2.countNonZero(wide)
    if count == cv2.countNonZero(holes):
        return np.zeros(invalid.shape, np.bool_)
    for _ in range(GAP):
        wide = cv2.min(cv2.dilate(wide, np.ones((3, 3), np.uint8)), holes)
        before, count = count, cv2.countNonZero(wide)
        if count == before:
            break
    gaps = invalid & (wide[pad:-pad, pad:-pad] == 0)
    if gaps.any():
        box = (2 * GAP + 1, 2 * GAP + 1)
        valid = (~invalid).astype(np.float32)
        share = cv2.blur(valid, box, borderType=cv2.BORDER_CONSTANT)
        inside = cv2.blur(np.ones_like(valid), box, borderType=cv2.BORDER_CONSTANT)
        gaps &= share >= np.float32(LEAST_SHARE) * inside
    return np.asarray(gaps, np.bool_)


def _has_narrow(invalid: BoolArray) -> bool:
    """Whether some invalid pixel lies in no square of GAP + 1 px that is invalid, as is all beyond the image."""
    from featreg.sar.bridging_kernels import has_narrow

    height, width = invalid.shape
    # As many pixels beyond each border as hold a square beside it, in words of 64.
    pad = 2 * GAP
    words = np.full((height + 2 * pad, -(-(width + 2 * pad) // 64)), -1, np.int64)
    rows = words.view(np.uint8).reshape(len(words), -1)
    packed = np.packbits(invalid, axis=1, bitorder="little")
    first = pad // 8
    last = first + packed.shape[1]
    rows[pad:-pad, first:last] = packed
    if width % 8:
        rows[pad:-pad, last - 1] |= np.uint8(0xFF << width % 8 & 0xFF)
    return has_narrow(words.view(np.uint64), np.empty(words.shape, np.uint64))


def _around(values: F32, valid: BoolArray) -> F32:
    """(H, W) mean of the valid values around each pixel, over as small a neighbourhood as holds some; invalid are 0.

    S. J. Gortler et al., "The Lumigraph", SIGGRAPH 1996, DOI 10.1145/237170.237200, section 3.4 (pull and push).
    """
    import cv2

    levels = [(np.asarray(values, np.float32), valid.astype(np.float32))]
    while not levels[-1][1].all() and min(levels[-1][1].shape) > 1:
        size = tuple((n + 1) // 2 for n in levels[-1][1].shape[::-1])
        total, weight = (cv2.resize(part, size, interpolation=cv2.INTER_AREA) for part in levels[-1])
        known = weight > 0
        # Any valid pixel makes a coarse one known, as its mean.
        levels.append((np.divide(total, weight, out=np.zeros_like(total), where=known), known.astype(np.float32)))
    mean, weight = levels[-1]
    everywhere = np.float32(mean[weight > 0].mean(dtype=np.float64)) if weight.any() else np.float32(0)
    found = np.where(weight > 0, mean, everywhere)
    for mean, weight in levels[-2::-1]:
        above = cv2.resize(found, weight.shape[::-1], interpolation=cv2.INTER_LINEAR)
        found = np.where(weight > 0, mean, above)
    return np.asarray(found, np.float32)


def _roughen(pixels: NDArray[Any], valid: BoolArray, gaps: BoolArray) -> None:
    """Give the pixels of a gap that have few valid ones around them the sample of some valid one nearby, in place.

    A mean has no speckle, and where it begins there is an edge, the same one in all images that lack the same rows.
    """
    import cv2

    share = cv2.blur(valid.astype(np.float32), (NEAR, NEAR), borderType=cv2.BORDER_REPLICATE)
    left = np.flatnonzero((gaps & (share < SPARSE)).ravel())
    height, width = valid.shape
    samples = pixels.copy()
    rng = np.random.default_rng(0)
    for radius in (2, 4, 8, 12, 16, 20):
        for _ in range(TRIES):
            y, x = np.divmod(left, width)
            dx, dy = rng.integers(-radius, radius + 1, (2, len(left)))
            x, y = np.clip(x + dx, 0, width - 1), np.clip(y + dy, 0, height - 1)
            found = valid[y, x]
            pixels.reshape(-1)[left[found]] = samples[y[found], x[found]]
            left = left[~found]


def _phase_around(pixels: NDArray[np.complex64], valid: BoolArray) -> NDArray[np.complex64]:
    """(H, W) unit phasors of the mean of the valid samples around each pixel."""
    mean = _around(pixels.real, valid) + 1j * _around(pixels.imag, valid)
    length = np.abs(mean)
    return np.asarray(np.where(length > 0, mean / np.where(length > 0, length, 1), 1), np.complex64)
