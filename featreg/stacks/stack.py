"""What `featreg.register_stack` returns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from featreg.interfaces import Model
from featreg.runtime.optional import import_pandas
from featreg.runtime.showing import Shown, figure_of
from featreg.stacks.closure import Loop
from featreg.stacks.jumps import Jump
from featreg.stacks.pairs import StackPair
from featreg.types import FloatArray

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False)
class Stack(Shown):
    """Many images on the grid of one.

    Parameters
    ----------
    names : of the images, in the order of time: paths, or "image 3"
    reference : number of the reference
    shape : (H, W) of the reference
    models : reference -> image; None where the image was left out
    status : "ok" or "left out" of each image
    reasons : why it was left out; empty where it was not
    standard_errors : (n,) px, of where a model maps points, along one axis, RMS over the image; NaN where left out
    closure : px of each image: RMS of the misclosures, over a grid, of the measured pairs round all loops through it;
        None where there is no loop
    loops : of three images, with the misclosure of each, px
    jumps : steps over time that are no drift: number of the first image after it, dx, dy in px at the image centre
    pairs : matched, with what the adjustment made of them
    provenance : parameters, versions
    """

    names: Sequence[str]
    reference: int
    shape: tuple[int, int]
    models: Sequence[Model | None]
    status: Sequence[str]
    reasons: Sequence[str]
    standard_errors: FloatArray
    closure: Sequence[float | None]
    loops: Sequence[Loop]
    jumps: Sequence[Jump]
    pairs: Sequence[StackPair]
    provenance: Mapping[str, Any] = field(default_factory=dict)
    images: Sequence[Any] = field(default=(), repr=False)

    @property
    def rejected(self) -> list[StackPair]:
        """Pairs whose match was trusted and which the others contradict."""
        return [pair for pair in self.pairs if pair.model is not None and not pair.used]

    def shift(self, image: int) -> FloatArray | None:
        """(2,) px, by how much the model of an image moves the centre of the reference; None where it was left out."""
        model = self.models[image]
        if model is None:
            return None
        centre = (np.array([self.shape[::-1]], np.float64) - 1) / 2
        return np.asarray((model(centre) - centre)[0])

    def to_dataframe(self) -> pd.DataFrame:
        """Return the table of the dates, `rows`, as a `pandas.DataFrame`."""
        frame: pd.DataFrame = import_pandas().DataFrame(self.rows())
        return frame

    def rows(self) -> list[dict[str, Any]]:
        """Return for each date its shift, rotation, scale, standard error, closure, status and reason, NaN for none."""
        from featreg.geometry import decompose, local_linear

        centre = (np.array(self.shape[::-1], np.float64) - 1) / 2
        rows = []
        for i, model in enumerate(self.models):
            shift = self.shift(i)
            part = None if model is None else decompose(local_linear(model, centre))
            rows.append(
                {
                    "image": self.names[i],
                    "dx": np.nan if shift is None else shift[0],
                    "dy": np.nan if shift is None else shift[1],
                    "rotation_deg": np.nan if part is None else part.rotation_deg,
                    "scale": np.nan if part is None else part.scale,
                    "standard_error": self.standard_errors[i],
                    "closure": np.nan if self.closure[i] is None else self.closure[i],
                    "jump": any(jump.image == i for jump in self.jumps),
                    "status": self.status[i],
                    "reason": self.reasons[i],
                }
            )
        return rows

    def explain(self) -> str:
        """Return in words which images were left out, which pairs were thrown out, and where the position jumps."""
        kept = sum(status == "ok" for status in self.status)
        lines = [f"{kept} of {len(self.names)} images lie on the grid of {self.names[self.reference]}"]
        for name, status, reason in zip(self.names, self.status, self.reasons, strict=True):
            if status != "ok":
                lines.append(f"  left out: {name}: {reason}")
        for pair in self.rejected:
            lines.append(
                f"  thrown out: the pair {self.names[pair.first]} - {self.names[pair.second]}, which misses the others "
                f"by {pair.misfit:.2f} px"
            )
        for jump in self.jumps:
            lines.append(
                f"  jump: from {self.names[jump.image]} on by ({jump.dx:+.2f}, {jump.dy:+.2f}) px, more than the drift "
                "from date to date explains"
            )
        known = [value for value in self.closure if value is not None]
        if known:
            lines.append(f"  median closure {float(np.median(known)):.3f} px over {len(self.loops)} loops")
        return "\n".join(lines)

    def warp(self, folder: str | Path | None = None, *, resampling: str = "lanczos") -> list[Any]:
        """Return all images on the grid of the reference, as arrays, or as the GeoTIFFs that are written to a folder.

        Returns
        -------
        Of each image an (H, W) float32 or complex64 array, NaN where it has no data, or the path of its file; None
        where it was left out

        Raises
        ------
        InputError, ParameterError
            The images are not at hand, the folder cannot be made or a file written; an unknown resampling.
        """
        from featreg.stacks.product import warped

        return warped(self, folder, resampling)

    def to_xarray(self, *, resampling: str = "lanczos") -> Any:
        """Return the images on the grid of the reference as one `xarray.Dataset` with the table along its dates.

        Raises
        ------
        ParameterError
            xarray is not installed.
        """
        from featreg.stacks.product import cube

        return cube(self, resampling)

    def to_file(self, path: str | Path, *, resampling: str = "lanczos") -> None:
        """Write `to_xarray` as one NetCDF file, or as a Zarr store where the name ends in .zarr.

        Raises
        ------
        InputError, ParameterError
            The file cannot be written; xarray, or h5netcdf or zarr, is not installed.
        """
        from featreg.stacks.product import write_cube

        write_cube(self, Path(path), resampling)

    def add(self, image: Any, **keywords: Any) -> Stack:
        """Return the stack with one more date at its end; only the pairs of the new image are matched.

        `keywords` say how the work is run (executor, workers, resume, progress, cancel), and of the image its `date`
        and `initial`: a model from the grid of the others' initial models, or a dict of its pairs, as
        `featreg.register_stack` has them. `coherence` is of all images with the new one; a stack does not keep what was
        given of it before, and without it the dates count.
        """
        from featreg.stacks.run import added

        return added(self, image, **keywords)

    def to_json(self, path: str | Path) -> None:
        """Write all but the images: models, table, loops, jumps and pairs."""
        from featreg.stacks.stack_file import write_stack

        write_stack(self, Path(path))

    @classmethod
    def from_json(cls, path: str | Path) -> Stack:
        """Read what `to_json` wrote.

        Raises
        ------
        InputError
            The file is missing, cut short or no stack.
        """
        from featreg.stacks.stack_file import read_stack

        return read_stack(Path(path), cls)

    def plot(self) -> Any:
        """Return a `matplotlib.figure.Figure`: shift, rotation and closure over time."""
        return figure_of(self)

    def summary(self) -> str:
        """Return what `explain` says."""
        return self.explain()

    def __repr__(self) -> str:
        kept = sum(status == "ok" for status in self.status)
        height, width = self.shape
        return f"Stack({kept} of {len(self.names)} images on {width} x {height} px, {len(self.pairs)} pairs)"

    def __str__(self) -> str:
        return self.explain()
