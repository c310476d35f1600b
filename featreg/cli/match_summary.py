"""What is printed of a registration: a few lines, or one of many."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from featreg.results.searching import searched_words

if TYPE_CHECKING:
    from featreg.interfaces import Model
    from featreg.results.registration import Registration


def summary(result: Registration, written: list[str]) -> str:
    """Return what a person wants to know of a result, in a few lines."""
    import numpy as np

    from featreg.study.evaluation import computing_time

    provenance = result.provenance
    verdict = "ok" if result.status == "ok" else f"unreliable: {result.reason}"
    lines = [verdict, f"  method      {provenance['method']}, seed {provenance['seed']}"]
    tried = [f"{one['method']} {one['status']}" for one in provenance.get("choice", {}).get("tried", ())]
    lines += [f"  tried       {', '.join(tried)}"] if tried else []
    left_out = searched_words(provenance)
    lines += [f"  searched    {left_out}"] if left_out else []
    if result.model:
        trust = "" if result.status == "ok" else " (not to be trusted)"
        lines.append(f"  model       {_describe(result)}{trust}")
    putative = int(result.putative.sum())
    chain = [f"{putative} putative", *(f"{int(mask.sum())} after {name}" for name, mask in result.stages.items())]
    lines.append(f"  tie points  {int(result.inliers.sum())} final: {', '.join(chain)}")
    if result.model and result.inliers.any():
        rmse = float(np.sqrt(np.mean(result.residuals()[result.inliers] ** 2)))
        lines.append(f"  residuals   RMSE {rmse:.2f} px over the final tie points")
    blocks = provenance.get("blocks")
    accuracy = provenance.get("accuracy", {})
    if "blocks_px" in accuracy:
        held_out, local = result.gates["held_out_rmse"].value, accuracy["blocks_px"]
        text = "" if held_out is None else f"RMSE {held_out:.2f} px over tie points held out of the fit, "
        local = f"median {local['median']:.2f}, 95 % {local['percentile95']:.2f}, worst {local['worst']:.2f} px"
        lines.append(f"  accuracy    {text}by block {local}")
    if blocks:
        counts = ", ".join(f"{blocks[name]} {name}" for name in ("computed", "reused", "skipped", "failed"))
        lines.append(f"  blocks      {blocks['total']} of about {blocks['size']} px: {counts}")
    stages = ", ".join(f"{name} {seconds:.2f}" for name, seconds in result.timings.items())
    lines.append(f"  seconds     {computing_time(result.timings):.2f}: {stages}")
    if written:
        lines.append(f"  written     {', '.join(written)}")
    return "\n".join(lines)


def figures(result: Registration) -> dict[str, Any]:
    """Return what a row of many says of a result, by column; shifts in px at the centre of the reference."""
    import numpy as np

    from featreg.registry import model_name

    found: dict[str, Any] = {
        "status": result.status,
        "reason": " ".join(result.reason.split()),
        "method": result.provenance["method"],
        "putative": int(result.putative.sum()),
        "inliers": int(result.inliers.sum()),
    }
    if result.model:
        linear, (dx, dy) = _at_centre(result, result.model)
        found |= {"model": model_name(type(result.model)), "dx": round(float(dx), 3), "dy": round(float(dy), 3)}
        found["scale"] = round(float(linear.scale), 6)
        if math.isfinite(linear.rotation_deg):
            found["rotation_deg"] = round(float(linear.rotation_deg), 4)
        if result.inliers.any():
            found["rmse_px"] = round(float(np.sqrt(np.mean(result.residuals()[result.inliers] ** 2))), 3)
    return found


def one_line(row: Mapping[str, Any]) -> str:
    """Return a row of many as one line."""
    text = f"{row['name']}: {row['status']}"
    if row["status"] != "ok":
        return f"{text}: {row['reason']}"
    turn = "mirrored" if row["rotation_deg"] == "" else f"rotation {float(row['rotation_deg']):+.3f} deg"
    shift = f"shift ({float(row['dx']):+.2f}, {float(row['dy']):+.2f}) px"
    rmse = "" if row["rmse_px"] == "" else f", RMSE {float(row['rmse_px']):.2f} px"
    return f"{text}, {turn}, {shift}, {row['inliers']} tie points{rmse}, {float(row['seconds']):.1f} s"


def _at_centre(result: Registration, model: Model) -> tuple[Any, Any]:
    """What the model does at the centre of the reference: its linear part taken apart, and its shift."""
    import numpy as np

    from featreg.geometry import decompose, local_linear

    height, width = (1, 1) if result.reference is None else result.reference.shape
    centre = np.array([[(width - 1) / 2, (height - 1) / 2]])
    linear = decompose(local_linear(model, centre)[0])
    return linear, (model(centre) - centre)[0]


def _describe(result: Registration) -> str:
    """The model in words: its kind, and what it does at the centre of the reference."""
    from featreg.interfaces import FailedFit
    from featreg.registry import model_name

    model = result.model
    if isinstance(model, FailedFit):
        return f"none: {model.reason}"
    linear, (dx, dy) = _at_centre(result, model)
    errors = result.standard_errors
    if errors:
        sx, sy = errors["shift_se_px"]
        return (
            f"{model_name(type(model))}: rotation {linear.rotation_deg:+.3f} +- {errors['rotation_deg_se']:.3f} deg "
            f"counter-clockwise, shift ({dx:+.2f} +- {sx:.2f}, {dy:+.2f} +- {sy:.2f}) px (right, down), "
            "with standard errors, at the image centre"
        )
    # Behind a mirror there is no rotation.
    turned = math.isfinite(linear.rotation_deg)
    turn = f"rotation {linear.rotation_deg:+.3f} deg counter-clockwise" if turned else "mirrored"
    return (
        f"{model_name(type(model))}: {turn}, "
        f"scale {linear.scale:.5f}, shift ({dx:+.2f}, {dy:+.2f}) px (right, down), all at the image centre"
    )
