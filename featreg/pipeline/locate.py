"""Locating: after the consensus, every match's position is measured again by correlating a small window of its own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Ge, Interval
from numpy.typing import NDArray

from featreg.interfaces import Model
from featreg.pipeline.aligned import (
    WholeWindows,
    affine_matrix,
    inverted,
    linear_parts,
    local_affines,
    peak_covariance,
    resampled,
)
from featreg.runtime.parameters import Positive, checked
from featreg.runtime.threads import side_by_side
from featreg.sar.bridging import on_sample
from featreg.sar.correlation import peaks_uphill
from featreg.sar.speckle import despeckled
from featreg.sar.windows import as_map, compact, few, gaussian, places, windows_of_both
from featreg.types import FloatArray, Image, IntArray, Matches

F32 = NDArray[np.float32]

#: Matches farther from the consensus than this are wrong by more than a window can tell, px.
FAR_PX = 12.0
#: Apart from each other, px, lie the shifts that are compared first; from the best it goes uphill.
COARSE = 2


@checked("locate")
@dataclass(frozen=True)
class Locate:
    """Measure where in the secondary the surroundings of each matched keypoint lie.

    Parameters
    ----------
    half_width : half the correlation window, px; it is 2 * half_width + 1 wide
    smoothing : standard deviation of the Gaussian that smooths the log-amplitude, px
    most_moved : farthest that a match may move along x and y, in px of the reference
    least_peak : least height of a correlation peak

    Notes
    -----
    A detector places a keypoint to about a pixel in each image by itself, under speckle; what both images show of its
    surroundings places it against the other image to a few tenths. The secondary's despeckled log-amplitude is
    resampled once by the consensus' model, so that windows need no resampling of their own; each match begins at its
    own position, not at the model's, and a wrong one stays wrong, or finds no peak and is left out. The search is by
    steps of two pixels first and then uphill from there.
    """

    half_width: Annotated[int, Interval(ge=6, le=40)] = 14
    smoothing: Positive = 0.7
    most_moved: Annotated[int, Ge(1)] = 3
    least_peak: Annotated[float, Interval(gt=0, lt=1)] = 0.35

    @property
    def side(self) -> int:
        """Of the windows, px."""
        return 2 * self.half_width + 1

    @property
    def reach(self) -> int:
        """How far from a match pixels are looked at, px."""
        return self.half_width + self.most_moved + 3

    def run(self, reference: Image, secondary: Image, model: Model, matches: Matches, rows: IntArray) -> Matches:
        """Return those of the matches in `rows` whose windows correlate, at their measured positions.

        `rows` (K,) are indices. `origin` names the match of each; positions in the reference stay, those in the
        secondary are new. Covariances are known up to a factor that they share, which a fit tells
        (`featreg.pipeline.aligned.variance_factor`).
        """
        reach = self.reach
        if not len(rows) or min(reference.shape) <= 2 * reach:
            return Matches.empty()
        at, offset, rows = self._starts(reference, secondary, model, matches, rows)
        if not len(rows):
            return Matches.empty()
        here, aligned, first, second = self._views(reference, secondary, model, at, offset)
        start = np.zeros_like(first)
        peak = peaks_uphill(here, aligned, first, second, start, self.half_width, self.most_moved, COARSE)
        good = peak.sound & (peak.height >= self.least_peak)
        xy = matches.reference_xy[rows]
        there = model(xy + offset + peak.shift)
        good &= on_sample(there, secondary)
        kept = peak.take(good)
        return Matches(xy[good], there[good], kept.height, peak_covariance(kept, model, xy[good]), rows[good])

    def _views(
        self, reference: Image, secondary: Image, model: Model, at: IntArray, offset: IntArray
    ) -> tuple[F32, F32, IntArray, IntArray]:
        """Both despeckled, the secondary on the reference's grid, and the (N, 2) points and their starts in these.

        Of a large image only the windows around the points are made, one below the other.
        """
        around = self.half_width + self.most_moved + 1
        side = 2 * around + 1
        if few(len(at), side, reference.shape):
            maps = local_affines(model, (at + offset).astype(np.float64))
            if compact(maps).all():
                here, aligned = windows_of_both(
                    reference, secondary, maps, at - around, at + offset - around, side, gaussian(self.smoothing)
                )
                middles = places(len(at), side, around)
                return as_map(here), as_map(aligned), middles, middles
        whole = side_by_side(
            [
                lambda: despeckled(reference, self.smoothing),
                lambda: resampled(despeckled(secondary, self.smoothing), model, reference.shape),
            ]
        )
        return whole[0], whole[1], at, at + offset

    def _starts(
        self, reference: Image, secondary: Image, model: Model, matches: Matches, rows: IntArray
    ) -> tuple[IntArray, IntArray, IntArray]:
        """Whole pixels of the reference, whole offsets on its grid from the model, rows: of what can be measured."""
        affine = affine_matrix(model)
        if affine is None:
            at, offset, rows = self._near(reference, model, matches, rows)
        else:
            at, offset, rows = self._near_affine(reference, affine, matches, rows)
        whole = WholeWindows(reference, secondary, model, self.half_width)
        good = whole.in_reference(at)
        good[good] = whole.in_secondary((at + offset)[good])
        kept = np.flatnonzero(good)
        return at.take(kept, 0), offset.take(kept, 0), rows.take(kept)

    def _near(
        self, reference: Image, model: Model, matches: Matches, rows: IntArray
    ) -> tuple[IntArray, IntArray, IntArray]:
        """As `_starts`, of those near the model and inside, whatever is valid around them."""
        xy = matches.reference_xy[rows]
        at = np.rint(xy).astype(np.int64)
        off = _offsets(model, xy, matches.secondary_xy[rows])
        near = np.isfinite(off).all(axis=1) & (np.abs(off) <= FAR_PX).all(axis=1)
        at, offset, rows = at[near], np.rint(off[near]).astype(np.int64), rows[near]
        room = np.array(reference.shape[::-1]) - self.reach
        good = ((at >= self.reach) & (at < room) & (at + offset >= self.reach) & (at + offset < room)).all(axis=1)
        return at[good], offset[good], rows[good]

    def _near_affine(
        self, reference: Image, affine: FloatArray, matches: Matches, rows: IntArray
    ) -> tuple[IntArray, IntArray, IntArray]:
        """As `_near`, of an affine map (2, 3)."""
        from featreg.pipeline.located_kernels import starts

        count, (height, width) = len(rows), reference.shape
        at, offset, kept = np.empty((count, 2), np.int64), np.empty((count, 2), np.int64), np.empty(count, np.int64)
        back = np.ascontiguousarray(inverted(affine[None, :, :2])[0])
        forth, rows = np.ascontiguousarray(affine), np.ascontiguousarray(rows, np.int64)
        if not 0 <= rows.min() <= rows.max() < len(matches):
            raise IndexError(f"rows must be of {len(matches)} matches, got {rows.min()} to {rows.max()}")
        found = starts(
            matches.reference_xy, matches.secondary_xy, rows, forth, back, FAR_PX, self.reach, width, height,
            at, offset, kept,
        )  # fmt: skip
        return at[:found], offset[:found], kept[:found]


def _offsets(model: Model, reference_xy: FloatArray, secondary_xy: FloatArray) -> FloatArray:
    """(M, 2) displacements of points of the secondary from where a model maps those of the reference, on its grid."""
    away = secondary_xy - model(reference_xy)
    return np.asarray(np.einsum("nij,nj->ni", inverted(linear_parts(model, reference_xy)), away))
