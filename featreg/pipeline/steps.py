"""The steps from tie points to a registration, each a pure function: filtered, fitted, located, refined, judged.

A pair of whole images takes them in turn; a scene takes the first in every block and again over all, the others once
over all.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import takewhile

import numpy as np

from featreg.geometry import inverse_variances
from featreg.geometry.overlapping import share_taken_up
from featreg.geometry.robust import irls
from featreg.interfaces import FailedFit, Filter, FilterContext, Model
from featreg.pipeline.aligned import variance_factor
from featreg.pipeline.refine import Refined
from featreg.pipeline.trust import Evidence, Limits, assess
from featreg.results.losses import why_no_fit
from featreg.runtime.timing import stage
from featreg.types import BoolArray, FloatArray, Gate, IntArray, Matches

# Errors below this, in pixels, are not told apart by the robust fit.
SCALE_PX = 0.3
# A factor on the column at which hardly two points of an image have one sum of both coordinates.
SPREAD = 1237.61803
# Rounds of the robust fit; the consensus before it is near the answer.
ROUNDS = 3
# Located matches within this of the consensus are fitted again, and those within the second judge the fit, px.
NEAR_PX, CHECK_PX = 3.0, 6.0
# Errors of located matches below this are not told apart, px.
LOCATED_SCALE_PX = 0.1
# Least share of the consensus for which as many located matches must stand near it.
LEAST_LOCATED = 0.3


@dataclass(frozen=True, eq=False)
class Draft:
    """A registration in the making.

    Parameters
    ----------
    matches : every tie point so far
    stages : name -> (M,) bool, in the order in which they ran
    supported : (M,) rows of the matcher that every stage kept
    putative : (M,) rows of the matcher
    inliers : (M,) rows on which the model was fitted
    model : the best fit so far
    measured : what was measured by correlation at last, also what its fit left out; None where nothing was
    """

    matches: Matches
    stages: Mapping[str, BoolArray]
    supported: BoolArray
    putative: BoolArray
    inliers: BoolArray
    model: Model | FailedFit
    measured: Matches | None = None

    def without_model(self, more: str) -> Draft:
        """The same draft, whose failure to fit a model, if it failed, says `more` of what was there to begin with."""
        if not isinstance(self.model, FailedFit) or not more:
            return self
        return replace(self, model=FailedFit(f"{self.model.reason}; {more}"))


def filtered(
    matches: Matches,
    filters: Sequence[tuple[str, Filter]],
    context: FilterContext,
    before: Mapping[str, BoolArray] | None = None,
) -> dict[str, BoolArray]:
    """Return the stages of `before` and those of the filters, name -> (M,) bool.

    Every filter sees what the stage before it kept; its mask covers all matches.
    """
    stages = dict(before or {})
    kept = survivors(stages, len(matches))
    for name, keeper in filters:
        with stage(name):
            rows = np.flatnonzero(kept)
            kept = np.zeros(len(matches), np.bool_)
            kept[rows[keeper.keep(matches.take(rows), context)]] = True
        stages[name] = kept
    return stages


def survivors(stages: Mapping[str, BoolArray], count: int) -> BoolArray:
    """(M,) tie points of `count` that every stage kept."""
    kept = np.ones(count, np.bool_)
    for mask in stages.values():
        kept = kept & mask
    return kept


def fitted(
    matches: Matches,
    stages: Mapping[str, BoolArray],
    kind: type[Model],
    n_features: int,
    *,
    robust: bool = True,
    meanings: Mapping[str, str] | None = None,
) -> Draft:
    """Fit a model to what the stages kept.

    The inliers are the tie points that the fit did not leave out, at most `n_features` distinct ones, best score first.
    A `robust` fit is iteratively reweighted, from the inverse variances of the tie points where these are known.
    Where no model can be made, the failure names the stage that left too few; `meanings` says what those have in common
    that a stage keeps, where the caller knows more than `featreg.results.losses.STAGES`.
    """
    with stage("model"):
        kept = survivors(stages, len(matches))
        left = np.flatnonzero(kept)
        here, there = matches.reference_xy.take(left, axis=0), matches.secondary_xy.take(left, axis=0)
        model: Model | FailedFit
        if robust:
            known = None if matches.covariance is None else inverse_variances(matches.covariance.take(left, axis=0))
            model, weights = irls(kind, here, there, weights=known, scale_px=SCALE_PX, iterations=ROUNDS)
        else:
            model, weights = kind.from_estimate(here, there), np.ones(len(here))
        inliers = np.zeros(len(matches), np.bool_)
        if isinstance(model, FailedFit):
            counts = {name: int(mask.sum()) for name, mask in stages.items()}
            model = FailedFit(why_no_fit(len(matches), counts, kind.minimum, model.reason, meanings))
        else:
            rows = left[weights > 0]
            rows = rows[np.argsort(-matches.score[rows], kind="stable")]
            inliers[rows[_distinct_rows(matches.reference_xy.take(rows, axis=0))][:n_features]] = True
        return Draft(matches, stages, kept, np.ones(len(matches), np.bool_), inliers, model)


def before_global(stages: Mapping[str, BoolArray], global_names: Collection[str], count: int) -> BoolArray:
    """(M,) tie points of `count` that survived every stage before the first that looks at all of them at once."""
    return survivors(dict(takewhile(lambda item: item[0] not in global_names, stages.items())), count)


def located(draft: Draft, found: Matches, n_features: int, side: int = 1) -> Draft:
    """Append matches at their measured positions as the stage "locate", and fit the consensus again on them.

    Parameters
    ----------
    draft : with the consensus in whose frame was measured, or none
    found : located matches, whose `origin` names rows of the draft's; right and wrong ones
    n_features : most inliers, best first
    side : of the windows by which was measured, px

    Notes
    -----
    The fit starts from those within `NEAR_PX` of the consensus. Where these are few, as between images whose
    intensities do not compare, the model and its inliers stay what they were.
    """
    model = draft.model
    refit: Model | FailedFit = FailedFit("nothing was located")
    near, weights = np.zeros(0, np.int64), np.zeros(0)
    if not isinstance(model, FailedFit) and len(found) and found.covariance is not None:
        away = model.residuals(found.reference_xy, found.secondary_xy)
        near = np.flatnonzero(away <= NEAR_PX)
        if len(near) >= max(3 * model.minimum, 8, LEAST_LOCATED * np.count_nonzero(draft.inliers)):
            here, there = found.reference_xy.take(near, axis=0), found.secondary_xy.take(near, axis=0)
            known = inverse_variances(found.covariance.take(near, axis=0))
            refit, weights = irls(type(model), here, there, weights=known, scale_px=LOCATED_SCALE_PX, iterations=ROUNDS)
    if isinstance(refit, FailedFit):
        # Without a fit nothing tells the factor of the covariances.
        return _appended(draft, "locate", replace(found, covariance=None))
    used = near[weights > 0]
    here, there = found.reference_xy, found.secondary_xy
    covariance = found.covariance
    if covariance is not None:
        off = there.take(used, axis=0) - refit(here.take(used, axis=0))
        factor = variance_factor(off, covariance.take(used, axis=0))
        factor /= 1 - share_taken_up(refit, here.take(used, axis=0), there.take(used, axis=0), side)
        found = replace(found, covariance=covariance * factor)
    draft = _appended(draft, "locate", found)
    rows = used[np.argsort(-found.score[used], kind="stable")]
    rows = rows[_distinct_rows(here.take(rows, axis=0))][:n_features]
    inliers = np.zeros(len(draft.matches), np.bool_)
    inliers[len(inliers) - len(found) + rows] = True
    checks = found.take(refit.residuals(here, there) <= CHECK_PX)
    return replace(draft, inliers=inliers, model=refit, measured=checks)


def _appended(draft: Draft, name: str, found: Matches) -> Draft:
    """A draft with more tie points, which are in no stage but `name`; points never move in place."""
    added = np.ones(len(found), np.bool_)
    stages = {other: np.concatenate([mask, ~added]) for other, mask in draft.stages.items()}
    stages[name] = np.concatenate([np.zeros(len(draft.matches), np.bool_), added])
    supported, putative, inliers = (
        np.concatenate([mask, ~added]) for mask in (draft.supported, draft.putative, draft.inliers)
    )
    matches = draft.matches.appended(found) if len(found) else draft.matches
    return replace(draft, matches=matches, stages=stages, supported=supported, putative=putative, inliers=inliers)


def refined(draft: Draft, found: Refined | None, least: int = 0) -> Draft:
    """Append what a refinement found, and take its model; the draft's own stays where it found too little.

    Parameters
    ----------
    draft : with the model around which was refined
    found : None where there was no model to refine
    least : fewest tie points for a refinement that is worth using

    Notes
    -----
    Points never move in place: the new rows are in no stage but "refine".
    """
    if found is None or not found.model or len(found.matches) < least:
        return _appended(draft, "refine", Matches.empty())
    more = _appended(draft, "refine", found.matches)
    return replace(more, inliers=more.stages["refine"], model=found.model, measured=found.measured)


def judged(
    draft: Draft,
    shapes: tuple[tuple[int, int], tuple[int, int]],
    limits: Limits,
    *,
    initial: Model | None = None,
    search_radius: float | None = None,
    further: Mapping[str, Gate] | None = None,
    stated: FloatArray | None = None,
    chance: float = 0.0,
) -> tuple[str, str, Mapping[str, Gate]]:
    """Return status, reason and gates of a draft.

    Parameters
    ----------
    draft : with the final model
    shapes : (H, W) of the reference, and of the area of the secondary over which a wrong match may lie
    limits : what must be reached
    initial, search_radius : a model known beforehand, and how far from it in pixels the result may lie
    further : gates of the caller, which count as the others do
    stated : (2, 2) linear part that the geography of both images states, if it does
    chance : log10 of the expected number of models for which as much of the images speaks by chance
    """
    with stage("trust"):
        evidence = Evidence(
            draft.matches,
            draft.putative,
            draft.supported,
            draft.inliers,
            draft.model,
            *shapes,
            initial=initial,
            search_radius=search_radius,
            stated=stated,
            measured=draft.measured,
            chance=chance,
            refining="refine" in draft.stages,
        )
        return assess(evidence, limits, further)


def counted_from(matches: Matches, here: tuple[int, int], there: tuple[int, int]) -> Matches:
    """Tie points counted from the points (x, y) `here` of the reference and `there` of the secondary."""
    if not (any(here) or any(there)):
        return matches
    return replace(
        matches, reference_xy=matches.reference_xy - np.array(here), secondary_xy=matches.secondary_xy - np.array(there)
    )


def model_counted_back(
    model: Model | FailedFit, reference_xy: FloatArray, here: tuple[int, int], there: tuple[int, int]
) -> Model | FailedFit:
    """The model of points (M, 2) that are counted from `here` and `there`, for those counted from (0, 0).

    Moving the origins leaves the kind of a model: a fit to what the model says of its points is the model.
    """
    if isinstance(model, FailedFit) or not (any(here) or any(there)):
        return model
    return type(model).from_estimate(reference_xy + np.array(here), model(reference_xy) + np.array(there))


def _distinct_rows(xy: FloatArray) -> IntArray:
    """Rows of the first of each set of equal points, in order."""
    # Points of different sums are different points, which settles most sets without ordering them.
    sums = xy[:, 0] * SPREAD + xy[:, 1]
    ordered = np.sort(sums)
    if (ordered[1:] != ordered[:-1]).all():
        return np.arange(len(xy))
    order = np.argsort(sums, kind="stable")
    new = sums[order[1:]] != sums[order[:-1]]
    if ((xy[order[1:]] == xy[order[:-1]]).all(axis=1) | new).all():
        return np.sort(order[np.concatenate([[True], new])])
    order = np.lexsort(xy.T)
    new = np.concatenate([[True], (np.diff(xy[order], axis=0) != 0).any(axis=1)]) if len(xy) else np.zeros(0, np.bool_)
    return np.sort(order[new])
