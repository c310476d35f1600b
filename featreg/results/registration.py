"""What a match returns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np

from featreg.errors import InputError
from featreg.interfaces import FailedFit, Model
from featreg.results.explaining import explain_registration
from featreg.results.input_image import InputImage
from featreg.results.json_file import read_registration, write_registration
from featreg.results.stages import MEASURED
from featreg.results.standard_errors import standard_errors as rigid_errors
from featreg.results.summary import one_line, summary
from featreg.results.tie_point_table import tie_point_columns
from featreg.runtime.deferred import job
from featreg.runtime.optional import import_pandas
from featreg.runtime.showing import Shown, figure_of
from featreg.types import BoolArray, FloatArray, Gate, Matches, column


@dataclass(frozen=True, eq=False)
class Registration(Shown):
    """What `featreg.match` returns.

    Parameters
    ----------
    matches : every tie point, located and refined ones appended at the end
    stages : filter name -> (M,) bool, in the order in which the filters ran, then "locate" and "refine"
    inliers : (M,) bool, the final set, on which the model was fitted
    model : the best fit, kept also when it is not trusted; a falsy `FailedFit` where none could be made
    status : "ok" or "unreliable"
    reason : why it is unreliable; empty when ok
    gates : name -> Gate, every condition with its value
    timings : stage -> seconds
    provenance : method, every parameter, versions and seed
    reference, secondary : the images; None where they are not known
    """

    matches: Matches
    stages: Mapping[str, BoolArray]
    inliers: BoolArray
    model: Model | FailedFit
    status: str
    reason: str = ""
    gates: Mapping[str, Gate] = field(default_factory=dict)
    timings: Mapping[str, float] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    reference: InputImage | None = None
    secondary: InputImage | None = None

    def __post_init__(self) -> None:
        m = len(self.matches)
        object.__setattr__(self, "inliers", column(self.inliers, m, "Registration.inliers", np.bool_))
        stages = {k: column(v, m, f"Registration.stages['{k}']", np.bool_) for k, v in self.stages.items()}
        object.__setattr__(self, "stages", stages)
        if self.status not in ("ok", "unreliable"):
            raise InputError(f"status must be 'ok' or 'unreliable', got '{self.status}'")
        if self.status == "unreliable" and not self.reason:
            raise InputError("an unreliable registration needs a reason")

    def __repr__(self) -> str:
        return one_line(self)

    def summary(self) -> str:
        """Return the verdict, the images, the counts, the model and the gates that failed, in a few lines."""
        return summary(self)

    def to_dataframe(self) -> Any:
        """Return a `pandas.DataFrame` of every tie point, with the columns of the result's table."""
        return import_pandas().DataFrame(tie_point_columns(self))

    def plot(self, reference: Any = None, secondary: Any = None, *, truth: Any = None) -> Any:
        """Return a `matplotlib.figure.Figure`: tie points on both images, checkerboard and overlay of the aligned pair.

        Parameters
        ----------
        reference, secondary : the images that were matched, whatever `featreg.as_image` takes; without them their
            files are read where they are at hand, unchanged in size and of at most 4 million pixels. Else the tie
            points stand in empty frames
        truth : as `featreg.evaluate` takes it; tie points are then correct or false instead of final or not
        """
        return figure_of(self, reference=reference, secondary=secondary, truth=truth)

    def warp(self, secondary: Any, **options: Any) -> Any:
        """Return the secondary on the reference grid; see `featreg.warp`, whose keywords it takes."""
        return job("warp")(self, secondary, **options)

    @property
    def putative(self) -> BoolArray:
        """(M,) bool, True for the tie points of the matcher, False for those that were appended to them."""
        mine = self.matches.origin < 0
        for name in MEASURED:
            if name in self.stages:
                mine = mine & ~self.stages[name]
        return mine

    def residuals(self) -> FloatArray:
        """(M,) distance in pixels of each tie point from the model; NaN where there is no model."""
        if not self.model:
            return np.full(len(self.matches), np.nan)
        return self.model.residuals(self.matches.reference_xy, self.matches.secondary_xy)

    @property
    def standard_errors(self) -> Mapping[str, Any]:
        """Of a rigid model: ``rotation_deg_se``, ``shift_se_px`` (x, y at the image centre), ``degrees_of_freedom``."""
        return rigid_errors(self)

    def explain(self) -> str:
        """Return in plain words what the verdict rests on: every gate, and for a failed one the cause and the cure."""
        return explain_registration(self)

    def to_json(self, path: str | Path) -> None:
        """Write the result as one JSON file (beyond 20 000 tie points, these stand in a Parquet file beside it)."""
        write_registration(self, Path(path))

    @classmethod
    def from_json(cls, path: str | Path, *, tie_points: bool = True) -> Self:
        """Read what `to_json` wrote, whole.

        Parameters
        ----------
        path : of the JSON file
        tie_points : False leaves out tie points that stand in a Parquet file beside it, which then need not be there:
            model, verdict and images are what they were

        Raises
        ------
        InputError
            The file is missing, cut short, of another schema version or no result of featreg.
        """
        return read_registration(Path(path), cls, tie_points=tie_points)
