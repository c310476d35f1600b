"""Cards of HTML for notebooks: a title, facts, a verdict, pictures and tables, light and dark, without a script.

What another room wants to show of its own types it puts together of these and registers with
`featreg.pictures.interactive`.
"""

from __future__ import annotations

import base64
import html
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Longest side of a picture on a card, px.
SIDE = 360

STYLE = """
.featreg{--ink:#1b2028;--faint:#57606d;--card:#fff;--edge:#d9dee5;--ok:#00735a;--warn:#8a5300;--bad:#b3261e;--best:#e6f2ff;
--good-dot:#00775c;--bad-dot:#c2540a;
font:13px/1.45 system-ui,-apple-system,"Segoe UI",sans-serif;color:var(--ink);background:var(--card);border:1px solid
var(--edge);border-radius:8px;padding:10px 14px;max-width:860px;box-sizing:border-box;overflow:hidden}
@media (prefers-color-scheme:dark){.featreg{--ink:#e7ebf1;--faint:#a3adba;--card:#191e26;--edge:#3a4452;--ok:#45d6ae;
--warn:#f2b35c;--bad:#ff8a80;--best:#16304d;--good-dot:#35cfa3;--bad-dot:#ff944d}}
.featreg .head{font-weight:600;margin:0 0 6px;font-size:14px;overflow-wrap:anywhere}
.featreg .badge{border:1px solid currentColor;border-radius:99px;padding:0 8px;font-size:12px;margin-left:8px}
.featreg .ok{color:var(--ok)}.featreg .unreliable{color:var(--warn)}.featreg .failed{color:var(--bad)}
.featreg .why{margin:0 0 6px;overflow-wrap:anywhere}
.featreg .row{display:flex;flex-wrap:wrap;gap:12px 20px;align-items:flex-start}
.featreg dl{display:grid;grid-template-columns:max-content minmax(0,1fr);gap:1px 12px;margin:0;flex:1 1 260px}
.featreg dt{color:var(--faint)}.featreg dd{margin:0;overflow-wrap:anywhere}
.featreg figure{margin:0;flex:0 1 auto;max-width:100%}.featreg figcaption{color:var(--faint);font-size:12px}
.featreg img,.featreg svg{max-width:100%;height:auto;display:block;border-radius:4px}
.featreg .scroll{overflow-x:auto;max-width:100%;margin-top:8px}
.featreg table{border-collapse:collapse;color:inherit;font-size:12.5px;margin:0}
.featreg th,.featreg td{padding:2px 10px 2px 0;text-align:left;border-top:1px solid var(--edge);background:none;
color:inherit}
.featreg td.number,.featreg th.number{text-align:right;font-variant-numeric:tabular-nums}
.featreg td.words{min-width:15em}
.featreg td.best{font-weight:700;background:var(--best)}
.featreg details{margin-top:8px}.featreg summary{cursor:pointer;color:var(--faint)}
.featreg ul{margin:4px 0 0;padding-left:18px}.featreg li{overflow-wrap:anywhere}
"""


def card(
    title: str,
    facts: Iterable[tuple[str, str]] = (),
    *,
    status: str = "",
    reason: str = "",
    figures: Iterable[str] = (),
    body: str = "",
) -> str:
    """Return a card.

    Parameters
    ----------
    title : plain text, as everything here that is not said to be HTML
    facts : (name, text) pairs
    status : "ok", "unreliable" or "failed", shown beside the title
    reason : why it is not "ok"
    figures : from `picture` or another figure of HTML
    body : HTML below
    """
    badge = f'<span class="badge {escape(status)}">{escape(status)}</span>' if status else ""
    why = f'<p class="why {escape(status)}">{escape(reason)}</p>' if reason else ""
    listed = "".join(f"<dt>{escape(name)}</dt><dd>{escape(text)}</dd>" for name, text in facts)
    inside = "".join(figures) + (f"<dl>{listed}</dl>" if listed else "")
    return (
        f'<div class="featreg"><style>{STYLE}</style><p class="head">{escape(title)}{badge}</p>{why}'
        f'<div class="row">{inside}</div>{body}</div>'
    )


def picture(pixels: NDArray[np.uint8], caption: str) -> str:
    """Return (h, w) gray or (h, w, 3) RGB pixels as a figure; its longest side is `SIDE` at most."""
    import cv2

    height, width = pixels.shape[:2]
    factor = SIDE / max(height, width)
    if factor < 1:
        size = max(1, round(width * factor)), max(1, round(height * factor))
        pixels = np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), np.uint8)
    ordered = pixels if pixels.ndim == 2 else pixels[..., ::-1]
    _, encoded = cv2.imencode(".webp", np.ascontiguousarray(ordered), [cv2.IMWRITE_WEBP_QUALITY, 80])
    data = base64.b64encode(encoded.tobytes()).decode()
    return figure(f'<img alt="{escape(caption)}" src="data:image/webp;base64,{data}">', caption)


def figure(content: str, caption: str) -> str:
    """Return HTML with a caption below."""
    return f"<figure>{content}<figcaption>{escape(caption)}</figcaption></figure>"


def table(titles: Sequence[str], rows: Iterable[Sequence[Any]], classes: Iterable[Sequence[str]] = ()) -> str:
    """Return a table of plain text.

    Parameters
    ----------
    titles : of the columns
    rows : their cells; None is empty
    classes : of each cell, "number", "best", "ok", "words" (a wide one) and the like
    """
    listed = [list(row) for row in rows]
    kinds = [list(row) for row in classes] or [[""] * len(titles) for _ in listed]
    numeric = [all("number" in kind[k] for kind in kinds) and bool(kinds) for k in range(len(titles))]
    head = "".join(
        f'<th scope="col"{_class("number" if numeric[k] else "")}>{escape(title)}</th>'
        for k, title in enumerate(titles)
    )
    lines = "".join(
        "<tr>" + "".join(f"<td{_class(k)}>{escape(c)}</td>" for c, k in zip(row, kind, strict=True)) + "</tr>"
        for row, kind in zip(listed, kinds, strict=True)
    )
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{lines}</tbody></table></div>'


def folded(title: str, lines: Iterable[str]) -> str:
    """Return lines of plain text that are shown when one asks for them."""
    listed = "".join(f"<li>{escape(line)}</li>" for line in lines)
    return f"<details><summary>{escape(title)}</summary><ul>{listed}</ul></details>"


def escape(text: Any) -> str:
    """Return plain text as HTML."""
    return "" if text is None else html.escape(str(text))


def _class(kind: str) -> str:
    return f' class="{kind}"' if kind else ""
