"""A result in plain words: the verdict, every gate with its value and limit, what went wrong and what to try."""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from featreg.errors import InputError
from featreg.interfaces import FailedFit
from featreg.results import gate_texts as texts
from featreg.results.gate_texts import FOCUS, REGISTRATION, GateText
from featreg.results.losses import FEW, STAGES, block_words, chain, heights_words, image_words
from featreg.results.searching import searched_words, to_search_all
from featreg.types import Gate

if TYPE_CHECKING:
    from featreg.results.registration import Registration

WIDTH = 110
#: Putative tie points below which their number is a cause by itself, share of an image's pixels that is little, and
#: side of an image below which most methods find nothing.
FEW_PUTATIVE, LITTLE, SMALL_PX = 50, 0.25, 100
#: Cures that are listed at the end.
MOST_CURES = 5


class Finding(NamedTuple):
    """What probably went wrong, and what to try."""

    cause: str
    cures: tuple[str, ...]


def explain_registration(registration: Registration) -> str:
    """Return what a registration's verdict rests on, in lines of plain words."""
    kept = {name: int(mask.sum()) for name, mask in registration.stages.items()}
    model = registration.model
    choice = registration.provenance.get("choice", {})
    facts = [f"tried: {one['method']}, {one['status']}" for one in choice.get("tried", ())]
    left_out = searched_words(registration.provenance)
    facts += [f"searched: {left_out}"] if left_out else []
    facts += [f"tie points: {chain(int(registration.putative.sum()), kept)}, {int(registration.inliers.sum())} final"]
    if "locate" in kept:
        facts.append(f"located: {kept['locate'] or 'none'} of the matches, by windows that correlate")
    if "refine" in kept:
        facts.append(f"refinement: {kept['refine'] or 'no'} sub-pixel tie points around the first model")
    facts.append(f"model: none, {model.reason}" if isinstance(model, FailedFit) else f"model: {type(model).__name__}")
    return _explained(
        registration.status, registration.reason, facts, registration.gates, REGISTRATION, found_in(registration)
    )


def explain_focus(record: Mapping[str, Any]) -> tuple[str, str]:
    """Return the status of what `featreg focus --json` wrote, and its explanation.

    Raises
    ------
    InputError
        The record is not whole.
    """
    try:
        gates = {str(name): Gate.from_dict(gate) for name, gate in record["gates"].items()}
        status, reason = str(record["status"]), str(record["reason"])
        first, last = (float(value) for value in record["image_entropy"])
        facts = [f"method: {record['method']}", f"entropy of the image: {first:.4f} before, {last:.4f} after"]
    except (KeyError, TypeError, ValueError, AttributeError, ArithmeticError) as error:
        raise InputError(f"not a whole result of featreg focus: {error}") from error
    if status not in ("ok", "unreliable"):
        raise InputError(f"not a whole result of featreg focus: its status is {status!r:.40}")
    return status, _explained(status, reason, facts, gates, FOCUS, [])


def found_in(registration: Registration) -> list[Finding]:
    """Return what an unreliable registration shows of its causes beside its gates, most likely first."""
    if registration.status == "ok":
        return []
    return [*_of_images(registration), *_of_blocks(registration), *_of_stages(registration)]


def _of_images(registration: Registration) -> Iterator[Finding]:
    for role in ("reference", "secondary"):
        image = getattr(registration, role)
        if image is None:
            continue
        height, width = image.shape
        if image.valid_pixels is not None and image.valid_pixels < LITTLE * height * width:
            yield Finding(
                image_words(role, image),
                (f"check the mask (--mask-{role}) and --nodata", "cut the image to the part that holds data"),
            )
        if image.path != "tie points" and min(height, width) < SMALL_PX:
            yield Finding(
                f"{image_words(role, image)}: little room for features",
                ("a larger cut-out", "--method sift, whose windows are smaller", texts.KNOWN),
            )


def _of_blocks(registration: Registration) -> Iterator[Finding]:
    provenance = registration.provenance
    table = provenance.get("block_table")
    if isinstance(table, Mapping):
        said = block_words(table.get("status", ()), table.get("reason", ()))
        if said:
            yield Finding(
                said, ("check masks and --nodata", texts.GROUND, "after a failure the same --resume DIR again")
            )
    ground, prior = heights_words(provenance.get("heights")), provenance.get("prior")
    source = prior.get("source", "") if isinstance(prior, Mapping) else ""
    if str(source).startswith("geolocation") and "everywhere" in ground:
        yield Finding(f"the blocks were searched where the geolocation says, {ground}", (texts.GROUND,))


def _of_stages(registration: Registration) -> Iterator[Finding]:
    putative = left = int(registration.putative.sum())
    kept = {name: int(mask.sum()) for name, mask in registration.stages.items()}
    refined = kept.pop("refine", None)
    kept.pop("locate", None)
    if putative < FEW_PUTATIVE and registration.stages:
        left_out = searched_words(registration.provenance)
        if left_out:
            yield Finding(
                f"features were not looked for everywhere: {left_out}",
                (texts.MORE, *to_search_all(registration.provenance)),
            )
        yield Finding(
            f"{putative or 'no'} putative tie points: the method found little to pair",
            (texts.OTHER_METHOD, texts.MORE, texts.SCALE, texts.MASK),
        )
    for name, count in kept.items():
        if left and count < FEW * left:
            meaning = f" (each {STAGES[name]})" if name in STAGES else ""
            yield Finding(
                f"{name} kept {count or 'none'} of {left} tie points{meaning}", STAGE_CURES.get(name, FILTER_CURES)
            )
        left = count
    if refined == 0 and left:
        yield Finding(
            "refinement found no windows that correlate around the first model, so nothing confirms it",
            (texts.SAME_GROUND, texts.SOFTER, texts.OTHER_METHOD),
        )


FILTER_CURES = (texts.SAME_GROUND, texts.OTHER_METHOD, texts.MORE)
#: What to try where a stage kept almost nothing.
STAGE_CURES: Mapping[str, tuple[str, ...]] = {
    "initial": ("a larger --search-radius, where the initial model may be off", "no --initial"),
    "prior": (texts.GROUND, "a larger --search-radius around --initial", "whole images at once: --whole"),
    "gms": (texts.SAME_GROUND, texts.OTHER_METHOD, "another filter: --set filters=fsc", texts.MORE),
    "fsc": (texts.SAME_GROUND, texts.SOFTER, texts.OTHER_METHOD, "a wider --set fsc.threshold=5"),
    "ransac": (texts.SAME_GROUND, texts.SOFTER, texts.OTHER_METHOD),
    "mad": (texts.SAME_GROUND, texts.SOFTER, "--set association=fourier-mellin"),
}


def _explained(
    status: str,
    reason: str,
    facts: list[str],
    gates: Mapping[str, Gate],
    table: Mapping[str, GateText],
    findings: list[Finding],
) -> str:
    lines = _wrapped(status if status == "ok" else f"{status}: {reason}")
    lines += [line for fact in facts for line in _wrapped(fact, "  ")]
    failed = [name for name, gate in gates.items() if not gate.passed]
    if gates:
        lines += ["", f"gates: {len(gates) - len(failed)} of {len(gates)} passed"]
        for name, gate in gates.items():
            lines += _gate(name, gate, table.get(name))
    if status != "ok":
        causes = [finding.cause for finding in findings] or [table[name].cause for name in failed[:1] if name in table]
        if causes:
            lines += ["", "what probably went wrong"]
            lines += [line for cause in causes for line in _wrapped(cause, "  - ", "    ")]
        lines += ["", "what to try first"]
        offers = [finding.cures for finding in findings] + [table[name].cures for name in failed if name in table]
        lines += [line for n, cure in enumerate(_first(offers), 1) for line in _wrapped(cure, f"  {n}. ", "     ")]
    return "\n".join(lines)


def _first(offers: Sequence[tuple[str, ...]]) -> list[str]:
    """The cures that most causes and gates offer, the earlier offered first among equals."""
    votes = Counter(cure for cures in offers for cure in cures)
    if not votes:
        return [texts.SAME_GROUND, texts.OTHER_METHOD]
    return [cure for cure, _ in votes.most_common(MOST_CURES)]


def _gate(name: str, gate: Gate, text: GateText | None) -> Iterator[str]:
    value = f"unknown ({gate.unknown})" if gate.value is None and gate.unknown else "unknown"
    found = value if gate.value is None else f"{gate.value:.4g}"
    limits = [
        f"at {word} {limit:.4g}" for word, limit in (("least", gate.low), ("most", gate.high)) if limit is not None
    ]
    yield from _wrapped(
        f"{name}: {found}, {' and '.join(limits) or 'no limit'}", "  ok     " if gate.passed else "  FAILED ", " " * 11
    )
    yield from _wrapped(text.measures if text else gate.meaning or "no meaning is given", " " * 9)
    if text is not None and not gate.passed and gate.meaning:
        yield from _wrapped(f"found: {gate.meaning}", " " * 9)
    if text is not None:
        yield from _wrapped(f"limit: {text.limit}", " " * 9)
    if text is not None and not gate.passed:
        yield from _wrapped(f"cause: {text.cause}", " " * 9)
        yield from _wrapped(f"try: {'; '.join(text.cures)}", " " * 9)


def _wrapped(text: str, first: str = "", other: str | None = None) -> list[str]:
    rest = " " * len(first) if other is None else other
    return textwrap.wrap(text, WIDTH, initial_indent=first, subsequent_indent=rest, break_on_hyphens=False) or [first]
