"""From the blocks' columns to one set of tie points, and the accuracy of the model fitted to them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from featreg.geometry import inverse_variances, prediction
from featreg.geometry.robust import irls
from featreg.interfaces import FailedFit, Model
from featreg.pipeline.refine import ROUNDS, Refined
from featreg.pipeline.steps import survivors
from featreg.pipeline.trust import Limits
from featreg.scene.blocks import Block
from featreg.scene.prior import Prior
from featreg.scene.task import BlockResult
from featreg.types import BoolArray, FloatArray, Gate, IntArray, Matches, read_only, verdict

#: Refined tie points farther than this from the first model are wrong, px.
FAR_PX = 6.0
#: Tie points of a block that can speak for it, and how near to each other, in px, the displacements of half of them lie
#: where they were not measured by correlation.
CHECK_POINTS, COHERENT_PX = 8, 2.0
#: By how many standard deviations of a Poisson count the displacements that lie together must exceed chance, how often
#: their middle is sought anew, and of how many displacements at most one is where that search begins.
SIGMAS, CENTRED, STARTS = 6.0, 3, 500
#: Fewest blocks of which every second one is left out of a fit; of fewer, every second tie point is.
LEAST_FOR_CHESS = 4


@dataclass(frozen=True, eq=False)
class Merged:
    """The tie points of all blocks, by block.

    Parameters
    ----------
    matches : putative ones
    stages : name -> (M,) bool, of the prior and the local filters
    blocks : (M,) int64 block of each
    refined : the refined ones
    refined_blocks : (R,) int64 block of each
    candidates : points that refinement looked at
    chance_shape : (H, W) of the area over which a wrong match may lie: the median of the windows searched
    located : matches that were measured again; `origin` names rows of `matches`
    located_blocks : (L,) int64 block of each
    """

    matches: Matches
    stages: Mapping[str, BoolArray]
    blocks: IntArray
    refined: Matches
    refined_blocks: IntArray
    candidates: int
    chance_shape: tuple[int, int]
    located: Matches
    located_blocks: IntArray


def merge(results: Sequence[BlockResult], names: Sequence[str]) -> Merged:
    """Put the columns of all blocks together, in the order of the blocks; `names` are those of the local stages."""
    ordered = sorted((r for r in results if r.status == "done"), key=lambda r: r.index)
    windows = np.array([r.window.shape for r in ordered if r.window is not None], np.float64).reshape(-1, 2)
    middle = np.median(windows, axis=0) if len(windows) else np.ones(2)
    stages = {
        name: np.concatenate([np.zeros(0, np.bool_), *(r.stages[name] for r in ordered)]).astype(np.bool_)
        for name in names
    }
    before = np.cumsum([0, *(len(r.matches) for r in ordered)])
    located = [replace(r.located, origin=r.located.origin + n) for r, n in zip(ordered, before[:-1], strict=True)]
    return Merged(
        concatenated([r.matches for r in ordered]),
        stages,
        _repeated(ordered, [len(r.matches) for r in ordered]),
        concatenated([r.refined for r in ordered]),
        _repeated(ordered, [len(r.refined) for r in ordered]),
        sum(r.candidates for r in ordered),
        (round(float(middle[0])), round(float(middle[1]))),
        concatenated(located),
        _repeated(ordered, [len(r.located) for r in ordered]),
    )


def concatenated(parts: Sequence[Matches]) -> Matches:
    """All matches, one part after the other; an extra that one part with points lacks is dropped."""
    parts = [part for part in parts if len(part)]
    if not parts:
        return Matches.empty()

    def joined(name: str) -> Any:
        values = [getattr(part, name) for part in parts]
        # Locked, so that it is taken as it is and not copied.
        return None if any(v is None for v in values) else read_only(np.concatenate(values))

    names = ("reference_xy", "secondary_xy", "score", "covariance", "origin", "rotation", "scale_ratio")
    return Matches(**{name: joined(name) for name in names})


def _repeated(results: Sequence[BlockResult], counts: Sequence[int]) -> IntArray:
    return np.repeat(np.array([r.index for r in results], np.int64), np.array(counts, np.int64))


def fit_refined(merged: Merged, first: Model, max_residual: float) -> tuple[Refined, IntArray]:
    """Fit the model over the refined tie points of all blocks.

    Returns
    -------
    refined : as `featreg.pipeline.refine.Refine.run` gives it for one image
    blocks : (R,) block of each of its tie points

    Notes
    -----
    Robust, weighted by the inverse variance of the correlation peaks. Blocks whose own model was wrong lie far from the
    first model, which came from the consensus of all, and are left out.
    """
    near = first.residuals(merged.refined.reference_xy, merged.refined.secondary_xy) <= FAR_PX
    rows = np.flatnonzero(near)
    some = merged.refined.take(rows)
    if len(some) < max(3 * first.minimum, 8) or some.covariance is None:
        why = FailedFit(f"only {len(some)} of {merged.candidates} windows correlate near the first model")
        return Refined(Matches.empty(), why, merged.candidates, len(merged.refined)), rows[:0]
    variance = np.trace(some.covariance, axis1=1, axis2=2)
    # No point may decide alone, however sharp its peak.
    weights = 1.0 / np.maximum(variance, 0.1 * np.median(variance))
    model, used = irls(
        type(first), some.reference_xy, some.secondary_xy, weights=weights / weights.max(), scale_px=0.05,
        iterations=ROUNDS,
    )  # fmt: skip
    if isinstance(model, FailedFit):
        return Refined(Matches.empty(), model, merged.candidates, len(merged.refined)), rows[:0]
    keep = (used > 0) & (model.residuals(some.reference_xy, some.secondary_xy) <= max_residual)
    kept = np.flatnonzero(keep)
    return (
        Refined(some.take(kept), model, merged.candidates, len(merged.refined), merged.refined),
        merged.refined_blocks[rows[kept]],
    )


def block_gates(
    blocks: Sequence[Block],
    tried: int,
    owners: IntArray,
    matches: Matches,
    model: Model,
    merged: Merged,
    prior: Prior,
    limits: Limits,
) -> dict[str, Gate]:
    """The gates that only a scene has: how many blocks contribute, and how well one half of them predicts the other.

    Parameters
    ----------
    blocks : all
    tried : how many of them had content
    owners : (M,) block of each final tie point
    matches : the (M,) final tie points
    model : fitted to them
    merged : what the blocks gave
    prior : by which they were searched
    limits : what must be reached
    """
    contributing = len(np.unique(owners))
    share = contributing / tried if tried else 0.0
    error = held_out_rmse(blocks, owners, matches, model, merged)
    kept = survivors(merged.stages, len(merged.matches))
    here, there = merged.matches.reference_xy[kept], merged.matches.secondary_xy[kept]
    off = float(np.median(np.hypot(*(prior(here) - there).T))) if len(here) else None
    limit = 0.6 * prior.uncertainty_px
    errors = block_errors(merged, model, len(blocks))
    known = errors[np.isfinite(errors)]
    local = float(np.percentile(known, 95, method="higher")) if len(known) else None
    return {
        "search": Gate(
            off, high=limit, meaning="median distance of the tie points from where the blocks were searched, px",
            unknown="" if len(here) else "no tie point passed the filters of its block",
        ),
        "blocks": Gate(
            share, low=limits.block_share,
            meaning="share of the blocks with content that hold a final tie point",
        ),
        "block_error": Gate(
            local, high=limits.block_error_px,
            meaning="median distance of a block's own tie points from the model, all but the worst 5 % of blocks, px",
            unknown="" if len(known) else f"no block has {CHECK_POINTS} tie points of its own that move alike",
        ),
        "held_out_rmse": Gate(
            error, high=limits.held_out_rmse_px,
            meaning="RMSE of the tie points of each half of the blocks from the model of the other, px",
            unknown="" if error is not None else "the tie points of every second block do not determine a model",
        ),
    }  # fmt: skip


def held_out_rmse(
    blocks: Sequence[Block], owners: IntArray, matches: Matches, model: Model, merged: Merged
) -> float | None:
    """RMSE in pixels of the tie points of each colour of a chessboard of blocks from the model of the other.

    Those that the model leaves out count too, unless they are wrong (`FAR_PX`): where the model is too stiff for the
    terrain, the final tie points alone would not tell. None where it cannot be told.
    """
    chess = np.array([(b.row + b.col) % 2 for b in blocks], np.int64)
    check_points, theirs = merged.refined, merged.refined_blocks
    if not len(check_points):
        check_points, theirs = merged.located, merged.located_blocks
    if not len(check_points):
        check_points, theirs = matches, owners
    near = model.residuals(check_points.reference_xy, check_points.secondary_xy) <= FAR_PX
    check_points, theirs = check_points.take(np.flatnonzero(near)), theirs[near]
    mine, other = chess[owners], chess[theirs]
    if len(blocks) < LEAST_FOR_CHESS:
        mine, other = np.arange(len(mine)) % 2, np.arange(len(other)) % 2
    squares: list[FloatArray] = []
    for side in (0, 1):
        fitted, left = mine == side, other != side
        half = type(model).from_estimate(matches.reference_xy[fitted], matches.secondary_xy[fitted])
        if isinstance(half, FailedFit) or not left.any():
            return None
        squares.append(half.residuals(check_points.reference_xy[left], check_points.secondary_xy[left]) ** 2)
    return float(np.sqrt(np.mean(np.concatenate(squares))))


def block_errors(merged: Merged, model: Model, count: int) -> FloatArray:
    """(count,) median distance in pixels of each block's own tie points from the model; NaN of blocks with too few.

    Those that the model's fit left out count as well, however far they lie: they were measured without that model.
    Where no block was refined, those that were located speak, if over half of them move alike. Where none was located
    either, the median displacement of those that move alike among what the local filters kept, whose own noise may be
    as large as what is asked, if they are many more than lie around them.
    """
    refined, measured = bool(len(merged.refined)), bool(len(merged.refined) or len(merged.located))
    if refined:
        points, owners = merged.refined, merged.refined_blocks
    elif len(merged.located):
        points, owners = merged.located, merged.located_blocks
    else:
        kept = survivors(merged.stages, len(merged.matches))
        points, owners = merged.matches.take(np.flatnonzero(kept)), merged.blocks[kept]
    away = points.secondary_xy - model(points.reference_xy)
    errors = np.full(count, np.nan)
    for block in np.unique(owners).tolist():
        mine = away[owners == block]
        mine = mine[np.isfinite(mine).all(axis=1)]
        if len(mine) < CHECK_POINTS:
            continue
        if not measured:
            together = _together(mine)
            errors[block] = np.nan if together is None else np.hypot(*np.median(mine[together], axis=0))
            continue
        alike = np.hypot(*(mine - np.median(mine, axis=0)).T) <= COHERENT_PX
        if refined or alike.mean() > 0.5:
            errors[block] = np.median(np.hypot(*mine.T))
    return errors


def _together(away: FloatArray) -> BoolArray | None:
    """(N,) displacements (N, 2) in px of the largest group that lies together; None where it hardly stands out.

    What lies around them, up to three times as far, tells how many would lie together by chance.
    """
    starts = away[:: -(-len(away) // STARTS)]
    centre = starts[(np.hypot(*(starts[:, None] - away[None]).transpose(2, 0, 1)) <= COHERENT_PX).sum(axis=1).argmax()]
    for _ in range(CENTRED):
        centre = np.mean(away[np.hypot(*(away - centre).T) <= COHERENT_PX], axis=0)
    distance = np.hypot(*(away - centre).T)
    best = distance <= COHERENT_PX
    chance = np.count_nonzero(~best & (distance <= 3 * COHERENT_PX)) / 8
    return best if np.count_nonzero(best) >= max(CHECK_POINTS, chance + SIGMAS * math.sqrt(chance)) else None


def accuracy(
    model: Model | FailedFit, matches: Matches, errors: FloatArray, gates: Mapping[str, Gate], shape: tuple[int, int]
) -> dict[str, Any]:
    """The accuracy report of a scene: residuals, held-out error, standard error and covariance, and the verdict.

    `matches` are the final tie points, `errors` those of `block_errors`.
    """
    if isinstance(model, FailedFit) or not len(matches):
        return {"passed": False}
    residuals = model.residuals(matches.reference_xy, matches.secondary_xy)
    centre = np.array([(shape[1] - 1) / 2, (shape[0] - 1) / 2])
    corners = np.array([[0, 0], [shape[1] - 1, 0], [0, shape[0] - 1], [shape[1] - 1, shape[0] - 1]], np.float64)
    at = np.concatenate([centre[None], corners])
    weights = inverse_variances(matches.covariance)
    known = prediction(model, matches.reference_xy, matches.secondary_xy, weights, at=at)
    report: dict[str, Any] = {
        "tie_points": len(matches),
        "rmse_px": float(np.sqrt(np.mean(residuals**2))),
        "median_px": float(np.median(residuals)),
        "percentile95_px": float(np.percentile(residuals, 95)),
    }
    if not isinstance(known, FailedFit):
        report["covariance_centre_px2"] = known.covariance[0].tolist()
        if math.isfinite(known.length):
            report["correlation_length_px"] = known.length
        report["standard_error_corners_px"] = np.sqrt(np.trace(known.covariance[1:], axis1=1, axis2=2)).tolist()
    known_blocks = errors[np.isfinite(errors)]
    if len(known_blocks):
        worst = int(np.nanargmax(errors))
        report["blocks_px"] = {
            "median": float(np.median(known_blocks)),
            "percentile95": float(np.percentile(known_blocks, 95, method="higher")),
            "worst": float(errors[worst]),
            "worst_block": worst,
            "known": len(known_blocks),
        }
    stated = ("value", "low", "high", "passed")
    report["limits"] = {name: {key: gate.to_dict()[key] for key in stated} for name, gate in gates.items()}
    report["passed"] = verdict(gates)[0] == "ok"
    return report
