"""Standard errors of what a registration found, from its own tie points."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from featreg.geometry import Rigid, inverse_variances, rigid_standard_errors, selection_cut
from featreg.interfaces import FailedFit

if TYPE_CHECKING:
    from featreg.results.registration import Registration


def standard_errors(registration: Registration) -> dict[str, Any]:
    """Return the standard errors of a rigid model; empty for other models and where they cannot be told.

    Returns
    -------
    dict
        ``rotation_deg_se`` (degrees), ``shift_se_px`` (x, y of the shift at the image centre), ``degrees_of_freedom``
        (a 95 % interval is Student's t of that many times the standard error).

    Notes
    -----
    They say how far the model scatters with the errors of its tie points, those that neighbours share included; see
    `featreg.geometry.rigid_standard_errors`. They cannot know what all tie points have in common.
    """
    model = registration.model
    image = registration.reference
    chosen, matches, residuals = registration.inliers, registration.matches, registration.residuals()
    if not isinstance(model, Rigid) or not chosen.any() or image is None:
        return {}
    parameters = registration.provenance.get("parameters") or {}
    if registration.putative[chosen].all():
        cut = selection_cut(residuals[chosen], residuals[registration.putative & ~chosen])
    else:
        cut = float((parameters.get("refinement") or {}).get("max_residual") or math.inf)
    covariance = matches.take(chosen).covariance if parameters.get("robust", True) else None
    found = rigid_standard_errors(
        model,
        matches.reference_xy[chosen],
        matches.secondary_xy[chosen],
        inverse_variances(covariance),
        at=((image.shape[1] - 1) / 2, (image.shape[0] - 1) / 2),
        cut=cut,
    )
    if isinstance(found, FailedFit):
        return {}
    return {
        "rotation_deg_se": found.rotation_deg,
        "shift_se_px": list(found.shift),
        "degrees_of_freedom": found.dof,
    }
