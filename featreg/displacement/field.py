"""What `featreg.offsets` returns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.displacement.cells import MEANINGS, CellGrid, Reason
from featreg.errors import InputError
from featreg.results.input_image import InputImage
from featreg.runtime.optional import import_pandas
from featreg.runtime.showing import Shown, figure_of
from featreg.types import BoolArray, FloatArray
from featreg.types.arrays import ReadOnlyArrays, kept


@dataclass(frozen=True, eq=False)
class Offsets(ReadOnlyArrays, Shown):
    """The displacement field between two images, on the cells of a grid.

    Parameters
    ----------
    grid : the cells
    dx, dy : (rows, cols) float64 px, the whole displacement reference -> secondary; NaN where there is none
    covariance : (rows, cols, 2, 2) float64 px^2 of (dx, dy)
    peak : (rows, cols) float64, height of the correlation's peak, at most 1
    snr : (rows, cols) float64, that height over the standard deviation of the correlation of unrelated windows
    reason : (rows, cols) uint8: 0 good, 1 masked, 2 no peak, 3 ambiguous, 4 outside, 5 outlier
    reference, secondary : the images
    provenance : parameters, versions, blocks
    """

    grid: CellGrid
    dx: FloatArray
    dy: FloatArray
    covariance: FloatArray
    peak: FloatArray
    snr: FloatArray
    reason: NDArray[np.uint8]
    reference: InputImage
    secondary: InputImage
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("dx", "dy", "peak", "snr", "reason"):
            values = kept(getattr(self, name))
            if values.shape != self.grid.cells:
                raise InputError(f"Offsets.{name} must be {self.grid.cells}, got {values.shape}")
            object.__setattr__(self, name, values)
        object.__setattr__(self, "covariance", kept(self.covariance))

    @property
    def x(self) -> FloatArray:
        """(cols,) float64 px, reference columns of the cells' middles."""
        return self.grid.x

    @property
    def y(self) -> FloatArray:
        """(rows,) float64 px, reference rows of the cells' middles."""
        return self.grid.y

    @property
    def good(self) -> BoolArray:
        """(rows, cols) bool, cells whose displacement can be used."""
        return np.asarray(self.reason == Reason.GOOD)

    @property
    def counts(self) -> dict[str, int]:
        """How many cells have each reason, by its name."""
        return {reason.name.lower(): int((self.reason == reason).sum()) for reason in Reason}

    @property
    def magnitude(self) -> FloatArray:
        """(rows, cols) float64 px, length of the displacement; NaN where the cell is not good."""
        return np.where(self.good, np.hypot(self.dx, self.dy), np.nan)

    def metres(self) -> FloatArray | None:
        """(rows, cols, 2) float64 metres, the displacement on the ground; None where nothing tells the pixels' size.

        Of two images on a map projection, to the east and to the north between the places that they show; of others
        (slant range, ground range), along the columns and the rows of the reference.
        """
        from featreg.displacement.ground import ground_displacement

        return ground_displacement(self)

    def to_file(self, path: str | Path, *, dates: Sequence[str] | None = None) -> None:
        """Write a tiled GeoTIFF of the cells, its bands named, with the reference's geolocation.

        Bands: dx, dy, cov_xx, cov_xy, cov_yy, peak, snr, reason, and metres where `metres` knows them; displacements
        and covariances are NaN where a cell is not good. Where the name ends in .h5, the stack of one pair that MintPy
        reads, under the `dates` of the reference and of the secondary (YYYYMMDD); without them the first in the name of
        each file counts.

        Raises
        ------
        InputError, ParameterError
            The file cannot be written; the dates of a file for MintPy are not known, or dates are given for a GeoTIFF.
        """
        from featreg.displacement.raster import write_offsets

        write_offsets(self, Path(path), dates)

    def plot(self) -> Any:
        """Return a `matplotlib.figure.Figure`: length and direction, standard error, reasons."""
        return figure_of(self)

    def summary(self) -> str:
        """Return the median displacement and how many cells there are of each reason."""
        return str(self)

    def to_dataframe(self) -> Any:
        """Return a `pandas.DataFrame` of one row per cell: x, y, dx, dy, peak, snr, reason (a word)."""
        columns, rows = np.meshgrid(self.x, self.y)
        made = {"x": columns.ravel(), "y": rows.ravel()}
        made |= {name: getattr(self, name).ravel() for name in ("dx", "dy", "peak", "snr")}
        words = np.array([reason.name.lower() for reason in Reason])
        return import_pandas().DataFrame({**made, "reason": words[self.reason.ravel()]})

    def __repr__(self) -> str:
        rows, cols = self.grid.cells
        share = 100 * float(self.good.mean()) if self.good.size else 0.0
        return f"Offsets({rows} x {cols} cells of {self.grid.step} px, {share:.0f} % measured)"

    def __str__(self) -> str:
        """One line a reason that occurs, and the median displacement."""
        rows, cols = self.grid.cells
        lines = [f"{rows} x {cols} cells of {self.grid.step} px, windows of {self.grid.window} px"]
        if self.good.any():
            error = float(np.median(np.sqrt(np.trace(self.covariance[self.good], axis1=1, axis2=2) / 2)))
            middle, largest = float(np.nanmedian(self.magnitude)), float(np.nanmax(self.magnitude))
            lines.append(
                f"  displacement  median {middle:.2f}, largest {largest:.2f}, median standard error {error:.3f} px"
            )
        for reason in Reason:
            count = int((self.reason == reason).sum())
            if count:
                lines.append(f"  {reason.name.lower().replace('_', ' '):<13} {count} cells: {MEANINGS[reason]}")
        return "\n".join(lines)
