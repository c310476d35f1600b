"""Marked points with their history, their fit, and the file that holds them after every change."""

from __future__ import annotations

from pathlib import Path
from threading import RLock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.errors import InputError, ParameterError
from featreg.exports import csv, envi, qgis
from featreg.exports.columns import COLUMNS
from featreg.exports.content import Content, ImageInfo
from featreg.exports.formats import read_tie_points
from featreg.geometry import Affine, Similarity
from featreg.interfaces import FailedFit, Model
from featreg.io.writers import replacing
from featreg.types import FloatArray, Matches

#: Ending of the file -> how it is written.
WRITERS = {".csv": csv.write, ".points": qgis.write, ".pts": envi.write}
#: Fewest points from which an affine predicts; below, a similarity does, which needs two.
AFFINE_FROM = 4
ROLES = ("reference", "secondary")


class MarkedPoints:
    """Homologous points, changed one step at a time; every step is saved and can be undone.

    Parameters
    ----------
    path : .csv, .points (QGIS, both sides in pixels) or .pts (ENVI); points that it holds already are taken up
    images : paths of reference and secondary, for the formats that name them
    shapes : their (H, W)
    initial : a model reference -> secondary that predicts until enough points are marked

    Raises
    ------
    InputError
        The file has another ending, cannot be read, or its folder is missing.
    """

    def __init__(
        self,
        path: str | Path,
        images: tuple[str, str],
        shapes: tuple[tuple[int, int], tuple[int, int]],
        initial: Model | None = None,
    ) -> None:
        self.path, self.images, self.shapes, self.initial = Path(path), images, shapes, initial
        if self.path.suffix.lower() not in WRITERS:
            raise InputError(f"marked points are kept as {', '.join(WRITERS)}, got '{self.path.name}'")
        if not self.path.parent.is_dir():
            raise InputError(f"the folder '{self.path.parent}' for '{self.path.name}' does not exist")
        start: NDArray[Any] = np.zeros((0, 4))
        if self.path.exists():
            known = read_tie_points(self.path)
            start = np.hstack([known.reference_xy, known.secondary_xy])
        self._history: list[FloatArray] = [start]
        self._now = 0
        #: Held by whoever changes the points or reads more than one thing of them.
        self.lock = RLock()

    @property
    def points(self) -> FloatArray:
        """(N, 4) reference x, y, secondary x, y."""
        return self._history[self._now]

    @property
    def model(self) -> Model | None:
        """What predicts one side from the other; None where nothing can."""
        return _fit(self.points) or self.initial

    def add(self, reference: Any, secondary: Any) -> None:
        """Append a pair of points."""
        row = [*self._inside(reference, 0), *self._inside(secondary, 1)]
        self._step(np.vstack([self.points, row]))

    def move(self, index: int, role: str, xy: Any) -> None:
        """Put one side of a pair somewhere else."""
        if role not in ROLES:
            raise ParameterError(f"role must be 'reference' or 'secondary', got {role!r}")
        side, changed = ROLES.index(role), self.points.copy()
        changed[self._row(index), 2 * side : 2 * side + 2] = self._inside(xy, side)
        self._step(changed)

    def delete(self, index: int) -> None:
        """Take a pair away."""
        self._step(np.delete(self.points, self._row(index), axis=0))

    def undo(self) -> None:
        """Take the last step back; nothing happens where there is none."""
        self._go(max(0, self._now - 1))

    def redo(self) -> None:
        """Make the step again that was taken back last."""
        self._go(min(len(self._history) - 1, self._now + 1))

    def state(self) -> dict[str, Any]:
        """Everything the page shows, as JSON has it."""
        with self.lock:
            model, fitted = self.model, _fit(self.points)
            rows = [
                {"reference": row[:2], "secondary": row[2:], "residual": residual, "left_out": left_out}
                for row, residual, left_out in zip(
                    self.points.tolist(),
                    _told(self._residuals(fitted)),
                    _told(left_out_errors(self.points)),
                    strict=True,
                )
            ]
            return {
                "points": rows,
                "undo": self._now > 0,
                "redo": self._now < len(self._history) - 1,
                "model": None if model is None else _described(model, fitted is None),
                "path": str(self.path),
                "images": [
                    {"name": name, "width": shape[1], "height": shape[0]}
                    for name, shape in zip(self.images, self.shapes, strict=True)
                ],
            }

    def predict(self, role: str, xy: Any) -> list[float] | None:
        """Return where the other image shows a point of image `role`, or None where nothing tells."""
        model = self.model
        if role not in ROLES:
            raise ParameterError(f"role must be 'reference' or 'secondary', got {role!r}")
        if model is None:
            return None
        found = (model if role == "reference" else model.inverse)(np.array([_pair(xy)]))[0]
        return found.tolist() if np.isfinite(found).all() else None

    def save(self) -> None:
        """Write the file, whole or not at all."""
        points, model = self.points, _fit(self.points)
        matches = Matches(points[:, :2], points[:, 2:], np.nan)  # one score for all
        offset = np.full((len(points), 2), np.nan) if model is None else model(points[:, :2]) - points[:, 2:]
        columns = dict(zip(COLUMNS, points.T, strict=True)) | {"residual": self._residuals(model)}
        first, second = (ImageInfo(name, shape) for name, shape in zip(self.images, self.shapes, strict=True))
        content = Content(matches, offset, columns, model or FailedFit("too few points"), first, second)
        with replacing(self.path) as temporary:
            WRITERS[self.path.suffix.lower()](content, temporary)

    def _residuals(self, model: Model | None) -> FloatArray:
        points = self.points
        return np.full(len(points), np.nan) if model is None else model.residuals(points[:, :2], points[:, 2:])

    def _inside(self, xy: Any, side: int) -> list[float]:
        x, y = _pair(xy)
        height, width = self.shapes[side]
        if not (-0.5 <= x <= width - 0.5 and -0.5 <= y <= height - 0.5):
            raise InputError(f"({x:g}, {y:g}) lies outside the {ROLES[side]} of {width} x {height} pixels")
        return [x, y]

    def _row(self, index: Any) -> int:
        if isinstance(index, bool) or not isinstance(index, int) or not 0 <= index < len(self.points):
            raise ParameterError(f"there is no point {index!r}; {len(self.points)} are marked, counted from 0")
        return index

    def _step(self, points: FloatArray) -> None:
        with self.lock:
            before = self._history, self._now
            self._history = [*self._history[: self._now + 1], points]
            self._now += 1
            try:
                self.save()
            except InputError:
                self._history, self._now = before
                raise

    def _go(self, to: int) -> None:
        with self.lock:
            before, self._now = self._now, to
            try:
                self.save()
            except InputError:
                self._now = before
                raise


def left_out_errors(points: FloatArray) -> FloatArray:
    """Return the (N,) distances in px of each point from the fit of all others; NaN where they allow none.

    A residual shrinks with the weight its own point has in the fit; this does not.
    """
    found = np.full(len(points), np.nan)
    for k, row in enumerate(points):
        model = _fit(np.delete(points, k, axis=0))
        if model is not None:
            found[k] = model.residuals(row[None, :2], row[None, 2:])[0]
    return found


def _fit(points: FloatArray) -> Model | None:
    kind: type[Model] = Affine if len(points) >= AFFINE_FROM else Similarity
    made = kind.from_estimate(points[:, :2], points[:, 2:])
    if isinstance(made, FailedFit) and kind is Affine:
        # Points on one line determine no affine, but a similarity they do.
        made = Similarity.from_estimate(points[:, :2], points[:, 2:])
    return None if isinstance(made, FailedFit) else made


def _described(model: Model, given: bool) -> dict[str, Any]:
    return {"kind": type(model).__name__.lower(), "given": given}


def _pair(xy: Any) -> list[float]:
    if not isinstance(xy, list | tuple) or len(xy) != 2 or any(isinstance(v, bool) for v in xy):
        raise ParameterError(f"a point is two numbers [x, y], got {xy!r}")
    try:
        values = [float(v) for v in xy]
    except (TypeError, ValueError) as error:
        raise ParameterError(f"a point is two numbers [x, y], got {xy!r}") from error
    if not all(np.isfinite(values)):
        raise ParameterError(f"a point is two finite numbers [x, y], got {xy!r}")
    return values


def _told(values: FloatArray) -> list[float | None]:
    return [float(v) if np.isfinite(v) else None for v in values]
