"""A result in a few lines of text and in one: what a terminal shows of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from featreg.geometry import decompose, local_linear
from featreg.interfaces import FailedFit
from featreg.results.input_image import InputImage
from featreg.results.losses import chain
from featreg.results.searching import searched_words

if TYPE_CHECKING:
    from featreg.results.registration import Registration

#: Letters of a reason in one line.
SHORT = 160


def one_line(registration: Registration) -> str:
    """Return the verdict, the tie points and the model of a result in less than 500 letters."""
    method = str(registration.provenance.get("method", ""))[:40]
    parts = [registration.status, *([method] if method else []), f"{int(registration.inliers.sum())} tie points"]
    if registration.model:
        model = dict(model_facts(registration))
        parts += [model["model"], *(f"{name} {model[name]}" for name in ("rotation", "scale") if name in model)]
    if registration.status != "ok":
        parts.append(f"because {shortened(registration.reason)}")
    return f"Registration({', '.join(parts)})"


def shortened(text: str, most: int = SHORT) -> str:
    """Return a text of at most `most` letters, the rest as an ellipsis."""
    return text if len(text) <= most else text[: most - 1].rstrip() + "…"


def model_facts(registration: Registration) -> list[tuple[str, str]]:
    """Return what the model does at the middle of the reference, as (name, text)."""
    model, image = registration.model, registration.reference
    if isinstance(model, FailedFit):
        return [("model", f"none: {shortened(model.reason)}")]
    facts = [("model", type(model).__name__ + _narrower(registration))]
    inside = registration.matches.reference_xy[registration.inliers]
    if image is not None:
        centre = (np.array(image.shape[::-1], np.float64) - 1) / 2
    elif len(inside):
        centre = inside.mean(axis=0)
    else:
        return facts
    linear = decompose(local_linear(model, centre))
    dx, dy = (np.asarray(model(centre[None]))[0] - centre).tolist()
    facts += [
        ("rotation", f"{linear.rotation_deg:+.3f}°"),
        ("scale", f"{linear.scale:.5f}"),
        ("shift at the centre", f"{dx:+.2f}, {dy:+.2f} px"),
    ]
    if registration.inliers.any():
        rms = float(np.sqrt(np.mean(registration.residuals()[registration.inliers] ** 2)))
        facts.append(("RMS residual", f"{rms:.3f} px"))
    return facts


def _narrower(registration: Registration) -> str:
    """How an affine model comes of a narrower one that was asked for."""
    said = {name: registration.provenance.get(name) for name in ("frame", "prior")}
    asked = {name: one["model"] for name, one in said.items() if isinstance(one, Mapping) and one.get("model")}
    if "frame" in asked:
        return f" (a {asked['frame']} but for what both images state)"
    return f" (no {asked['prior']} holds what both images state)" if "prior" in asked else ""


def facts_of(registration: Registration) -> list[tuple[str, str]]:
    """Return what a person asks first of a result, as (name, text)."""
    provenance = registration.provenance
    facts = [("method", f"{provenance.get('method', 'unknown')}, seed {provenance.get('seed', 'unknown')}")]
    facts += [
        (role, image_words(image))
        for role, image in (("reference", registration.reference), ("secondary", registration.secondary))
        if image is not None
    ]
    left_out = searched_words(provenance)
    facts += [("searched", left_out)] if left_out else []
    stages = {name: int(mask.sum()) for name, mask in registration.stages.items()}
    facts.append(
        ("tie points", f"{chain(int(registration.putative.sum()), stages)}, {int(registration.inliers.sum())} final")
    )
    facts += model_facts(registration)
    passed = sum(gate.passed for gate in registration.gates.values())
    if registration.gates:
        facts.append(("gates", f"{passed} of {len(registration.gates)} passed"))
    seconds = sum(registration.timings.values())
    if seconds:
        facts.append(("time", f"{seconds:.2f} s"))
    return facts


def image_words(image: InputImage) -> str:
    """Return the name, size, samples and place of an image in one line."""
    height, width = image.shape
    words = [f"{shortened(image.path, 80)}, {width} x {height} px", *([image.scale] if image.scale else [])]
    words += [f"calibrated to {image.calibration}"] if image.calibration else []
    if image.nodata is not None:
        words.append("no value stands for no data" if np.isnan(image.nodata) else f"no data where {image.nodata:g}")
    if image.valid_pixels is not None and image.valid_pixels < height * width:
        words.append(f"{100 * image.valid_pixels / (height * width):.1f} % valid")
    if image.pixel_size is not None:
        x, y, unit = image.pixel_size
        words.append(f"{abs(x):.4g} x {abs(y):.4g} {unit}")
    return ", ".join(words)


def summary(registration: Registration) -> str:
    """Return a result in a few aligned lines: verdict, images, counts, model, and every gate that failed."""
    verdict = registration.status if registration.status == "ok" else f"unreliable: {registration.reason}"
    facts = facts_of(registration)
    width = max(len(name) for name, _ in facts)
    lines = [verdict, *(f"  {name:<{width}}  {text}" for name, text in facts)]
    lines += [f"  FAILED {name}: {gate.failure}" for name, gate in registration.gates.items() if not gate.passed]
    return "\n".join(lines)
