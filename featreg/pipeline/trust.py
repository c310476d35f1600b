"""The one place that decides whether a registration can be trusted.

The limits were calibrated on pairs of unrelated SAR images (whole ones and random crops of different places): none may
come out "ok". `benchmarks/trust.py` repeats the calibration.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from featreg.errors import ParameterError
from featreg.geometry import Affine, Predicted, decompose, inverse_variances, spread
from featreg.geometry.correlated import correlated_prediction
from featreg.geometry.uncertainty import Linearised
from featreg.interfaces import FailedFit, Model
from featreg.pipeline.trust_measures import (
    apart,
    at_centre,
    dilution_over,
    distinct,
    distortion,
    held_out,
    instability,
    linear_fit,
    log10_chance,
    model_uncertainty,
    predicted,
)
from featreg.runtime.parameters import checked
from featreg.types import BoolArray, FloatArray, Gate, Matches, verdict

#: Share of the limit on what one region moves, for models with more parameters than an affine one.
BENT = 0.9
#: Most tie points by which the halves are judged.
MOST_CHECKS = 500


@checked("trust")
@dataclass(frozen=True)
class Limits:
    """What a trusted registration must reach.

    Parameters
    ----------
    least_inliers : distinct tie points
    least_spread : share of the cells of an 8 x 8 grid over the reference that hold an inlier
    significance : log10 of the expected number of equally good models among chance matches, or among windows of the
        images themselves, at most
    held_out_px : median residual of the tie points of each half of the regions from the model of the other, at most;
        before the last fit chose among them
    scale : the model's scale lies between 1 / scale and scale
    uncertainty_px : root mean square over the image of the model's own standard error, at most
    stability_px : root mean square over the image of the model's jackknife error, regions of tie points left out, at
        most
    stability_by_spread_px : the same over the share of the image's cells that hold a tie point, at most; nine tenths of
        it for models that bend, which swing more beyond their tie points; not where no refinement was asked for, whose
        tie points fill what the images share
    anisotropy : largest ratio of the model's two scales
    distortion_px : root mean square over the image of what a stretch, shear or zoom of the tie points adds to a
        translation, rigid or similarity model, at most; inf for no such gate
    dilution : error of the model over the image for an error of one pixel per place of tie points, at most; inf for no
        such gate
    block_share : of a scene's blocks with content, the share that must hold a final tie point
    held_out_rmse_px : of a scene, RMSE of each half of its blocks from the model of the other, at most
    block_error_px : of a scene, median distance of a block's own tie points from the model, at most, in all blocks but
        the worst twentieth
    rival : distinct tie points of the next best model over those of the model, at most; half of it where a refinement
        found nothing
    drift_px : root mean square over the windows of the images of the affine field in which they move beyond the model,
        at most; inf for no such gate
    structure_px : root mean square over the windows of the images by which their structure moves together beyond the
        model, at most; as many samples where the images are compared by samples larger than a pixel; inf for no such
        gate
    local : share of the image that moves otherwise than the model, at most; half of it where a refinement found nothing
    alias : correlation of the aligned images at the best other shift, or after half a turn, over that at the model, at
        most
    scene : mean correlation of the aligned images in the half that agrees least, at least
    identical : share of tie points that stand still where pixels do that are identical in both images, at most
    """

    least_inliers: int = 12
    least_spread: float = 0.05
    significance: float = -8.0
    held_out_px: float = 2.0
    scale: float = 2.5
    anisotropy: float = 1.5
    uncertainty_px: float = 2.5
    block_share: float = 0.1
    held_out_rmse_px: float = 2.0
    block_error_px: float = 2.0
    stability_px: float = 1.5
    # Of 1104 trials on warped pairs of every difficulty (benchmarks/trust.py, seeds 31, 32, 1855, 2861) that all other
    # gates trust, 18 of the 19 that were 3 to 8 px off lie above it, and 22 of the 911 within 1 px.
    stability_by_spread_px: float = 2.5
    distortion_px: float = math.inf
    dilution: float = math.inf
    # Of pairs of one place, also years apart: at most 0.3, 0.06, 0.75, and at least 0.15. Of two motions, relief,
    # repeated patterns and labels on other places: from 0.47, 0.1 and 0.86 on, and at most 0.05.
    rival: float = 0.4
    local: float = 0.1
    # Of these pairs within 1 px all had at most 2.9; a model 10 px off had 6.3.
    drift_px: float = 3.5
    structure_px: float = math.inf
    alias: float = 0.8
    scene: float = 0.06
    identical: float = 0.5

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            lowest = name in ("least_inliers", "least_spread", "block_share", "scene")
            if math.isnan(value) or value == (math.inf if lowest else -math.inf) or (name == "scale" and value < 1):
                raise ParameterError(f"trust.{name} must be a limit that can be met, got {value}")


@dataclass(frozen=True, eq=False)
class Evidence:
    """What a registration is judged by.

    Parameters
    ----------
    matches : all tie points
    putative : (M,) rows that came from the matcher
    supported : (M,) rows that survived all filters before refinement
    inliers : (M,) the final set
    model : the final model
    reference_shape, secondary_shape : (H, W); of the secondary, the area over which a wrong match may lie
    initial, search_radius : a model known beforehand, if any, and how far from it in pixels the result may lie
    stated : (2, 2) linear part that the geography of both images states, if it states one; what is left is judged
    measured : what a refinement measured, also what its fit left out; None without one
    chance : log10 of the expected number of models for which as much of the images themselves speaks by chance
    refining : whether a refinement was asked for, whose tie points fill what the images share
    """

    matches: Matches
    putative: BoolArray
    supported: BoolArray
    inliers: BoolArray
    model: Model | FailedFit
    reference_shape: tuple[int, int]
    secondary_shape: tuple[int, int]
    initial: Model | None = None
    search_radius: float | None = None
    stated: FloatArray | None = None
    measured: Matches | None = None
    chance: float = 0.0
    refining: bool = True

    @cached_property
    def left(self) -> FloatArray:
        """(2, 2) linear part of the model at the reference's centre, beside what geography states; NaN without one."""
        if isinstance(self.model, FailedFit):
            return np.full((2, 2), np.nan)
        linear = at_centre(self.model, self.reference_shape)
        return linear if self.stated is None else np.linalg.inv(self.stated) @ linear

    @cached_property
    def here(self) -> FloatArray:
        """(K, 2) final tie points in the reference."""
        return self.matches.reference_xy[self.inliers]

    @cached_property
    def there(self) -> FloatArray:
        """(K, 2) final tie points in the secondary."""
        return self.matches.secondary_xy[self.inliers]

    @cached_property
    def spread(self) -> float:
        """Share of the cells of an 8 x 8 grid over the reference that hold a final tie point."""
        return spread(self.here, self.reference_shape)

    def most_moved(self, limits: Limits) -> float:
        """How far one region may move the model, px: less where less of the image holds refined tie points."""
        if isinstance(self.model, FailedFit) or not self.refining:
            return limits.stability_px
        bent = BENT if self.model.minimum > Affine.minimum else 1.0
        return min(limits.stability_px, limits.stability_by_spread_px * self.spread * bent)

    @cached_property
    def checks(self) -> Matches:
        """Tie points as they were before the last fit chose among them, at most 500, evenly taken."""
        before = self.matches.take(np.flatnonzero(self.supported)) if self.measured is None else self.measured
        return before.take(np.arange(0, len(before), max(1, -(-len(before) // MOST_CHECKS))))

    @cached_property
    def found(self) -> tuple[FloatArray, FloatArray]:
        """(K, 2), (K, 2) tie points of the matcher, in the reference and in the secondary."""
        return self.matches.reference_xy[self.putative], self.matches.secondary_xy[self.putative]

    @cached_property
    def weights(self) -> FloatArray | None:
        """(K,) inverse variances of the final tie points; None where none is known."""
        covariance = self.matches.covariance
        return None if covariance is None else inverse_variances(covariance[self.inliers])

    @cached_property
    def linear(self) -> Linearised | FailedFit | None:
        """The final fit, made linear around its model; None for a model without known derivatives."""
        if isinstance(self.model, FailedFit):
            return self.model
        return linear_fit(self.model, self.here, self.there, self.reference_shape, self.weights)

    @cached_property
    def predicted(self) -> Predicted | FailedFit:
        """What is known of where the model maps a grid over the reference."""
        if isinstance(self.model, FailedFit):
            return self.model
        if self.linear is None:
            return predicted(self.model, self.here, self.there, self.reference_shape, self.weights)
        return self.linear if isinstance(self.linear, FailedFit) else correlated_prediction(self.linear)

    @property
    def correlation_px(self) -> float:
        """Length in px over which the errors of tie points are alike; 0 where it is not known."""
        known = self.predicted
        return 0.0 if isinstance(known, FailedFit) or math.isnan(known.length) else known.length


class Condition(NamedTuple):
    """One gate of every registration.

    Parameters
    ----------
    name, meaning : of the gate
    value : of the evidence and its model; None where there is no such gate for them
    limits : (lowest, highest) value that passes
    optional : whether there is no such gate where the highest value is infinite
    """

    name: str
    meaning: str
    value: Callable[[Evidence, Model], float | None]
    limits: Callable[[Limits, Evidence], tuple[float | None, float | None]]
    optional: bool = False


CONDITIONS = (
    Condition(
        "inliers",
        "distinct tie points",
        lambda e, model: distinct(e.here, e.there),
        lambda limits, e: (limits.least_inliers, None),
    ),
    Condition(
        "spread",
        "share of the image's cells with a tie point",
        lambda e, model: e.spread,
        lambda limits, e: (limits.least_spread, None),
    ),
    Condition(
        "significance",
        "log10 of the expected number of models as good by chance",
        lambda e, model: min(e.chance, log10_chance(e.matches, e.putative, e.supported, model, e.secondary_shape)),
        lambda limits, e: (None, limits.significance),
    ),
    Condition(
        "held_out",
        "median residual of the tie points of each half of the regions from the model of the other, px",
        lambda e, model: held_out(type(model), e.checks.reference_xy, e.checks.secondary_xy),
        lambda limits, e: (None, limits.held_out_px),
    ),
    Condition(
        "uncertainty",
        "standard error of the model over the image, px",
        lambda e, model: model_uncertainty(e.predicted, model, *e.found, e.reference_shape),
        lambda limits, e: (None, limits.uncertainty_px),
    ),
    Condition(
        "stability",
        "error of the model over the image by leaving out regions of tie points, px",
        lambda e, model: instability(e.linear, e.correlation_px),
        lambda limits, e: (None, e.most_moved(limits)),
    ),
    Condition(
        "distortion",
        "stretch or shear between the images that the model cannot hold, px over the image",
        lambda e, model: distortion(model, e.matches.reference_xy, e.matches.secondary_xy, e.reference_shape),
        lambda limits, e: (None, limits.distortion_px),
        optional=True,
    ),
    Condition(
        "dilution",
        "error of the model over the image for one pixel of error per place with tie points",
        lambda e, model: dilution_over(model, e.here, e.there, e.reference_shape),
        lambda limits, e: (None, limits.dilution),
        optional=True,
    ),
    Condition(
        "determinant",
        "of the model's linear part; the images are mirrored where negative",
        lambda e, model: float(np.linalg.det(e.left)),
        lambda limits, e: (0.0, None),
    ),
    Condition(
        "scale",
        "scale at the centre",
        lambda e, model: math.sqrt(abs(float(np.linalg.det(e.left)))),
        lambda limits, e: (1 / limits.scale, limits.scale),
    ),
    Condition(
        "anisotropy",
        "ratio of the two scales at the centre",
        lambda e, model: decompose(e.left).anisotropy,
        lambda limits, e: (None, limits.anisotropy),
    ),
    Condition(
        "prior",
        "mean distance from the initial model, px",
        lambda e, model: None if e.initial is None else apart(model, e.initial, e.here),
        lambda limits, e: (None, e.search_radius),
    ),
)


def assess(
    evidence: Evidence, limits: Limits, further: Mapping[str, Gate] | None = None
) -> tuple[str, str, dict[str, Gate]]:
    """Judge a registration.

    Parameters
    ----------
    evidence : what was found
    limits : what must be reached
    further : gates of the caller, which count as those of `CONDITIONS` do

    Returns
    -------
    status, reason, gates : "ok" or "unreliable", why, and every gate with its value
    """
    model = evidence.model
    if isinstance(model, FailedFit):
        return "unreliable", f"no model could be fitted: {model.reason}", {}
    gates: dict[str, Gate] = {}
    for condition in CONDITIONS:
        low, high = condition.limits(limits, evidence)
        if condition.optional and high == math.inf:
            continue
        value = condition.value(evidence, model)
        if value is not None:
            gates[condition.name] = Gate(value, low, high, condition.meaning)
    gates.update(further or {})
    told = {
        name: replace(gate, unknown=why_unknown(evidence, model)) if gate.value is None and not gate.unknown else gate
        for name, gate in gates.items()
    }
    return *verdict(told), told


def why_unknown(evidence: Evidence, model: Model) -> str:
    """Return why a measure of the final tie points has no value."""
    count = int(evidence.inliers.sum())
    if not count:
        return "there is no final tie point"
    if count < 2 * model.minimum:
        return f"only {count} final tie points, a model of this kind needs {model.minimum} of each half of them"
    return f"parts of the {count} final tie points, by themselves in one place or on a line, do not determine a model"
