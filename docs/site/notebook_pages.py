"""Runs notebooks and turns each into a page of Markdown and its pictures.

In the repository a notebook holds no output: what the site shows was computed while the site was built. A cell whose
output is a picture says in its metadata, `alt`, what the picture shows.
"""

from __future__ import annotations

import base64
import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import nbformat
import numpy as np
from nbclient import NotebookClient
from traitlets.config import Config

ROOT = Path(__file__).resolve().parents[2]
#: Where real images are looked for; notebooks simulate where there are none.
DATA = Path(os.environ.get("FEATREG_DATA", ROOT.parent / "shared" / "data"))
#: Seconds that one cell may take.
TIMEOUT = 300
#: Notebooks that run at a time.
AT_A_TIME = 2
#: Most pixels across and bytes of a picture on a page.
WIDTH, BYTES = 1400, 200_000


def pages_of(notebooks: list[Path]) -> Iterator[tuple[str, str | bytes]]:
    """Yield (path in the site, content) of the page of each notebook and of its pictures.

    FEATREG_NOTEBOOKS=plain leaves out what the cells would give, for those who write on another page.
    """
    asked = os.environ.get("FEATREG_NOTEBOOKS", "")
    if asked not in ("", "plain"):
        raise SystemExit(f"FEATREG_NOTEBOOKS is '{asked}', give 'plain' or leave it unset")
    plain = asked == "plain"
    with ThreadPoolExecutor(AT_A_TIME) as pool:
        for path, notebook in zip(notebooks, pool.map(_read if plain else executed, notebooks), strict=True):
            yield from page_of(path.stem, notebook)


def _read(path: Path) -> Any:
    return nbformat.read(path, as_version=4)


def executed(path: Path) -> Any:
    """Return the notebook with what its cells give when they run in an empty folder, one after the other."""
    notebook = _read(path)
    with TemporaryDirectory() as folder:
        # Through files of the folder rather than ports of the machine.
        settings = Config({"KernelManager": {"transport": "ipc", "ip": f"{folder}/kernel"}})
        resources = {"metadata": {"path": folder}}
        client = NotebookClient(notebook, timeout=TIMEOUT, resources=resources, config=settings)
        client.execute(env={**os.environ, "FEATREG_DATA": str(DATA)})
    return notebook


def page_of(stem: str, notebook: Any) -> Iterator[tuple[str, str | bytes]]:
    """Yield the page of one notebook, then its pictures."""
    parts: list[str] = []
    pictures: list[tuple[str, bytes]] = []
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            parts.append(cell.source)
            continue
        parts.append(f"```python\n{cell.source}\n```")
        for output in cell.outputs:
            data = output.get("data", {})
            if output.output_type == "stream":
                parts.append(_text(output.text))
            elif "image/png" in data:
                name = f"{stem}-{len(pictures) + 1}.webp"
                pictures.append((f"notebooks/{name}", small(base64.b64decode(data["image/png"]))))
                parts.append(f"![{cell.metadata['alt']}]({name})")
            elif "text/html" in data:
                # Without blank lines Markdown takes it as one block and leaves it as it is.
                html = "\n".join(line for line in data["text/html"].splitlines() if line.strip())
                parts.append(f'<div class="output">\n{html}\n</div>')
            elif "text/plain" in data:
                parts.append(_text(data["text/plain"]))
    parts.append(f"*This page is the notebook `docs/notebooks/{stem}.ipynb`, run while the site was built.*")
    yield f"notebooks/{stem}.md", "\n\n".join(parts) + "\n"
    yield from pictures


def small(png: bytes) -> bytes:
    """Return a picture as WebP of at most 1400 px width and 200 kB."""
    picture = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    size = min(1.0, WIDTH / picture.shape[1])
    picture = cv2.resize(picture, None, fx=size, fy=size, interpolation=cv2.INTER_AREA)
    for quality in range(90, 0, -10):
        written = cv2.imencode(".webp", picture, [cv2.IMWRITE_WEBP_QUALITY, quality])[1].tobytes()
        if len(written) <= BYTES:
            return written
    raise ValueError(f"a picture of {len(png)} bytes does not fit into {BYTES}: draw a smaller one")


def _text(text: str) -> str:
    return f"```text\n{text.rstrip()}\n```"
