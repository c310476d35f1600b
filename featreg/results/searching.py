"""Where features were looked for, in words: what of the images a method left out, and which parameter asks for it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

#: Values of parameters with which nothing is left out.
WHOLE = {"pixels_per_feature": "0", "skip": "0", "coarse": "false", "thin": "false"}


def searched_words(provenance: Mapping[str, Any]) -> str:
    """Return what was left out where features were looked for, in one line; "" where nothing was, or nobody tells.

    Parameters
    ----------
    provenance : of a registration, with ``searched`` as the result's schema has it
    """
    ways: list[tuple[int, str]] = []
    for one in provenance.get("searched") or ():
        ways.append((int(one.get("blocks", 1)), _way(one, provenance.get("parameters", {}))))
    said = [(count, words) for count, words in ways if words]
    if not said:
        return ""
    total = sum(count for count, _ in ways)
    most = max(said, key=lambda way: way[0])
    if total == 1:
        return most[1]
    others = sum(count for count, _ in said) - most[0]
    more = f"; otherwise reduced in {others} more" if others else ""
    return f"in {most[0]} of {total} blocks {most[1]}{more}"


def to_search_all(provenance: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the settings, as the command line takes them, with which what was left out is searched too."""
    found: list[str] = []
    for one in provenance.get("searched") or ():
        for image in (one["reference"], one["secondary"]):
            found += [name for name in (image.get("reduced_by"), *image.get("left_out_px", {})) if name]
    known = {name: WHOLE.get(name.rpartition(".")[2]) for name in found}
    return tuple(f"--set {name}={value}" for name, value in known.items() if value is not None)


def _way(one: Mapping[str, Any], parameters: Mapping[str, Any]) -> str:
    images = [_image(one[role], parameters) for role in ("reference", "secondary")]
    if images[0] == images[1]:
        return images[0]
    return "; ".join(
        f"{role} {words or 'whole'}" for role, words in zip(("reference", "secondary"), images, strict=True)
    )


def _image(image: Mapping[str, Any], parameters: Mapping[str, Any]) -> str:
    """What was left out of one image; "" where nothing was."""
    by, left_out = image.get("reduced_by"), image.get("left_out_px", {})
    words = [f"at {100 * float(image['share']):.0f} % of the size ({_asked(by, parameters)})"] if by else []
    words += [f"without those of {_radii(radii)} ({_asked(name, parameters)})" for name, radii in left_out.items()]
    if not words:
        return ""
    radii = image.get("radii_px")
    return ", ".join([f"keypoints of {_radii(radii)}" if radii else "features", *words])


def _radii(radii: Sequence[float]) -> str:
    if not radii:
        return "no radius"
    first, last = (f"{radius:.3g}" for radius in (min(radii), max(radii)))
    return f"{first} px radius" if first == last else f"{first} to {last} px radius"


def _asked(name: Any, parameters: Mapping[str, Any]) -> str:
    """A parameter with its value, where the record has it."""
    value: Any = parameters
    for part in str(name).split("."):
        value = value.get(part) if isinstance(value, Mapping) else None
    return str(name) if value is None else f"{name}={value:g}" if isinstance(value, float) else f"{name}={value}"
