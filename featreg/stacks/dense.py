"""A matched pair measured again, by windows all over the image instead of at tie points."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from featreg.displacement.run import offsets
from featreg.geometry import inverse_variances
from featreg.geometry.robust import irls
from featreg.interfaces import FailedFit, Model
from featreg.types import Matches

#: Side of the windows, px, which lie side by side so that their errors are their own; how far from the match they look.
WINDOW, SEARCH = 48, 3.0
#: Fewest windows that a fit is worth, in minimal samples of the model, and as a share of the windows that lie in both.
FEWEST, LEAST_SHARE = 6, 0.25
#: Rounds of the robust fit, and the error that it takes the best window to have, px.
ROUNDS, SCALE_PX = 6, 0.05
#: Farthest that the fit may lie from the match, px RMS over the windows.
FAR_PX = 1.5


def measured_again(
    reference: Any,
    secondary: Any,
    model: Model,
    shape: tuple[int, int],
    reading: Mapping[str, Any],
    how: Mapping[str, Any],
) -> tuple[Model, Matches] | None:
    """Return the model fitted to windows all over the image, and the windows; None where too few of them agree.

    Parameters
    ----------
    reference, secondary : as in `featreg.offsets`
    model : of the match, which tells where to look
    shape : (H, W) of the reference
    reading, how : keywords of `featreg.offsets` that say how images are read and what runs the blocks

    Notes
    -----
    Tie points sit on what stands out; the ground between them tells the position too, and one model for the image can
    take it all. Where the images do not compare window by window (radar beside optics, fields that changed), or the
    windows tell another model than the tie points do, the match stands.
    """
    everywhere = np.stack(np.meshgrid(*(np.linspace(0, n - 1, 9) for n in shape[::-1])), -1).reshape(-1, 2)
    if not np.isfinite(model(everywhere)).all():
        return None
    field = offsets(reference, secondary, step=WINDOW, window=WINDOW, search=SEARCH, initial=model, **reading, **how)
    good = field.good
    counts = field.counts
    inside = good.size - counts["outside"] - counts["masked"]
    if good.sum() < max(FEWEST * type(model).minimum, LEAST_SHARE * inside):
        return None
    x, y = np.meshgrid(field.x, field.y)
    here = np.column_stack([x[good], y[good]])
    there = here + np.column_stack([field.dx[good], field.dy[good]])
    weights = inverse_variances(field.covariance[good])
    fitted, kept = irls(type(model), here, there, weights=weights, scale_px=SCALE_PX, iterations=ROUNDS)
    used = kept > 0
    if isinstance(fitted, FailedFit) or used.sum() < max(FEWEST * fitted.minimum, LEAST_SHARE * inside):
        return None
    if float(np.sqrt((fitted.residuals(here[used], model(here[used])) ** 2).mean())) > FAR_PX:
        return None
    return fitted, Matches(here[used], there[used], field.peak[good][used], field.covariance[good][used])
