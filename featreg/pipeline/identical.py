"""Pixels that two images have in common without showing the same place: frames, labels, dead pixels, fixed patterns."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.threads import in_parts
from featreg.types import BoolArray, FloatArray, Image, IntArray, Matches, read_only

F32 = NDArray[np.float32]

#: Fewest identical pixels that can make a tie point, and the share of an image beyond which they are the scene.
LEAST, MOST = 20, 0.7
#: So many times more often than by chance a value stands at the same place in both images; most values that are asked.
EXCESS, MOST_VALUES = 4.0, 256
#: Of larger images about so many pixels tell how often a value is met, and the largest whole number that is counted
#: without sorting.
MOST_COUNTED, MOST_WHOLE = 1 << 17, (1 << 16) - 1
#: Share of a square that is identical where an area is, whatever its values, and the square.
DENSE, DENSE_BOX = 0.6, (9, 9)
#: Share of the black or saturated pixels of either image that are so in both, where they were drawn.
SHARED_DARK = 0.7
#: What was drawn before images were compressed with losses lies on both, among their brightest tenth: samples from this
#: share of the largest on, or from the second on and so near to each other; or it is darker than a share of the median.
DRAWN_BRIGHT, DRAWN_GREY, GREY_NOISE, DRAWN_DARK = 0.85, 0.2, 0.08, 0.1
#: Samples that tell what is bright and what is dark.
SAMPLES = 4000
#: Fewest pixels of a drawing in the square of 15 px in which two are compared, and the share of those of either image
#: that both have. Bright targets and speckle of two places overlap by less. A drawing covers no more of the image than
#: the last.
STROKE, OVERLAP, MOST_DRAWN = 12, 0.7, 0.3
#: Squares that both fill to at most this share lie on an outline, and the share of these that must be alike.
OUTLINE, SAME_OUTLINE = int(0.8 * 15**2), 0.6
#: So far around a drawing compression with losses leaves traces of it, px.
RINGING = 9
#: Side of the squares whose means are compared around the identical pixels, and how alike they are where the images
#: show the same place: 0.32 to 0.9 on pairs of one place on one grid, years apart; below 0.08 on other places.
BLOCK, ALIKE = 8, 0.2
#: Correlation of the finest detail from which on it is shared: speckle of two dates has below 0.1, and below 0.02 on
#: other places. Side of the middle part that is looked at, px.
PATTERN, CROP = 0.12, 160
#: So many identical pixels in a square of 3 x 3 are part of a line or an area, whose rim was drawn with it.
DRAWN = 3
#: Tie points that move by less than this stand still as the identical pixels do, px.
STILL_PX = 2.0


def identical_pixels(reference: Image, secondary: Image) -> BoolArray | None:
    """Return the (H, W) pixels that are identical at the same place while their surroundings disagree.

    All of them where the images share the finest detail and nothing else, as a fixed pattern of gains does. None where
    there are none: the images differ in size, no value is shared more often than by chance, or the images agree around
    those pixels too, as two images of one place on one grid do, or an image and itself.
    """
    if reference.shape != secondary.shape:
        return None
    mask = _both_valid(reference, secondary)
    a, b = (np.ascontiguousarray(image.amplitude) for image in (reference, secondary))
    # As many as are of one amplitude; samples of complex images are identical where their phases are as well.
    count, top = _surveyed(a, b, mask)
    same = _same(reference, secondary, mask) if count >= LEAST else None
    if same is not None:
        count = int(np.count_nonzero(same))
    if count > MOST * mask.size:
        return None
    drawn = _drawn(a, b, mask, top)
    if count >= LEAST or drawn is not None:
        same = _beyond_chance(_same(reference, secondary, mask) if same is None else same, a, b)
        same = same if drawn is None else same | drawn
        if np.count_nonzero(same) >= LEAST and _likeness(reference, secondary, same) < ALIKE:
            return np.ones_like(same) if _detail(reference, secondary, _widened(same, RINGING)) >= PATTERN else same
    if _detail(reference, secondary) >= PATTERN and _likeness(reference, secondary, np.zeros_like(mask)) < ALIKE:
        return np.ones_like(mask)
    return None


def _surveyed(a: F32, b: F32, mask: BoolArray) -> tuple[int, float]:
    """How many valid pixels of two maps are equal, and the highest of both; 0 where none is valid."""
    from featreg.pipeline import identical_kernels as kernels

    found: list[tuple[int, float]] = []

    def part(first: int, stop: int) -> None:
        some, highest = slice(first, stop), np.empty(a.shape[1], np.float32)
        count = kernels.surveyed(a[some], b[some], mask[some], highest)
        found.append((count, float(highest.max())))

    in_parts(part, *a.shape)
    return sum(count for count, _ in found), max(top for _, top in found)


def _both_valid(reference: Image, secondary: Image) -> BoolArray:
    """(H, W) pixels that are valid in both images."""
    if reference.all_valid:
        return secondary.mask
    return reference.mask if secondary.all_valid else reference.mask & secondary.mask


def _same(reference: Image, secondary: Image, mask: BoolArray) -> BoolArray:
    """(H, W) valid pixels that are identical in both images."""
    return np.asarray(reference.pixels == secondary.pixels) & mask


def without_identical(reference: Image, secondary: Image, same: BoolArray) -> tuple[Image, Image]:
    """Return both images with the identical pixels invalid, so that no method sees them, at any place of either.

    Both ends of a tie point may lie on one frame or label at different places, and slide along it. The rim of lines and
    areas goes with them, as it was blended with the image when they were drawn; single pixels have none. The images
    themselves where all pixels are identical: a pattern leaves nothing when it is left out.
    """
    if same.all():
        return reference, secondary
    import cv2

    share = cv2.blur(same.astype(np.float32), (3, 3), borderType=cv2.BORDER_CONSTANT)
    drawn = same | _widened(same & (share > (DRAWN - 0.5) / 9))
    return _without(reference, drawn), _without(secondary, drawn)


def _without(image: Image, pixels: BoolArray) -> Image:
    mask = image.mask & ~pixels
    kept = np.where(mask, image.pixels, image.pixels.dtype.type(0))
    return replace(image, pixels=read_only(kept), mask=read_only(mask))


def stands_still(matches: Matches) -> BoolArray:
    """(M,) tie points that have the same place in both images, as what is no part of the scene has."""
    return np.asarray(np.hypot(*(matches.secondary_xy - matches.reference_xy).T) <= STILL_PX)


def _beyond_chance(same: BoolArray, a: F32, b: F32) -> BoolArray:
    """Of the pixels that are equal, those in areas where nearly all are, or of values that meet too often.

    `same` is changed.
    """
    import cv2

    at = np.flatnonzero(same)
    here = a.ravel()[at]
    for value in (a.dtype.type(0), max(a.max(), b.max())):
        extreme = here == value
        count = np.count_nonzero(extreme)
        if count and count < SHARED_DARK * max(np.count_nonzero(view == value) for view in (a, b)):
            # Calm water quantised to 0 and saturated targets overlap by chance; what was drawn has one outline.
            same.ravel()[at[extreme]] = False
            at, here = at[~extreme], here[~extreme]
    near = cv2.boxFilter(same.view(np.uint8), -1, DENSE_BOX, normalize=False, borderType=cv2.BORDER_REPLICATE)
    values, counts = _counted(here)
    # What was drawn is among the values that meet most often.
    ranked = np.argsort(-counts, kind="stable")[:MOST_VALUES]
    ranked = ranked[counts[ranked] >= LEAST]
    often = values[ranked]
    if len(often):
        # How often each would meet by chance, of large images from so many of their pixels.
        share = max(1, a.size // MOST_COUNTED)
        while math.gcd(share, a.shape[1]) > 1:
            # Every nth pixel shall lie in every column, not in a few that may be those of a frame.
            share += 1
        chance = np.full(len(often), share * share / a.size)
        for view in (a, b):
            chance *= _counts_of(often, view.ravel()[::share])
        often = often[counts[ranked] > EXCESS * chance]
    found = near.ravel()[at] >= DENSE * math.prod(DENSE_BOX)
    if len(often):
        found |= np.isin(here, often)
    beyond = np.zeros_like(same)
    beyond.ravel()[at[found]] = True
    return beyond


def _counted(samples: F32) -> tuple[F32, IntArray]:
    """The values of some samples in ascending order, and how many there are of each; whole numbers without sorting."""
    whole = _whole_numbers(samples)
    if whole is None:
        values, counts = np.unique(samples, return_counts=True)
        return values, counts
    counts = np.bincount(whole)
    there = np.flatnonzero(counts)
    return there.astype(samples.dtype), counts[there]


def _counts_of(values: F32, samples: F32) -> IntArray:
    """How many of some samples have each of some values."""
    there, counts = _counted(samples)
    at = np.minimum(np.searchsorted(there, values), len(there) - 1)
    return np.asarray(np.where(there[at] == values, counts[at], 0))


def _whole_numbers(samples: F32) -> NDArray[np.int32] | None:
    """Samples as whole numbers below 2^16, None where they are not."""
    if not len(samples) or samples[0] % 1 or samples.max() > MOST_WHOLE or samples.min() < 0:
        return None
    whole = samples.astype(np.int32)
    return whole if bool((whole == samples).all()) else None


def _drawn(first: F32, second: F32, mask: BoolArray, top: float) -> BoolArray | None:
    """(H, W) pixels of the same bright or dark drawing on both images, which compression has made differ a little.

    None where there is none. `first` and `second` are amplitudes, `mask` (H, W) the pixels that are valid in both, and
    `top` the highest amplitude of these.
    """
    from featreg.pipeline import identical_kernels as kernels

    some = _some(mask)
    if not len(some):
        return None
    (median, ninth), (middle, upper) = (_deciles(view.ravel()[some]) for view in (first, second))
    dark, bright = np.float32(DRAWN_DARK * min(median, middle)), max(ninth, upper)
    grey, white = (np.float32(max(bright, share * top)) for share in (DRAWN_GREY, DRAWN_BRIGHT))
    bits, noise = np.empty(mask.shape, np.uint8), np.float32(GREY_NOISE * top)
    found_counts: list[IntArray] = []

    def part(begin: int, end: int) -> None:
        some, of_part = slice(begin, end), np.empty(3, np.int64)
        kernels.drawable(first[some], second[some], mask[some], dark, grey, white, noise, bits[some], of_part)
        found_counts.append(of_part)

    in_parts(part, *mask.shape)
    counts = sum(found_counts, np.zeros(3, np.int64))
    found: NDArray[np.uint8] | None = None
    for both, either, count in (
        (kernels.DARK_BOTH, kernels.DARK_EITHER, counts[0]),
        (kernels.WHITE_BOTH, kernels.WHITE_EITHER, counts[1]),
        (kernels.GREY_BOTH, kernels.GREY_EITHER, counts[2]),
    ):
        if count < LEAST:
            continue
        if both == kernels.DARK_BOTH and count < SHARED_DARK * max(
            np.count_nonzero(bits & np.uint8(bit)) for bit in (kernels.DARK_FIRST, kernels.DARK_SECOND)
        ):
            continue
        alike, around = np.empty(mask.shape, np.uint8), np.empty(2, np.int64)
        flat, into = bits.ravel(), alike.ravel()
        kernels.alike_around(flat, mask.shape[1], both, either, STROKE, np.float32(OVERLAP), OUTLINE, into, around)
        # Two lakes, or two bright fields, overlap inside; a drawing has the same outline on both.
        if around[1] > SAME_OUTLINE * around[0]:
            found = alike if found is None else found | alike
    if found is None or not 0 < np.count_nonzero(found) <= MOST_DRAWN * found.size:
        return None
    return found.view(np.bool_)


@lru_cache(maxsize=8)
def _places(size: int) -> IntArray:
    """`SAMPLES` numbers below `size`, drawn at random, always the same."""
    return read_only(np.random.default_rng(0).integers(0, size, SAMPLES))


def _some(mask: BoolArray) -> IntArray:
    """About `SAMPLES` places of a mask, drawn at random, as rows and columns may be those of a grid."""
    drawn = _places(mask.size)
    good = drawn[mask.ravel()[drawn]]
    if len(good) >= SAMPLES // 2:
        return good
    every = np.flatnonzero(mask.ravel())
    return every[np.random.default_rng(1).integers(0, len(every), SAMPLES)] if len(every) else every


def _deciles(values: F32) -> tuple[float, float]:
    """The fifth and the ninth decile of some values, as numpy interpolates them."""
    ranked = np.sort(values).astype(np.float64)
    at = np.array([0.5, 0.9]) * (len(ranked) - 1)
    low = at.astype(np.int64)
    return tuple((ranked[low] + (at - low) * (ranked[np.minimum(low + 1, len(ranked) - 1)] - ranked[low])).tolist())


def _likeness(reference: Image, secondary: Image, same: BoolArray) -> float:
    """Correlation of the local contrasts of two images on one grid, without the pixels of `same`; 1 where none is left.

    Means over squares of 8 px, less their surroundings of about 40 px, in logarithms: neither speckle nor shading. 0
    where the images agree better when one is moved by more than a square: large structures of one scene still correlate
    on their new places.
    """
    import cv2

    use = reference.mask & secondary.mask & ~_widened(same)
    size = (use.shape[1] // BLOCK, use.shape[0] // BLOCK)
    if min(size) < 4:
        return 1.0
    height, width = size[1] * BLOCK, size[0] * BLOCK

    def means(view: F32) -> F32:
        return np.asarray(cv2.resize(view[:height, :width], size, interpolation=cv2.INTER_AREA), np.float32)

    weight = means(use.astype(np.float32))
    good = weight >= 0.25
    if np.count_nonzero(good) < 0.1 * good.size:
        return 1.0
    maps: list[FloatArray] = []
    for image in (reference, secondary):
        level = means(image.amplitude * use) / np.maximum(weight, 1e-6)
        floor = 1e-2 * float(level[good].mean()) + 1e-30
        view = np.where(good, np.log(np.maximum(level, floor)), 0).astype(np.float32)
        around = cv2.GaussianBlur(view, (0, 0), 2.5) / np.maximum(
            cv2.GaussianBlur(good.astype(np.float32), (0, 0), 2.5), 1e-6
        )
        left = np.where(good, view - around, 0).astype(np.float64)
        maps.append(np.where(good, left - left[good].mean(), 0))
    if min(contrast[good].std() for contrast in maps) < 1e-6:
        # Nothing but the identical pixels is there to disagree.
        return 1.0
    likeness = float(np.corrcoef(maps[0][good], maps[1][good])[0, 1])
    return 0.0 if likeness >= ALIKE and _better_elsewhere(maps[0], maps[1]) else likeness


def _better_elsewhere(first: FloatArray, second: FloatArray) -> bool:
    """Whether two maps correlate better when one is moved by two samples or more than where they lie."""
    shape = tuple(2 * n for n in first.shape)
    product = np.fft.irfft2(np.fft.rfft2(first, shape).conj() * np.fft.rfft2(second, shape), shape)
    product = np.roll(product, (1, 1), (0, 1))
    here = product[:3, :3].max()
    product[:3, :3] = -np.inf
    return bool(product.max() > here)


def _detail(reference: Image, secondary: Image, same: BoolArray | None = None) -> float:
    """Correlation of the finest detail, each pixel less its 3 x 3 mean in logarithms, in the middle of the images.

    Without the pixels of `same`, and without those around which both images are black (their shore is one of both); 0
    where fewer than half are left or they are all alike. A quarter of the middle tells where there is none.
    """
    few = _detail_within(reference, secondary, same, CROP // 2)
    if few is not None and few < PATTERN / 2:
        return few
    return _detail_within(reference, secondary, same, CROP) or 0.0


def _detail_within(reference: Image, secondary: Image, same: BoolArray | None, side: int) -> float | None:
    """`_detail` in a square of the middle; None where fewer than half of its pixels are left, or they are all alike."""
    from featreg.pipeline import identical_kernels as kernels

    rows, columns = (slice(max(0, n // 2 - side // 2), n // 2 + side // 2) for n in reference.shape)
    use = _both_valid(reference, secondary)[rows, columns]
    use = np.ascontiguousarray(use) if same is None else use & ~same[rows, columns]
    if min(use.shape) < 2:
        return None
    one, other = (np.ascontiguousarray(np.abs(image.pixels[rows, columns])) for image in (reference, secondary))
    floors = np.array([1e-2 * float(view.mean()) + 1e-30 for view in (one, other)], np.float32)
    found = kernels.fine_detail(one, other, use, floors, 0.5)
    return None if math.isnan(found) else found


def _widened(mask: BoolArray, by: int = 1) -> BoolArray:
    """The pixels of a mask and their neighbours in squares that reach so many px."""
    import cv2

    return np.asarray(cv2.dilate(mask.view(np.uint8), np.ones((2 * by + 1,) * 2, np.uint8)), np.uint8) > 0
