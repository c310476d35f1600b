"""What MkDocs does here beyond its own: executed notebooks, published schemas, links that leave the folder."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

SITE = Path(__file__).parent
ROOT = SITE.parents[1]
sys.path.insert(0, str(SITE))

from notebook_pages import pages_of  # noqa: E402

NOTEBOOK = re.compile(r"(\]\([\w/.]+)\.ipynb\)")
LINK = re.compile(r"\[([^\]]*)\]\((\.\./[^)\s]*)\)")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add what is no page of the folder: assets, schemas, and one page with its pictures for each notebook."""
    for path, content in _added():
        files.append(File.generated(config, path, content=content))
    return files


def _added() -> Iterator[tuple[str, str | bytes]]:
    for asset in sorted((SITE / "assets").iterdir()):
        yield f"assets/{asset.name}", asset.read_bytes()
    for schema in sorted((ROOT / "featreg").rglob("*.schema.json")):
        yield f"schema/{schema.name}", schema.read_bytes()
    yield from pages_of(sorted((ROOT / "docs" / "notebooks").glob("*.ipynb")))


def on_page_markdown(markdown: str, *, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Lead links to notebooks and schemas to what the site has of them, and leave of other files' links the words."""
    base = (ROOT / "docs" / page.file.src_uri).parent

    def words(link: re.Match[str]) -> str:
        target = (base / link[2].partition("#")[0]).resolve()
        if target.name.endswith(".schema.json"):
            return f"[{link[1]}](schema/{target.name})"
        return link[0] if target.is_relative_to(ROOT / "docs") else link[1]

    return NOTEBOOK.sub(r"\1.md)", LINK.sub(words, markdown))


def on_post_page(output: str, *, page: Page, config: MkDocsConfig, **rest: Any) -> str:
    """Let a keyboard reach what scrolls sideways, and a screen reader what the theme leaves without a name."""
    output = re.sub(r"<pre(?=[ >])(?![^>]*tabindex)", '<pre tabindex="0"', output)
    output = output.replace('<div class="scroll">', '<div class="scroll" tabindex="0">')
    output = output.replace('role="dialog"', 'role="dialog" aria-label="Search"', 1)
    return re.sub(r"<th([^>]*)></th>", r"<td\1></td>", output)
