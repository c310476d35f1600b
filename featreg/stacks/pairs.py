"""The pairs of a stack: which ones are matched, and what a match says."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from featreg.errors import ParameterError
from featreg.geometry import inverse_variances, model_from_dict, model_to_dict, prediction
from featreg.interfaces import FailedFit, Model
from featreg.results.registration import Registration
from featreg.types import FloatArray, Matches

#: Nodes along each side of the first image on which a pair is weighed, and the share of the side that they leave free.
NODES, RIM = 5, 0.1
#: A pair is never taken to be better than this, px: what the fit of a peak and the sampling leave.
FINEST_PX = 0.01
#: Images that share less of their ground make no pair.
LEAST_SHARED = 0.1
#: Of how many times as many images as are wanted the shared ground decides which they are.
LIKELY = 4


@dataclass(frozen=True, eq=False)
class StackPair:
    """Two images of a stack and what their match says.

    Parameters
    ----------
    first, second : numbers of the images, first < second
    status : "ok" or "unreliable", of the match
    reason : why it is unreliable
    model : first -> second; None where it is unreliable
    nodes : (N, 2) float64 px, points of the first image
    covariance : (N, 2, 2) float64 px^2 of where the model maps them
    weight : 0 to 1, what the adjustment left of the pair's weight; 1 before it
    misfit : px, RMS over the nodes of its distance from the adjusted models; NaN before the adjustment, and where no
        trusted pair joins its images to the reference
    """

    first: int
    second: int
    status: str
    reason: str
    model: Model | None
    nodes: FloatArray
    covariance: FloatArray
    weight: float = 1.0
    misfit: float = float("nan")

    @property
    def used(self) -> bool:
        """Whether the match is trusted and the adjustment did not throw the pair out."""
        return self.model is not None and self.weight >= THROWN_OUT

    def numbered(self, first: int, second: int) -> Self:
        """The same pair under other numbers."""
        return replace(self, first=first, second=second)

    def to_dict(self) -> dict[str, Any]:
        """Return what a file holds of it."""
        return {
            "first": self.first,
            "second": self.second,
            "status": self.status,
            "reason": self.reason,
            "model": None if self.model is None else model_to_dict(self.model),
            "nodes": self.nodes.tolist(),
            "covariance": self.covariance.tolist(),
            "weight": self.weight,
            "misfit": None if np.isnan(self.misfit) else self.misfit,
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Return the pair that `to_dict` wrote; errors of a missing key or of a wrong model pass through."""
        model, misfit = values["model"], values["misfit"]
        return cls(
            int(values["first"]), int(values["second"]), str(values["status"]), str(values["reason"]),
            None if model is None else model_from_dict(model),
            np.array(values["nodes"], np.float64).reshape(-1, 2),
            np.array(values["covariance"], np.float64).reshape(-1, 2, 2),
            float(values["weight"]), float("nan") if misfit is None else float(misfit),
        )  # fmt: skip


#: Pairs of less weight are thrown out and named.
THROWN_OUT = 0.1


def planned(
    count: int,
    reference: int,
    pairs: Any,
    shared: Callable[[int, int], float | None] | None = None,
    expected: Callable[[int, int], float] | None = None,
    order: Sequence[int] | None = None,
) -> list[tuple[int, int]]:
    """Return the pairs of a stack that are matched, each (first, second) with first < second.

    Parameters
    ----------
    count : how many images, in the order of time
    reference : number of the reference
    expected : the coherence that is expected of two images, 0 to 1: the next ones of an image are then the later ones
        of which most is expected on the ground they share, and images of which nothing is expected make no pair
    order : the numbers of the images in the order of time; None where they are given in it
    pairs : None for each image with the next two and with the reference, which makes loops of three everywhere at a
        cost that grows with the number of images; "chain" for each with the next; "all"; K for each with the next K
    shared : what share of the ground of one image another shows, None where that is not known. Images that are known
        to share less than a tenth make no pair, and the next ones are the next of those that share more; a chain is
        taken as it is

    Raises
    ------
    ParameterError
        Another value of `pairs`.
    """

    times = list(range(count)) if order is None else list(order)

    def share_of(i: int, k: int) -> float:
        share = None if shared is None else shared(i, k)
        return 1.0 if share is None else share

    def meet(i: int, k: int) -> bool:
        return share_of(i, k) >= LEAST_SHARED and (expected is None or expected(i, k) > 0)

    def following(reach: int) -> list[tuple[int, int]]:
        found: list[tuple[int, int]] = []
        for n, i in enumerate(times):
            later = times[n + 1 :]
            if expected is None:
                best = list(itertools.islice((k for k in later if meet(i, k)), reach))
            else:
                # The ground is looked at of those only that may be among the best.
                likely = sorted(later, key=lambda k: -expected(i, k))
                some = itertools.islice((k for k in likely if meet(i, k)), LIKELY * reach)
                best = sorted(some, key=lambda k: -expected(i, k) * share_of(i, k))[:reach]
            found += [(min(i, k), max(i, k)) for k in best]
        return sorted(found)

    if pairs is None:
        star = [(min(reference, i), max(reference, i)) for i in range(count) if i != reference]
        return sorted({pair for pair in star if meet(*pair)} | set(following(2)))
    if pairs == "chain":
        return sorted((min(i, k), max(i, k)) for i, k in itertools.pairwise(times))
    if pairs == "all":
        return following(count)
    if isinstance(pairs, bool) or not isinstance(pairs, int | np.integer) or pairs < 1:
        raise ParameterError(f"pairs must be 'all', 'chain' or a whole number >= 1, got {pairs!r}")
    return following(int(pairs))


def weighed(
    result: Registration, first: int, second: int, shape: tuple[int, int], again: tuple[Model, Matches] | None = None
) -> StackPair:
    """Return the pair of a registration, with the covariance of its model over the first image (H, W).

    `again` is the model by other tie points, and these, where the pair was measured again.
    """
    x, y = (np.linspace(RIM, 1 - RIM, NODES) * (n - 1) for n in shape[::-1])
    nodes = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    blank = np.zeros((0, 2, 2))
    if result.status != "ok" or isinstance(result.model, FailedFit):
        return StackPair(first, second, "unreliable", result.reason, None, nodes[:0], blank)
    model, chosen = again or (result.model, result.matches.take(np.flatnonzero(result.inliers)))
    known = prediction(model, chosen.reference_xy, chosen.secondary_xy, inverse_variances(chosen.covariance), at=nodes)
    if isinstance(known, FailedFit):
        reason = f"how well its tie points determine the model cannot be told ({known.reason})"
        return StackPair(first, second, "unreliable", reason, None, nodes[:0], blank)
    covariance = known.covariance + FINEST_PX**2 * np.eye(2)
    return StackPair(first, second, "ok", "", model, nodes, covariance)
