"""The page: content, style and code put into one HTML file."""

from __future__ import annotations

import base64
import hashlib
import html
import json
from importlib.resources import files
from pathlib import Path

from featreg.errors import InputError
from featreg.report.content import content
from featreg.report.data import ReportStudy
from featreg.runtime.files import write_atomic

#: The parts of the page's code, in the order in which they build on each other.
SCRIPTS = (
    "dom.js",
    "data.js",
    "table.js",
    "charts.js",
    "downloads.js",
    "canvas.js",
    "touching.js",
    "painting.js",
    "handling.js",
    "viewer.js",
    "printing.js",
    "main.js",
)
STYLE, TEMPLATE = "report.css", "report.html"


def write_report(path: str | Path, study: ReportStudy) -> None:
    """Write a report as one HTML file that needs no network, whole or not at all.

    Parameters
    ----------
    path : the file, named .html or .htm, in a folder that exists
    study : what it shows

    Raises
    ------
    InputError
        The folder is missing or the file has another ending. An image that cannot be read is told on the page.

    Notes
    -----
    Equal studies give equal bytes. The page holds at most 8000 tie points of one result and fewer where there are many
    results, and pictures of at most 1024 pixels, so that 20 pairs by five methods stay below 15 MB; it says where
    it leaves something out.
    """
    target = Path(path)
    if target.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"a report is an HTML page, give a name that ends in .html, got '{target.name}'")
    if not target.parent.is_dir():
        raise InputError(f"the folder '{target.parent}' for the report '{target.name}' does not exist")
    write_atomic(target, render(study).encode())


def render(study: ReportStudy) -> str:
    """Return the page as text."""
    whole, blobs = content(study)
    here = files("featreg.report")
    # The parts share one module scope: no name of theirs is global, and none can be reached from outside.
    code = "\n".join(here.joinpath(name).read_text(encoding="utf-8") for name in SCRIPTS)
    style = here.joinpath(STYLE).read_text(encoding="utf-8")
    policy = (
        f"default-src 'none'; script-src '{_digest(code)}'; style-src '{_digest(style)}'; img-src data:; "
        "base-uri 'none'; form-action 'none'"
    )
    parts = {
        "title": html.escape(study.title or "featreg report"),
        "policy": html.escape(policy, quote=False),
        "style": style,
        "code": code,
        "content": _script_text(json.dumps(whole, ensure_ascii=False, allow_nan=False, separators=(",", ":"))),
        "blobs": "\n".join(f'<script type="text/plain" id="{name}">{text}</script>' for name, text in blobs.items()),
    }
    made = here.joinpath(TEMPLATE).read_text(encoding="utf-8")
    # What is put in may itself hold the mark of another part, so the template is cut first.
    head, *rest = made.split("{{")
    pieces = [head]
    for piece in rest:
        name, _, after = piece.partition("}}")
        pieces += [parts[name], after]
    return "".join(pieces)


def _digest(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def _script_text(text: str) -> str:
    """JSON that cannot end the element it stands in, nor start a comment in it."""
    for sign in "<>&\u2028\u2029":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return text
