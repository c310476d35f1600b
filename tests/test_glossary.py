"""Every abbreviation that the lists and tables show stands in the glossary, once."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import pytest

from featreg import registry

ROOT = Path(__file__).parents[1]
#: A word with two capitals or more: SAR, GeoTIFF, XFeat, RC-OBCLS.
ABBREVIATION = re.compile(r"\b[A-Z][A-Za-z0-9]*[A-Z][A-Za-z0-9]*(?:-[A-Z][A-Za-z0-9]*)*\b")
#: Names of libraries, classes, files and licences, placeholders, units.
NO_ABBREVIATION = {
    "OpenCV", "NumPy", "RITSAR", "FILE", "NAME", "NAME-paper", "VALUE", "PX", "MIT", "REF", "SEC", "Lucas-Kanade",
    "LightGlueMatcher", "README", "BSD", "GB", "MB", "CPU",
}  # fmt: skip


def explained() -> list[str]:
    """The first column of the glossary's tables, word by word."""
    text = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")
    cells = [cell for cell in re.findall(r"^\| ([^|]+?) \|", text, re.M) if cell != "term" and set(cell) - set("- ")]
    return [word for cell in cells for word in re.split(r", (?:and )?", cell)]


def missing(text: str) -> set[str]:
    known = set(explained())
    found = set()
    for word in ABBREVIATION.findall(text):
        parts = {word, word.removesuffix("s"), *word.split("-")}
        # The first letters of a name that is a prefix: CA-CFAR, C-OBCLS.
        if not (parts & known or word in NO_ABBREVIATION):
            found.add(word)
    return found


def test_each_stands_once() -> None:
    assert [word for word, count in Counter(explained()).items() if count > 1] == []


@pytest.mark.parametrize("page", ["README.md", "docs/methods.md", "docs/comparisons.md", "docs/learned.md"])
def test_what_tables_show_is_explained(page: str) -> None:
    rows = re.findall(r"^\|.*\|$", (ROOT / page).read_text(encoding="utf-8"), re.M)
    assert rows
    assert missing(re.sub(r"`[^`]*`|\]\([^)]*\)", " ", "\n".join(rows))) == set(), "docs/glossary.md lacks these"


def test_what_the_list_shows_is_explained() -> None:
    plugins = [entry.summary for kind in registry.KINDS for entry in registry.entries(kind)]
    methods = [preset.summary for preset in registry.presets().values()]
    assert missing("\n".join([*plugins, *methods])) == set(), "docs/glossary.md lacks these"
