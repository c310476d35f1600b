"""Samples whose level is none of a radar image: single wild ones, and fill values that nobody declared."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from featreg.types import BoolArray, Image

#: Powers of two between the amplitudes of a scene and an absurd one, in which there is no sample at all. Scenes are
#: denser: the brightest corner reflectors of real images, their side lobes, the roofs and the sea leave no gap of 6 dB.
EMPTY = 10
#: The same of what only looks like a fill, one value that many pixels hold.
EMPTY_HINT = 2
#: Share of the valid pixels that absurd samples of different values may be at most, and a fill is at least.
FEW, MANY = 1e-4, 1e-3
#: Share of the positive samples that must lie below an absurd level.
REST = 0.01
#: Images of more pixels are judged by so many random samples first.
LARGE, SAMPLES = 1 << 20, 4096
# Exponents of float32 amplitudes, bit patterns shifted by the mantissa.
MANTISSA = 23


def absurd_samples(image: Image) -> BoolArray | None:
    """Return the (H, W) bool map of samples of an absurd level, None where there is none; ``image.derive`` keeps it.

    Such samples lie above everything else by at least 60 dB with nothing in between, and are few or all of one value.
    Counted as data, one of 1e8 times the median decides the mean, and with it what counts as dark.
    """
    level = _level_above(image.amplitude, image.mask, EMPTY)
    if level is None:
        return None
    found = np.asarray((image.amplitude >= level) & image.mask)
    few = np.count_nonzero(found) <= max(1.0, FEW * image.valid_count)
    return found if few or _constant(image.amplitude[found]) else None


def fill_hint(image: Image, role: str) -> str:
    """Return words on a value that looks like an undeclared fill of an image, empty where there is none."""
    level = _level_above(image.amplitude, image.mask, EMPTY_HINT)
    if level is None:
        return ""
    values = image.amplitude[(image.amplitude >= level) & image.mask]
    share = values.size / max(1, image.valid_count)
    if share < MANY or not _constant(values):
        return ""
    given = {"intensity": float(values[0]) ** 2, "db": 20 * math.log10(float(values[0]))}
    value = given.get(image.scale, float(values[0]))
    return (
        f"{100 * share:.2g} % of the {role} hold {value:.6g}, far above all other samples: if that is a fill value, "
        f"give it as nodata="
    )


def _level_above(amplitude: NDArray[np.float32], mask: BoolArray, empty: int) -> float | None:
    """The least amplitude above the highest gap of at least `empty` powers of two between samples, or None."""
    from featreg.sar.sample_kernels import count_between

    if amplitude.size > LARGE and _dense(amplitude, empty):
        return None
    # The usual case in quick passes: hardly anything lies so far below the brightest sample. Invalid ones hold 0.
    _, highest = np.frexp(amplitude.max())
    level = np.float32(np.ldexp(1.0, int(highest) - 1 - empty))
    flat = amplitude.ravel()
    if count_between(flat, np.float32(0), level) < REST * count_between(flat, np.float32(0), np.float32(math.inf)):
        return None
    exponents = amplitude.view(np.uint32) >> MANTISSA
    counts = np.bincount(exponents.ravel(), minlength=256)[:256].copy()
    if not mask.all():
        counts -= np.bincount(exponents[~mask], minlength=256)[:256]
    counts[0] = 0  # zeros tell nothing
    used = np.flatnonzero(counts)
    gaps = np.flatnonzero(np.diff(used) > empty)
    if not len(gaps) or counts[: used[gaps[-1]] + 1].sum() < REST * counts.sum():
        return None
    below = amplitude[mask & (exponents <= used[gaps[-1]]) & (exponents > 0)]
    return None if _constant(below) else float(np.ldexp(1.0, int(used[gaps[-1] + 1]) - 127))


def _dense(amplitude: NDArray[np.float32], empty: int) -> bool:
    """Whether random samples and the brightest of all leave no gap of more than `empty` powers of two.

    What lies below them all are too few samples to count: one in a hundred would be among these.
    """
    some = amplitude.ravel()[np.random.default_rng(0).integers(0, amplitude.size, SAMPLES)]
    used = np.unique(np.append(some[some > 0], amplitude.max()).view(np.uint32) >> MANTISSA)
    return len(used) > 1 and bool((np.diff(used) <= empty).all())


def _constant(values: NDArray[np.float32]) -> bool:
    return bool(values.min() == values.max())
