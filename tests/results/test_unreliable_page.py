"""`docs/unreliable.md` says of every gate what the program says; run as a script, this file writes its tables."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

from featreg.pipeline.trust import BENT, CONDITIONS, Limits
from featreg.results.gate_texts import FOCUS, REGISTRATION, GateText
from featreg.results.losses import STAGES

PAGE = Path(__file__).parents[2] / "docs" / "unreliable.md"
#: Limits that are not those of `Limits`, and in words where a number alone does not tell.
SAID = {
    "prior": "at most `search_radius`",
    "stability": f"at most {Limits().stability_px:g}, and at most {Limits().stability_by_spread_px:g} times `spread` "
    f"({BENT * Limits().stability_by_spread_px:g} times for homographies and polynomials)",
    "drift": f"at most {Limits().drift_px:g}",
    "structure": "only where the method states one",
    "search": "at most 0.6 of the prior's uncertainty",
    "distortion": "only where the method states one",
    "dilution": "only where the method states one",
    "blocks": f"at least {Limits().block_share:g}",
    "block_error": f"at most {Limits().block_error_px:g}",
    "held_out_rmse": f"at most {Limits().held_out_rmse_px:g}",
    **{name: f"at most {getattr(Limits(), name):g}" for name in ("alias", "identical")},
    **{
        name: f"at most {getattr(Limits(), name):g}, half of it where a refinement found nothing"
        for name in ("rival", "local")
    },
    "scene": f"at least {Limits().scene:g}",
}
FOCUS_SAID = {
    "pulses": "at least 8",
    "cells": "at least 4",
    "deviation": "at most 0.25",
    "held out": "at most 0.25",
    "settled": "at most 0.25",
    "sharpness": "at least 0 where the entropy fell by more than 0.1 nats",
    "entropy": "at most 0.01",
    "blocks": "at least half of them",
}


def limits() -> dict[str, str]:
    said = dict(SAID)
    for condition in CONDITIONS:
        if condition.name not in said:
            low, high = condition.limits(Limits(), None)  # type: ignore[arg-type]  # only `prior` looks at its evidence
            known = [f"at {word} {value:g}" for word, value in (("least", low), ("most", high)) if value is not None]
            said[condition.name] = " and ".join(known)
    return said


def coded(text: str) -> str:
    """The text with its options and their values in code."""
    return re.sub(r"(--[a-z][a-z-]*(?: (?:[A-Z]+(?:\.[a-z]+)?\b|\d+))?)", r"`\1`", text)


def table(texts: Mapping[str, GateText], said: Mapping[str, str], of: str = "") -> str:
    """All gates with their limits, then each by itself."""
    rows = ["| gate | what it measures | limit |", "| --- " * 3 + "|"]
    parts = []
    for name, text in texts.items():
        limit = said[name]
        anchor = f"{name}{of}".replace(" ", "-")
        rows.append(f"| [`{name}`](#{anchor}) | {coded(text.measures)} | {limit} |")
        parts += [
            f"### `{name}`{of}\n",
            f"{coded(text.measures[0].upper() + text.measures[1:])}. Limit: {limit}.\n",
            f"- **Why there**: {coded(text.limit)}.",
            f"- **What fails it**: {coded(text.cause)}.",
            f"- **What to try**: {coded('; '.join(text.cures))}.\n",
        ]
    return "\n".join([*rows, "", *parts]).rstrip()


def sections() -> dict[str, str]:
    stages = [f"| `{name}` | a tie point that it keeps {meaning} |" for name, meaning in STAGES.items()]
    return {
        "stages": "\n".join(["| stage | keeps |", "| --- | --- |", *stages]),
        "registration": table(REGISTRATION, limits()),
        "focus": table(FOCUS, FOCUS_SAID, " of autofocus"),
    }


def written(page: str) -> str:
    for name, text in sections().items():
        start, end = f"<!-- {name} -->", f"<!-- end of {name} -->"
        assert page.count(start) == page.count(end) == 1
        page = page.partition(start)[0] + f"{start}\n{text}\n{end}" + page.partition(end)[2]
    return page


def test_the_page_says_what_the_program_says() -> None:
    page = PAGE.read_text(encoding="utf-8")
    assert page == written(page), f"python {Path(__file__).name} writes the tables anew"


def test_the_readme_leads_to_it() -> None:
    assert "](docs/unreliable.md)" in (PAGE.parents[1] / "README.md").read_text(encoding="utf-8")


if __name__ == "__main__":
    PAGE.write_text(written(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
