"""Which targets of two images belong together: the nearest, those that a vote finds, those that the spectra align."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from featreg.sar.speckle import mean_amplitude
from featreg.types import FloatArray, Image, IntArray

F32 = NDArray[np.float32]


class Map(Protocol):
    """Maps (N, 2) points of the reference to the secondary."""

    def __call__(self, xy: FloatArray, /) -> FloatArray: ...


#: Fits a map to (M, 2) and (M, 2) points; None where there is none.
Fit = Callable[[FloatArray, FloatArray], Map | None]


#: Targets that vote, the largest first: the votes grow with the fourth power of their number.
VOTERS = 100
#: Shortest distance of two targets that votes, and how much it may differ between the images, px.
SHORTEST, TOLERANCE = 40.0, 1.5
ANGLES = 720
#: Turns, shifts of each, and maps of all of these that are looked at.
PEAKS, SHIFTS, VERIFIED = 8, 3, 8
CELL = 4.0
#: Share of the winner's pairs that makes another map its rival.
RIVAL = 0.9
#: Distances in px within which a verification pairs targets, round by round.
RADII = (8.0, 5.0, 4.0, 4.0)


@dataclass(frozen=True, eq=False)
class Association:
    """Pairs of targets, and the map that explains them.

    Parameters
    ----------
    pairs : (K, 2) int64 rows of the reference and of the secondary targets
    map : reference -> secondary, or None where the association knows none
    log10_chance : log10 of the expected number of maps that pair as many targets of a random scene; 0 where unknown
    ambiguous : whether another map pairs nearly as many, so that there are no pairs
    """

    pairs: IntArray
    map: Map | None = None
    log10_chance: float = 0.0
    ambiguous: bool = False

    @classmethod
    def none(cls, ambiguous: bool = False) -> Association:
        return cls(np.zeros((0, 2), np.int64), ambiguous=ambiguous)


def nearest(mapped_xy: FloatArray, secondary_xy: FloatArray, radius: float = math.inf) -> IntArray:
    """Return the (K, 2) rows of points that are each other's nearest, and at most `radius` pixels apart."""
    if not len(mapped_xy) or not len(secondary_xy):
        return np.zeros((0, 2), np.int64)
    from scipy.spatial import KDTree

    distance, partner = KDTree(secondary_xy).query(mapped_xy)
    there, here = np.asarray(partner), np.asarray(KDTree(mapped_xy).query(secondary_xy)[1])
    rows = np.arange(len(mapped_xy))
    mutual = (here[there] == rows) & (distance <= radius)
    return np.column_stack([rows[mutual], there[mutual]]).astype(np.int64)


def vote(
    reference_xy: FloatArray, secondary_xy: FloatArray, fit: Fit, shape: tuple[int, int]
) -> Association:  # fmt: skip
    """Return the targets that one rotation and shift bring together, whatever the rotation and the shift.

    Parameters
    ----------
    reference_xy, secondary_xy : (N, 2), (M, 2) float64 targets, the largest first
    fit : of the model; it should be able to turn
    shape : (H, W) of the secondary image

    Notes
    -----
    Two targets keep their distance under rotation and shift. Every two reference targets and every two secondary ones
    that are equally far apart vote for the turn between their directions; for each of the most voted turns, the targets
    themselves vote for the shift; each of the resulting maps pairs targets one to one, is fitted to its pairs, pairs
    again within a smaller radius, and the one that pairs most wins. Where another pairs nearly as many, the targets do
    not tell which is true (those of a regular row, for example), and none wins.
    """
    here, there = reference_xy[:VOTERS], secondary_xy[:VOTERS]
    ways = [(*way, turn) for turn in _turns(here, there) for way in _shifts(_turned(here, turn), there)]
    found = [
        verified(reference_xy, secondary_xy, _rigid(turn, shift), fit, shape)
        for _, shift, turn in sorted(ways, key=lambda way: -way[0])[:VERIFIED]
    ]
    best = max(found, key=lambda one: len(one.pairs), default=Association.none())
    rivals = [one for one in found if len(one.pairs) > RIVAL * len(best.pairs) and _differ(one, best, here)]
    return Association.none(ambiguous=best.log10_chance < 0) if rivals else best


def _differ(first: Association, second: Association, xy: FloatArray) -> bool:
    """Whether two associations are different explanations of the targets."""
    if first.map is None or second.map is None:
        return False
    return float(np.hypot(*(first.map(xy) - second.map(xy)).T).max()) > 2 * RADII[0]


def verified(
    reference_xy: FloatArray, secondary_xy: FloatArray, start: Map, fit: Fit, shape: tuple[int, int]
) -> Association:
    """Return the targets that a map near `start` brings together one to one, none where that is fewer than three."""
    current, pairs = start, np.zeros((0, 2), np.int64)
    for radius in RADII:
        pairs = nearest(current(reference_xy), secondary_xy, radius)
        again = fit(reference_xy[pairs[:, 0]], secondary_xy[pairs[:, 1]]) if len(pairs) >= 3 else None
        if again is None:
            return Association.none()
        current = again
    pairs = nearest(current(reference_xy), secondary_xy, RADII[-1])
    if len(pairs) < 3:
        return Association.none()
    mapped = current(reference_xy)
    inside = int(((mapped >= 0) & (mapped <= np.array(shape[::-1]) - 1)).all(axis=1).sum())
    return Association(pairs, current, _log10_chance(len(pairs), inside, len(secondary_xy), shape))


def _log10_chance(paired: int, inside: int, targets: int, shape: tuple[int, int]) -> float:
    """Expected number, as log10, of turns and shifts that pair so many of `inside` targets of a random scene."""
    area = shape[0] * shape[1]
    p = min(1 - 1e-12, targets * math.pi * RADII[-1] ** 2 / area)
    k = np.arange(paired, max(inside, paired) + 1)
    logs = np.array([math.lgamma(len(k) + paired) - math.lgamma(i + 1) - math.lgamma(k[-1] - i + 1) for i in k])
    logs += k * math.log(p) + (k[-1] - k) * math.log1p(-p)
    tail = float(logs.max() + np.log(np.exp(logs - logs.max()).sum()))
    tried = ANGLES * max(area / CELL**2, 1.0)
    return math.log10(tried) + tail / math.log(10)


def _turns(here: FloatArray, there: FloatArray) -> list[complex]:
    """The most voted turns as unit numbers, best first; none where nothing votes."""
    a, b = (xy @ np.array([1, 1j]) for xy in (here, there))
    i, j = np.triu_indices(len(a), 1)
    first = a[j] - a[i]
    i, j = np.triu_indices(len(b), 1)
    second = b[j] - b[i]
    second = np.concatenate([second, -second])
    first, second = (s[np.abs(s) >= SHORTEST] for s in (first, second))
    second = second[np.argsort(np.abs(second), kind="stable")]
    length = np.abs(second)
    low = np.searchsorted(length, np.abs(first) - TOLERANCE)
    count = np.searchsorted(length, np.abs(first) + TOLERANCE) - low
    if not count.sum():
        return []
    mine = np.repeat(np.arange(len(first)), count)
    theirs = np.arange(len(mine)) - np.repeat(np.cumsum(count) - count, count) + np.repeat(low, count)
    direction = np.angle(second)[theirs] - np.angle(first)[mine]
    bins = np.rint(direction * (ANGLES / (2 * np.pi))).astype(np.int64) % ANGLES
    votes = np.bincount(bins, minlength=ANGLES).astype(np.float64)
    smooth = np.roll(votes, 1) + 2 * votes + np.roll(votes, -1)
    found = []
    for _ in range(PEAKS):
        peak = int(smooth.argmax())
        if smooth[peak] <= 0:
            break
        around = (peak + np.arange(-2, 3)) % ANGLES
        weight = np.maximum(votes[around] - np.median(votes), 0)
        offset = float(weight @ np.arange(-2, 3) / weight.sum()) if weight.sum() else 0.0
        found.append(complex(np.exp(2j * np.pi * (peak + offset) / ANGLES)))
        smooth[around] = 0
    return found


def _shifts(rotated: FloatArray, there: FloatArray) -> list[tuple[int, FloatArray]]:
    """The most voted shifts (2,) and their votes: differences counted in cells that overlap by half."""
    differences = (there[None, :, :] - rotated[:, None, :]).reshape(-1, 2)
    if not len(differences):
        return []
    origin = differences.min(axis=0)
    cell = np.floor((differences - origin) / (CELL / 2)).astype(np.int64) + 1
    size = cell.max(axis=0) + 2
    votes = np.bincount(cell[:, 1] * size[0] + cell[:, 0], minlength=size[0] * size[1]).astype(np.int32)
    rows = votes.reshape(size[1], size[0])
    rows = rows[:-1] + rows[1:]
    joined = rows[:, :-1] + rows[:, 1:]
    found: list[tuple[int, FloatArray]] = []
    for _ in range(SHIFTS):
        y, x = np.unravel_index(int(joined.argmax()), joined.shape)
        if joined[y, x] < 2:
            break
        found.append((int(joined[y, x]), origin + np.array([x, y]) * (CELL / 2)))
        joined[max(y - 2, 0) : y + 3, max(x - 2, 0) : x + 3] = 0
    return found


def _turned(xy: FloatArray, turn: complex) -> FloatArray:
    z = turn * (xy @ np.array([1, 1j]))
    return np.column_stack([z.real, z.imag])


def _rigid(turn: complex, shift: FloatArray) -> Map:
    return lambda xy: _turned(xy, turn) + shift


def fourier_mellin(reference: F32, secondary: F32) -> list[Map]:
    """Return the two rotations with shift that align the images' spectra, the likelier first; none of flat images.

    Parameters
    ----------
    reference, secondary : (H, W) float32 real views, `outstanding` for example

    Notes
    -----
    The modulus of the spectrum does not move with the image and turns with it: its polar image is correlated along the
    angle. The two turns half a turn apart that it leaves are told apart by the correlation of the images themselves,
    at half their size, so that the shift is good to two pixels. The shift may be up to the whole image.

    References
    ----------
    B. S. Reddy, B. N. Chatterji, "An FFT-based technique for translation, rotation, and scale-invariant image
    registration", IEEE Trans. Image Process. 5(8), 1266-1271, 1996, DOI 10.1109/83.506761
    """
    from scipy import fft

    side = fft.next_fast_len(max(*reference.shape, *secondary.shape))
    polar = [_polar_spectrum(view, side) for view in (reference, secondary)]
    products = fft.rfft(polar[1], axis=0) * fft.rfft(polar[0], axis=0).conj()
    score = fft.irfft(products.sum(axis=1), len(polar[0]))
    peak = int(score.argmax())
    before, middle, after = (float(score[(peak + k) % len(score)]) for k in (-1, 0, 1))
    if not 2 * middle > before + after:
        return []
    offset = 0.5 * (before - after) / (before - 2 * middle + after)
    turn = complex(np.exp(1j * np.pi * (peak + offset) / len(score)))
    found = [(*_shift_at(reference, secondary, way), way) for way in (turn, -turn)]
    return [_rigid(way, shift) for _, shift, way in sorted(found, key=lambda one: -one[0])]


def outstanding(image: Image) -> F32:
    """Return the (H, W) float32 log-amplitude of what is brighter than the mean, 0 elsewhere and where nothing is."""
    return image.derive(_outstanding)


def _outstanding(image: Image) -> F32:
    import cv2

    smooth = cv2.GaussianBlur(image.amplitude, (5, 5), 1.0)
    mean = max(mean_amplitude(image), 1e-30)
    return np.asarray(cv2.log(np.maximum(smooth * np.float32(1 / mean), np.float32(1))), np.float32)


def _polar_spectrum(view: F32, side: int) -> F32:
    """(720, R) modulus of the spectrum over half a turn, every radius with mean 0 and length 1."""
    import cv2
    from scipy import fft

    height, width = view.shape
    window = (np.hanning(height + 2)[1:-1, None] * np.hanning(width + 2)[None, 1:-1]).astype(np.float32)
    spectrum = fft.fft2((view - view.mean()) * window, (side, side))
    modulus = np.abs(fft.fftshift(spectrum)).astype(np.float32)
    radii = side // 2
    flags = cv2.WARP_POLAR_LINEAR | cv2.INTER_LINEAR
    whole = np.asarray(cv2.warpPolar(modulus, (radii, 2 * ANGLES), (side // 2, side // 2), radii, flags))
    # Below, the window's own spectrum; above, mostly speckle.
    ring = whole[:ANGLES, radii // 25 : radii * 2 // 5]
    ring = ring - ring.mean(axis=0)
    return np.asarray(ring / np.maximum(np.linalg.norm(ring, axis=0), 1e-30), np.float32)


def _shift_at(reference: F32, secondary: F32, turn: complex) -> tuple[float, FloatArray]:
    """Height of the correlation of the secondary with the turned reference, and the shift of its peak."""
    import cv2
    from scipy import fft

    height, width = secondary.shape[0] // 2, secondary.shape[1] // 2
    x, y = (n / 2 - 0.5 for n in reference.shape[::-1])
    z = turn * complex(x, y)
    # About its centre, onto the secondary's; the half-sized grid has its first pixel at 0.5 of the whole one.
    move = np.array([(secondary.shape[1] - 1) / 2 - z.real, (secondary.shape[0] - 1) / 2 - z.imag])
    back = np.array([[turn.real, turn.imag], [-turn.imag, turn.real]])
    offset = back @ (0.5 - move)
    grid = np.column_stack([2 * back, offset])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    turned = np.asarray(cv2.warpAffine(reference - np.float32(reference.mean()), grid, (width, height), flags=flags))
    centred = cv2.resize(secondary[: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA)
    centred = np.asarray(centred) - np.float32(secondary.mean())
    size = [fft.next_fast_len(2 * n) for n in (height, width)]
    correlation = fft.irfft2(fft.rfft2(centred, size) * fft.rfft2(turned, size).conj(), size)
    row, column = np.unravel_index(int(correlation.argmax()), correlation.shape)
    dy = int(row) - size[0] if row > size[0] // 2 else int(row)
    dx = int(column) - size[1] if column > size[1] // 2 else int(column)
    return float(correlation[row, column]), move + 2.0 * np.array([dx, dy])
