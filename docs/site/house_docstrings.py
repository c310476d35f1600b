"""Reads the house's docstrings: `name : what it is` holds a meaning where numpydoc expects a type."""

from __future__ import annotations

import re
from typing import Any

from griffe import Extension, Object

#: Titles of the sections whose entries are `name : meaning`.
TITLE = re.compile(r"^(Parameters|Other Parameters|Attributes)\n-+\n", re.M)
ENTRY = re.compile(r"^(\*{0,2}\w+(?:, \*{0,2}\w+)*) : (.+)$", re.M)
NEXT = re.compile(r"^\w[\w ]*\n-{3,}$", re.M)


def as_numpydoc(text: str) -> str:
    """Return a docstring whose entries say their meaning below the name; types are those of the signature."""
    out, start = [], 0
    for title in TITLE.finditer(text):
        after = NEXT.search(text, title.end())
        end = after.start() if after else len(text)
        section = ENTRY.sub(lambda entry: f"{entry[1]}\n    {entry[2]}", text[title.end() : end])
        out += [text[start : title.end()], section]
        start = end
    return "".join([*out, text[start:]])


class HouseDocstrings(Extension):
    """Rewrites every docstring once, when its object is loaded."""

    def on_object(self, *, obj: Object, **kwargs: Any) -> None:
        if obj.docstring is not None:
            obj.docstring.value = as_numpydoc(obj.docstring.value)
