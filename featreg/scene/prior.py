"""Where a block's window lies in the secondary before anything is matched: sensors, a known model, or overviews."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from featreg.errors import FeatregError
from featreg.geolocation import Transfer
from featreg.geometry import Affine, Translation
from featreg.geometry.robust import fit_consensus
from featreg.interfaces import FailedFit, Model
from featreg.types import FloatArray

#: Pilot blocks are searched this much wider than the prior says it may be off, and by at least so many pixels: nothing
#: else would show that it is off by more.
WIDER = 1.5
WIDER_PX = 24.0
#: Least uncertainty of a prior that was corrected by pilot blocks, px, and tie points it takes.
LEAST_PX = 6.0
LEAST_PILOTS = 40
#: Relief that the heights do not know may bend a prior by so much around its correction, px.
BENT_PX = 8.0

logger = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Prior:
    """A rough map reference -> secondary.

    Parameters
    ----------
    base : the map, of sensors or a model; NaN where it does not reach
    correction : what pilot blocks found it to be off by, in the secondary's pixels, or None
    searched_px : how far pilot blocks were searched around it without agreeing; 0 where they agreed, or none was
    uncertainty_px : how far it may be off along either axis, px
    source : where it comes from, for the record
    """

    base: Model
    uncertainty_px: float
    source: str
    correction: Model | None = None
    searched_px: float = 0.0

    def __call__(self, xy: FloatArray) -> FloatArray:
        """Map (N, 2) reference points to the secondary image."""
        mapped = self.base(xy)
        return mapped if self.correction is None else self.correction(mapped)

    @property
    def stated(self) -> bool:
        """Whether it is the geography that both images state, not something measured or given."""
        return isinstance(self.base, Transfer)

    def widened(self) -> Prior:
        """The same map, trusted less."""
        return replace(self, uncertainty_px=max(WIDER * self.uncertainty_px, WIDER_PX))

    def record(self) -> dict[str, Any]:
        """What the result says of it, and what tells it from another."""
        correction = None if self.correction is None else self.correction.matrix
        return {
            "source": self.source,
            "uncertainty_px": self.uncertainty_px,
            "correction": None if correction is None else correction[:2].tolist(),
            **({"searched_px": self.searched_px} if self.searched_px else {}),
        }


def corrected(prior: Prior, reference_xy: FloatArray, secondary_xy: FloatArray, rng: np.random.Generator) -> Prior:
    """The prior with what the tie points of the pilot blocks say it is off by; itself where they do not agree.

    Its new uncertainty covers the residuals of these tie points with a margin.
    """
    if len(reference_xy) < LEAST_PILOTS:
        logger.info("pilot blocks: %d tie points, too few to correct the prior", len(reference_xy))
        return prior
    mapped = prior.base(reference_xy)
    good = np.isfinite(mapped).all(axis=1)
    kinds: tuple[type[Affine] | type[Translation], ...] = (Affine, Translation)
    fit: Callable[..., Any] = fit_consensus
    for kind in kinds:
        model, kept = fit(kind, mapped[good], secondary_xy[good], threshold=BENT_PX, rng=rng)
        if isinstance(model, FailedFit) or kept.sum() < max(LEAST_PILOTS // 2, 0.5 * good.sum()):
            continue
        try:
            residuals = model.residuals(mapped[good][kept], secondary_xy[good][kept])
        except FeatregError:
            continue
        reach = float(np.ceil(1.5 * np.percentile(residuals, 98) + 4.0))
        return Prior(prior.base, max(reach, LEAST_PX), f"{prior.source}, corrected by pilot blocks", model)
    logger.info("pilot blocks: %d tie points that do not agree on a correction", len(reference_xy))
    return prior
