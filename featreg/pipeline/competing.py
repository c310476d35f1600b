"""Gates on what competes with a model: a second model among the tie points, and what the images say against it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from featreg.geometry import Affine, Similarity, decompose, local_linear
from featreg.geometry.robust import fit_consensus
from featreg.interfaces import FailedFit, Model
from featreg.pipeline.agreement import Agreement, Windows
from featreg.pipeline.identical import stands_still
from featreg.pipeline.steps import Draft
from featreg.pipeline.structure import structural_drift
from featreg.pipeline.trust import Limits
from featreg.pipeline.trust_measures import distinct, log10_chance
from featreg.runtime.threads import side_by_side
from featreg.types import BoolArray, FloatArray, Gate, Image

#: Tie points within this of a model follow it, px; those of another model lie farther from it than the second.
WITHIN_PX, APART_PX = 3.0, 6.0
#: Most tie points, and most hypotheses, among which the second model is sought; a tenth that agree are found.
SAMPLE, HYPOTHESES = 1000, 400
#: Displacements of windows lie within this of a motion of their own, px, and so many of those that contradict the model
#: must follow the second motion for there to be one.
MOTION_PX, FOLLOW = 1.5, 0.7
#: Fewest windows that contradict a model.
LEAST_CONTRADICTING = 4
#: Least turn between two models that is told, degrees.
TURNED_DEG = 1.0
#: Least correlation of the whole images at which their intensities can be compared: for local displacements, and for
#: other shifts of the whole. Optical against SAR has mostly less.
COMPARABLE, DECISIVE = 0.2, 0.4
#: Value of the gate `scene` from which on the images agree nearly everywhere.
SURE = 0.5
#: Value of that gate below which the images agree in a few places only, and the share of the limit of `alias` to which
#: these are held: a single target has 0.08 and turns onto itself by 0.75; scenes have 0.15 and more.
CONFINED, FEW_PLACES = 0.15, 0.875
#: Correlation of a window that shows the same object; where the best has less, the images differ everywhere.
SAME_OBJECT = 0.9


def rival_gate(
    draft: Draft,
    shapes: tuple[tuple[int, int], tuple[int, int]],
    limits: Limits,
    seed: int,
    scene: Gate | None = None,
) -> dict[str, Gate]:
    """The support of the next best model among all tie points of the matcher, over that of the model.

    It is 0 where no second model has more support than chance gives, by the limit that the first is held to.
    """
    model, matches = draft.model, draft.matches
    if isinstance(model, FailedFit):
        return {}
    rows = np.flatnonzero(draft.putative)
    if scene is not None and scene.value is not None and scene.value >= SURE and "identical" in draft.stages:
        # The images agree elsewhere too, so what stands still with identical pixels is no rival.
        rows = rows[draft.stages["identical"][rows]]
    away = model.residuals(matches.reference_xy[rows], matches.secondary_xy[rows])
    first, left = rows[away <= WITHIN_PX], rows[away > APART_PX]
    share, words = 0.0, ""
    support = _support(draft, first)
    if len(left) > max(limits.least_inliers, 3) and support:
        rng = np.random.default_rng([seed, 2])
        some = np.sort(rng.choice(left, SAMPLE, replace=False)) if len(left) > SAMPLE else left
        second, _ = fit_consensus(
            Similarity, matches.reference_xy[some], matches.secondary_xy[some], threshold=WITHIN_PX, rng=rng,
            iterations=HYPOTHESES,
        )  # fmt: skip
        if not isinstance(second, FailedFit):
            near = second.residuals(matches.reference_xy[left], matches.secondary_xy[left]) <= WITHIN_PX
            mask = np.zeros(len(matches), np.bool_)
            mask[left[near]] = True
            chance = log10_chance(matches, draft.putative, mask, second, shapes[1])
            if chance <= limits.significance:
                share = _support(draft, left[near]) / support
                here = matches.reference_xy[left[near]]
                words = (
                    f"; {int(near.sum())} tie points {_place(here, shapes[0])} agree on another model, "
                    f"{_shift(model, second, here)} from this one, 1e{chance:.0f} by chance"
                )
    meaning = "distinct tie points of the next best model over those of the model" + words
    # A model that no refinement confirms has less room for another.
    confirmed = "refine" not in draft.stages or bool(draft.stages["refine"].any())
    return {"rival": Gate(share, None, limits.rival if confirmed else limits.rival / 2, meaning)}


def agreement_gates(
    draft: Draft,
    reference: Image,
    secondary: Image,
    limits: Limits,
    *,
    identical: BoolArray | None = None,
    refined: bool | None = None,
) -> tuple[dict[str, Gate], float]:
    """What two whole images say of a model; no gate where they are too small or cannot be compared by intensities.

    Parameters
    ----------
    draft : with the final model
    reference, secondary : the images
    limits : what must be reached
    identical : (H, W) pixels that did not vote, or None
    refined : whether a refinement was of use; None where none was asked for

    Returns
    -------
    gates, chance : log10 of the expected number of models for which as many windows speak by chance; 0 where no more do
    """
    gates: dict[str, Gate] = {}
    model = draft.model
    if isinstance(model, FailedFit):
        return gates, 0.0
    if identical is not None:
        final = draft.matches.take(np.flatnonzero(draft.inliers))
        gates["identical"] = Gate(
            float(stands_still(final).mean()) if len(final) else 0.0,
            high=limits.identical,
            meaning="share of the tie points that stand still, as pixels do that are identical in both images "
            f"({100 * identical.mean():.2g} % of them) while their surroundings disagree: frames, labels, dead pixels, "
            "a fixed pattern; those of the matcher did not vote",
        )
    moved = structural_drift(reference, secondary, model) if limits.structure_px < math.inf else None
    if moved is not None:
        gates["structure"] = Gate(
            moved[0],
            high=limits.structure_px * max(1.0, moved[1]),
            meaning="how far the directions of structure move together beyond the model, px",
        )
    # A pattern over the whole image leaves nothing to compare when it is left out.
    without = None if identical is None or identical.all() else identical
    agreement = Agreement.of(reference, secondary, model, without)
    if agreement is None:
        return gates, 0.0

    def elsewhere_if_near() -> float | None:
        return agreement.elsewhere if agreement.windows.at_model.max() >= SAME_OBJECT else None

    # Both are kept with the agreement.
    side_by_side([lambda: agreement.whole, elsewhere_if_near], 8 * agreement.here.size)
    (whole, other, shift, turned), windows, elsewhere = agreement.whole, agreement.windows, elsewhere_if_near()
    if elsewhere is not None:
        gates["scene"] = Gate(
            elsewhere,
            low=limits.scene,
            meaning="mean correlation of the images where the model maps, in the half that agrees least; agreement in "
            "a few places, as of a label, is not the scene",
        )
    if whole >= DECISIVE:
        which = "after half a turn" if turned > other else f"when moved by dx {shift[0]:+.0f}, dy {shift[1]:+.0f} px"
        gates["alias"] = Gate(
            max(other, turned) / whole,
            high=limits.alias if elsewhere is None or elsewhere >= CONFINED else FEW_PLACES * limits.alias,
            meaning=f"correlation of the aligned images {which}, the best of all others, over that of the model; what "
            "repeats or is symmetric has no one model",
        )
    if whole < COMPARABLE:
        return gates, 0.0
    drift = windows.drift if limits.drift_px < math.inf else None
    if drift is not None:
        gates["drift"] = Gate(
            drift,
            high=limits.drift_px,
            meaning=f"how far {int(windows.peaked.sum())} windows with a clear peak move together beyond the model, px",
        )
    share = windows.contradicting
    if share is not None:
        few = int(windows.contradict.sum()) < LEAST_CONTRADICTING
        gates["local"] = Gate(
            0.0 if few else share,
            high=limits.local if refined is not False else limits.local / 2,
            meaning="share of the image that contradicts the model"
            + ("" if few else f": {contradiction(windows, draft, model, reference.shape)}")
            + ("; the refinement found nothing that one model explains" if refined is False else ""),
        )
    # A pattern that the sensor leaves on all images speaks for any of them.
    pattern = identical is not None and identical.all()
    return gates, 0.0 if pattern else windows.log10_chance(2 * model.minimum)


def contradiction(windows: Windows, draft: Draft, model: Model, shape: tuple[int, int]) -> str:
    """What the windows that contradict a model have in common, in words: a second motion, or local displacements."""
    speaking = windows.agree | windows.contradict
    here = windows.xy[speaking]
    there = model(here + windows.moved[speaking])
    against = windows.contradict[speaking]
    rng = np.random.default_rng(0)
    # A shear may lie between two motions and take a share of both; a similarity does not.
    for kind in (Affine, Similarity):
        first, mine = fit_consensus(kind, here, there, threshold=MOTION_PX, rng=rng)
        if isinstance(first, FailedFit):
            continue
        rest = ~mine
        second, _ = fit_consensus(Similarity, here[rest], there[rest], threshold=MOTION_PX, rng=rng)
        if isinstance(second, FailedFit):
            continue
        theirs = rest & (second.residuals(here, there) <= MOTION_PX)
        if theirs.sum() >= max(LEAST_CONTRADICTING, FOLLOW * rest.sum()):
            points = _following(draft, first, second)
            words = f"{points} tie points and " if points else ""
            return (
                f"two motions, {words}{int(theirs.sum())} of {len(here)} windows "
                f"{_place(here[theirs], shape, windows.reach)} "
                f"move by {_shift(first, second, here[theirs])} against the others"
            )
    length = float(np.median(np.hypot(*windows.moved[windows.contradict].T)))
    return (
        f"local displacements of {length:.1f} px in the median in {int(against.sum())} of {len(here)} windows "
        f"{_place(here[against], shape, windows.reach)}, as relief makes them: try the model "
        "residual-field, rpc-bias with a DEM, or blocks"
    )


def _following(draft: Draft, first: Model, second: Model) -> int:
    """How many tie points, of the matcher or refined, follow the second motion and not the first."""
    here, there = draft.matches.reference_xy, draft.matches.secondary_xy
    return int(((second.residuals(here, there) <= MOTION_PX) & (first.residuals(here, there) > 2 * MOTION_PX)).sum())


def _support(draft: Draft, rows: np.ndarray[tuple[int], np.dtype[np.int64]]) -> int:
    """Distinct tie points among rows."""
    return distinct(draft.matches.reference_xy[rows], draft.matches.secondary_xy[rows]) if len(rows) else 0


def _shift(first: Model, second: Model, xy: FloatArray) -> str:
    """By how much a second model moves points against a first: in the median, and the turn where there is one."""
    dx, dy = (float(value) for value in np.median(second(xy) - first(xy), axis=0))
    middle = np.median(xy, axis=0)
    turn = decompose(local_linear(second, middle) @ np.linalg.inv(local_linear(first, middle))).rotation_deg
    return f"dx {dx:+.1f}, dy {dy:+.1f} px" + (f", turned by {turn:+.1f} degrees," if abs(turn) > TURNED_DEG else "")


def _place(xy: FloatArray, shape: Sequence[int], reach: float = 0.0) -> str:
    """Where in an image of (H, W) points lie: the box of all but the outermost twentieths, and the half it fills.

    The box is wider by `reach` px on all sides, and as far as the image.
    """
    x0, y0 = np.maximum(np.percentile(xy, 5, axis=0) - reach, 0)
    x1, y1 = np.minimum(np.percentile(xy, 95, axis=0) + reach, [shape[1] - 1, shape[0] - 1])
    box = f"x {math.floor(x0)} to {math.ceil(x1)}, y {math.floor(y0)} to {math.ceil(y1)}"
    halves = [
        name
        for name, inside in (
            ("left", x1 < 0.55 * shape[1]),
            ("right", x0 > 0.45 * shape[1]),
            ("upper", y1 < 0.55 * shape[0]),
            ("lower", y0 > 0.45 * shape[0]),
        )
        if inside
    ]
    return f"in the {' '.join(reversed(halves))} part ({box})" if halves else f"at {box}"
