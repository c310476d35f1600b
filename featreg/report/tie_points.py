"""Tie points packed for the page: fixed point and half floats, one column after the other, deflated, as base64."""

from __future__ import annotations

import base64
import math
import zlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from featreg.errors import InputError
from featreg.pictures.spread import spread_out
from featreg.report.data import ReportEntry
from featreg.results.registration import Registration
from featreg.results.stages import MEASURED
from featreg.study.evaluation import default_stage, stage_mask
from featreg.types import BoolArray, FloatArray

#: Finest step of a stored position, px; images beyond 65535 steps get a coarser one.
STEP = 1 / 64
#: Nodes along each side of the lattice on which a map that is no affine is stored.
NODES = 17
#: Bits of a match.
INLIER, SCORED, CORRECT, JUDGED, REFINED = 1, 2, 4, 8, 16


@dataclass(frozen=True, eq=False)
class TiePoints:
    """The tie points of one result as the page has them.

    `packed` holds the columns named in data.js for `shown` of `total` tie points; a position is
    ``origin + step * stored``, in the reference and in the secondary. `counts` are over all of them.
    """

    packed: str
    shown: int
    total: int
    steps: tuple[float, float]
    origins: tuple[tuple[float, float], tuple[float, float]]
    counts: dict[str, int]


def tie_points(entry: ReportEntry, errors: FloatArray | None, threshold: float, limit: int) -> TiePoints:
    """Return the tie points of a result, at most `limit` of them: scored ones first, then final ones, spread out.

    Parameters
    ----------
    entry : with its registration
    errors : (M,) px, distances from the truth, NaN where it is not known; None without a truth
    threshold : px, greatest error of a correct match
    limit : greatest number of tie points kept
    """
    registration, correct = entry.registration, entry.correct
    if registration is None:
        raise InputError(f"{entry.method} on '{entry.pair}' has no tie points: {entry.failure}")
    matches, inliers = registration.matches, registration.inliers
    scored = stage_mask(registration, entry.stage or default_stage(registration))
    distance = np.full(len(matches), np.nan) if errors is None else errors
    judged = np.isfinite(distance) if correct is None or errors is not None else np.ones(len(matches), np.bool_)
    right = np.where(judged, distance <= threshold, False) if correct is None else correct & judged
    flags = INLIER * inliers + SCORED * scored + CORRECT * right + JUDGED * judged + REFINED * ~registration.putative
    rows = _chosen(matches.reference_xy, matches.score, inliers, scored, limit)
    # From top to bottom: the steps of y are small then and deflate well, and the arrow keys walk over the image.
    rows = rows[np.argsort(matches.reference_xy[rows, 1], kind="stable")]
    shifts = _shifts(registration)
    (rx, ry), step_r, origin_r = _fixed(matches.reference_xy[rows])
    (sx, sy), step_s, origin_s = _fixed(matches.secondary_xy[rows])
    halves = [_half(shifts[rows, 0]), _half(shifts[rows, 1]), _half(distance[rows])]
    steps_y = np.diff(ry, prepend=np.uint16(0))
    columns: list[NDArray[np.generic]] = [rx, steps_y, sx, sy, *halves, _rounded(matches.score[rows])]
    columns += [_lost_at(registration)[rows], flags[rows].astype(np.uint8)]
    counts = {
        "scored": int((scored & judged).sum()) if judged.any() else int(scored.sum()),
        "correct": int((scored & right).sum()),
        "final": int(inliers.sum()),
    }
    return TiePoints(packed(columns), len(rows), len(matches), (step_r, step_s), (origin_r, origin_s), counts)


def packed(columns: list[NDArray[np.generic]]) -> str:
    """Return little-endian columns one after the other, deflated, as base64.

    The two bytes of 16-bit columns stand apart: the high ones hardly change from row to row and deflate well.
    """
    parts = []
    for column in columns:
        raw = np.ascontiguousarray(column.astype(column.dtype.newbyteorder("<")))
        parts.append(raw.view(np.uint8).reshape(len(raw), raw.dtype.itemsize).T.tobytes())
    return base64.b64encode(zlib.compress(b"".join(parts), 9)).decode()


def lattice(
    mapping: Callable[[FloatArray], FloatArray], size: tuple[int, int], affine: bool
) -> tuple[int, int, list[float | None]]:
    """Return (columns, rows, x and y of each node in turn) of a map, on nodes over an image of (width, height).

    The nodes lie from the centre of the first pixel to that of the last; between them the page interpolates
    linearly, which is exact for an affine map.
    """
    nodes = 2 if affine else NODES
    x, y = np.meshgrid(np.linspace(0, size[0] - 1, nodes), np.linspace(0, size[1] - 1, nodes))
    mapped = np.array(mapping(np.stack([x.ravel(), y.ravel()], axis=1)), np.float64)
    mapped[~np.isfinite(mapped).all(axis=1)] = np.nan
    return nodes, nodes, [round(v, 4) if math.isfinite(v) else None for v in mapped.ravel().tolist()]


def is_affine(matrix: FloatArray | None) -> bool:
    """Whether a (3, 3) matrix, where there is one, bends no lines and keeps parallels."""
    return matrix is not None and bool(np.all(matrix[2, :2] == 0))


def _chosen(xy: FloatArray, score: FloatArray, inliers: BoolArray, scored: BoolArray, limit: int) -> NDArray[np.int64]:
    if len(xy) <= limit:
        return np.arange(len(xy))
    kept: list[NDArray[np.int64]] = []
    room = limit
    for group in (scored, inliers & ~scored, ~scored & ~inliers):
        rows = np.flatnonzero(group)
        rows = rows[spread_out(xy[rows], np.nan_to_num(score[rows]), room)] if room and len(rows) else rows[:0]
        kept.append(rows)
        room -= len(rows)
    return np.sort(np.concatenate(kept))


def _shifts(registration: Registration) -> FloatArray:
    """(M, 2) secondary point minus where the model puts the reference point; NaN without a model."""
    matches = registration.matches
    if not registration.model:
        return np.full((len(matches), 2), np.nan)
    return np.asarray(matches.secondary_xy - registration.model(matches.reference_xy), np.float64)


def _lost_at(registration: Registration) -> NDArray[np.uint8]:
    """(M,) number of the first filter that dropped a tie point, counted from 1; 0 where none did."""
    lost = np.zeros(len(registration.matches), np.uint8)
    for k, (name, mask) in enumerate(registration.stages.items(), start=1):
        # These add rows; that the others are not in their mask does not mean that they were dropped.
        if name not in MEASURED:
            lost[~mask & (lost == 0) & registration.putative] = min(k, 255)
    return lost


def _fixed(xy: FloatArray) -> tuple[tuple[NDArray[np.uint16], NDArray[np.uint16]], float, tuple[float, float]]:
    if not len(xy):
        return (np.zeros(0, np.uint16), np.zeros(0, np.uint16)), STEP, (0.0, 0.0)
    origin = np.floor(xy.min(axis=0))
    step = max(STEP, float(np.ptp(xy, axis=0).max() + 1) / 65535)
    stored = np.rint((xy - origin) / step).astype(np.uint16)
    return (stored[:, 0], stored[:, 1]), step, (float(origin[0]), float(origin[1]))


def _half(values: FloatArray) -> NDArray[np.float16]:
    """float16 with 8 bits of mantissa, 0.2 %."""
    bits = np.clip(values, -65000, 65000).astype(np.float16).view(np.uint16)
    return np.where(np.isfinite(values), (bits + 2) & 0xFFFC, 0x7E00).astype(np.uint16).view(np.float16)


def _rounded(values: FloatArray) -> NDArray[np.uint32]:
    """float32 with 10 bits of mantissa, three digits: the rest would only fill the page."""
    bits = values.astype(np.float32).view(np.uint32)
    return np.asarray(np.where(np.isfinite(values), (bits + 0x1000) & 0xFFFFE000, 0x7FC00000), np.uint32)
