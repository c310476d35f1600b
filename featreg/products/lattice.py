"""Where the pixels of a window of one image lie in another: a lattice of positions, linear between its nodes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from featreg.errors import InputError
from featreg.geolocation.rpc_bias import InverseRpcBias
from featreg.geolocation.transfer import Transfer
from featreg.geometry.base import DerivedModel
from featreg.geometry.corrected import CorrectedModel
from featreg.interfaces import Model
from featreg.types import FloatArray

Mapping = Callable[[FloatArray], FloatArray]

#: Distances of nodes that are tried, px.
STEPS = (32, 8)
#: Farthest, in px, that a position interpolated between nodes may lie from the model's own.
TOLERANCE = 1e-4
#: The same for models that rest on the height of the ground: closely spaced, since relief may lie between the nodes,
#: and to what an elevation model is worth.
GROUND_STEPS, GROUND_TOLERANCE = (4,), 1e-2


@dataclass(frozen=True, eq=False)
class Lattice:
    """Positions of the pixels of a window.

    Parameters
    ----------
    x, y : (R, C) float64 positions at every `step`-th pixel, in pixels of the other image; NaN where there is none
    step : distance of the nodes in pixels; between them positions are linear along both axes
    shape : (h, w) of the window
    """

    x: FloatArray
    y: FloatArray
    step: int
    shape: tuple[int, int]

    def bounds(self) -> tuple[float, float, float, float] | None:
        """Return (left, top, right, bottom) of the finite positions; None where there are none."""
        known = np.isfinite(self.x) & np.isfinite(self.y)
        if not known.any():
            return None
        x, y = self.x[known], self.y[known]
        return float(x.min()), float(y.min()), float(x.max()), float(y.max())

    def moved(self, dx: float, dy: float) -> Lattice:
        """These positions with another origin."""
        return replace(self, x=self.x + dx, y=self.y + dy)

    def positions(self) -> tuple[FloatArray, FloatArray]:
        """Return x and y (h, w) of every pixel."""
        if self.step == 1:
            return self.x, self.y
        rows, cols = (np.arange(n) for n in self.shape)
        r, c = rows // self.step, cols // self.step
        v, u = (rows % self.step / self.step)[:, None], cols % self.step / self.step

        def spread(nodes: FloatArray) -> FloatArray:
            lines = nodes[r] * (1 - v) + nodes[r + 1] * v
            return np.asarray(lines[:, c] + u * (lines[:, c + 1] - lines[:, c]))

        return spread(self.x), spread(self.y)


def lattice_of(model: Mapping, left: int, top: int, shape: tuple[int, int]) -> Lattice:
    """Return where the pixels of a window lie under a model.

    Parameters
    ----------
    model : maps (N, 2) points of the window's image to points of the other one
    left, top : first column and row of the window
    shape : (h, w) of the window

    Notes
    -----
    A `Model` is smooth, so it is evaluated at nodes only where that changes no position by more than 1e-4 px (looked
    at in the middle of each cell, where linear interpolation is farthest off); one that looks up the height of the
    ground (`RpcBias`, `Transfer`) where it changes none by more than 0.01 px, at every fourth pixel. Anything
    else, and a model that is not finite everywhere, is evaluated at every pixel.

    Raises
    ------
    InputError
        The model does not return as many points as it is given.
    """
    height, width = shape
    if isinstance(model, Model):
        steps, tolerance = (GROUND_STEPS, GROUND_TOLERANCE) if _on_ground(model) else (STEPS, TOLERANCE)
        for step in steps:
            if step * 2 > min(height, width):
                continue
            rows, cols = (np.arange((n - 1) // step + 2) * float(step) for n in shape)
            x, y = _mapped(model, rows + top, cols + left)
            if not (np.isfinite(x).all() and np.isfinite(y).all()):
                break
            middle = _mapped(model, rows[:-1] + top + step / 2, cols[:-1] + left + step / 2)
            if all(
                np.abs(_centres(nodes) - true).max() <= tolerance for nodes, true in zip((x, y), middle, strict=True)
            ):
                return Lattice(x, y, step, shape)
    return Lattice(*_mapped(model, np.arange(height) + float(top), np.arange(width) + float(left)), 1, shape)


def _on_ground(model: Model) -> bool:
    if isinstance(model, OtherGrids):
        return _on_ground(model.model)
    return isinstance(model, CorrectedModel | Transfer | InverseRpcBias)


def _centres(nodes: FloatArray) -> FloatArray:
    return np.asarray(nodes[:-1, :-1] + nodes[1:, :-1] + nodes[:-1, 1:] + nodes[1:, 1:]) / 4


def _mapped(model: Mapping, rows: NDArray[Any], cols: NDArray[Any]) -> tuple[FloatArray, FloatArray]:
    given = np.empty((len(rows), len(cols), 2))
    given[..., 0], given[..., 1] = cols, rows[:, None]
    flat = given.reshape(-1, 2)
    xy = np.asarray(model(flat), dtype=np.float64)
    if xy.shape != flat.shape:
        raise InputError(f"the model must return (N, 2) points for (N, 2) points, got {xy.shape} for {flat.shape}")
    xy = xy.reshape(given.shape)
    return np.ascontiguousarray(xy[..., 0]), np.ascontiguousarray(xy[..., 1])


@dataclass(frozen=True, eq=False)
class OtherGrids(DerivedModel):
    """A model between versions of its two images on other pixel grids.

    Parameters
    ----------
    model : between the images as they were matched
    before : (2, 3) float64 affine map, pixels of the reference's version -> pixels of the matched reference
    after : (2, 3) float64 affine map, pixels of the matched secondary -> pixels of the secondary's version
    """

    model: Model
    before: FloatArray
    after: FloatArray
    instead: ClassVar[str] = "fit the model it is made of"

    def __call__(self, xy: ArrayLike) -> FloatArray:
        return _through(self.after, self.model(_through(self.before, np.asarray(xy, np.float64))))

    @property
    def inverse(self) -> OtherGrids:
        return OtherGrids(self.model.inverse, _inverted(self.after), _inverted(self.before))

    @property
    def parameters(self) -> dict[str, Any]:
        return {"model": self.model, "before": self.before, "after": self.after}


def resized(scale: tuple[float, float]) -> FloatArray:
    """Return the (2, 3) map of points when an image gets `scale` (along x, along y) times as many pixels."""
    sx, sy = scale
    return np.array([[sx, 0.0, 0.5 * sx - 0.5], [0.0, sy, 0.5 * sy - 0.5]])


def _through(affine: FloatArray, xy: FloatArray) -> FloatArray:
    return np.asarray(xy @ affine[:, :2].T + affine[:, 2])


def _inverted(affine: FloatArray) -> FloatArray:
    linear = np.linalg.inv(affine[:, :2])
    return np.column_stack([linear, -linear @ affine[:, 2]])
