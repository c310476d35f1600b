"""Points and arrows as small drawings of SVG, for cards whose images are not at hand."""

from __future__ import annotations

import numpy as np

from featreg.pictures.cards import SIDE
from featreg.pictures.spread import spread_out
from featreg.types import BoolArray, FloatArray

#: Most points of a drawing.
MOST = 400


def points(xy: FloatArray, score: FloatArray, shape: tuple[int, int] | None) -> str:
    """Return (N, 2) points in the frame of an image of (H, W); without one, in that of the points."""
    rows = spread_out(xy, score, MOST)
    left, top, width, height, factor = _frame(xy, shape)
    dots = "".join(
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="1.6"/>' for x, y in ((xy[rows] - (left, top)) * factor).tolist()
    )
    return _svg(width * factor, height * factor, f'<g fill="var(--good-dot)">{dots}</g>', f"{len(xy)} points")


def arrows(
    start: FloatArray, end: FloatArray, score: FloatArray, good: BoolArray, shape: tuple[int, int] | None
) -> str:
    """Return arrows (M, 2) -> (M, 2) in the frame of the reference: good ones green, the others orange below them."""
    left, top, width, height, factor = _frame(start, shape)
    drawn = []
    for mask, colour, most in ((~good, "bad", MOST // 4), (good, "good", MOST)):
        rows = np.flatnonzero(mask)
        rows = rows[spread_out(start[rows], np.nan_to_num(score[rows]), most)]
        ends = (np.hstack([start[rows], end[rows]]) - (left, top, left, top)) * factor
        lines = "".join(f"M{x:.1f} {y:.1f}L{u:.1f} {v:.1f}" for x, y, u, v in ends.tolist())
        dots = "".join(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="1.5"/>' for x, y, _, _ in ends.tolist())
        drawn.append(
            f'<path d="{lines}" stroke="var(--{colour}-dot)" opacity=".55"/><g fill="var(--{colour}-dot)">{dots}</g>'
        )
    return _svg(width * factor, height * factor, "".join(drawn), f"{len(start)} tie points")


def _frame(xy: FloatArray, shape: tuple[int, int] | None) -> tuple[float, float, float, float, float]:
    """Left, top, width and height of what is drawn, px, and how much it is enlarged."""
    if shape is not None:
        left, top, width, height = -0.5, -0.5, float(shape[1]), float(shape[0])
    elif len(xy):
        (left, top), (width, height) = xy.min(axis=0), np.maximum(np.ptp(xy, axis=0), 1.0)
    else:
        left, top, width, height = 0.0, 0.0, 1.0, 1.0
    return float(left), float(top), float(width), float(height), SIDE / max(width, height)


def _svg(width: float, height: float, inside: str, what: str) -> str:
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" height="{height:.0f}" '
        f'viewBox="0 0 {width:.1f} {height:.1f}" role="img" aria-label="{what}">'
        f'<rect width="100%" height="100%" fill="none" stroke="var(--edge)"/>{inside}</svg>'
    )
