"""The documentation as a site: it builds without a warning, is whole, and needs no network."""

from __future__ import annotations

import base64
import fcntl
import html
import importlib.util
import json
import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from types import ModuleType
from typing import Any
from urllib.parse import unquote, urlsplit

import cv2
import nbformat
import numpy as np
import pytest

import featreg

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.ipynb"))


def module(name: str) -> ModuleType:
    """A module of the site's configuration, which is no part of the package."""
    spec = importlib.util.spec_from_file_location(name, DOCS / "site" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    return made


class Page(HTMLParser):
    """The links, loaded files and anchors of a page."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.ids: set[str] = set()
        self.pictures: list[str | None] = []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.ids.update(v for k, v in attrs if k in ("id", "name") and v)
        if tag == "img":
            self.pictures.append(given.get("alt"))
        for key in ("src", "href"):
            if value := given.get(key):
                (self.links if tag == "a" else self.loaded).append(value)


@pytest.fixture(scope="session")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the site, its notebooks run; several processes that test share the one that is built first."""
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "site"
    with (folder.parent / "site.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not folder.exists():
            build(folder)
    return folder


def build(folder: Path) -> None:
    command = [sys.executable, "-m", "mkdocs", "build", "--config-file", str(DOCS / "site" / "mkdocs.yml")]
    done = subprocess.run(
        [*command, "--strict", "--site-dir", str(folder)],
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.slow
def test_every_link_leads_somewhere_and_nothing_is_loaded_from_elsewhere(site: Path) -> None:
    pages = {path: Page(path) for path in site.rglob("*.html") if path.name != "404.html"}
    assert len(pages) > 35
    for path, page in pages.items():
        for link in [*page.links, *page.loaded]:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                assert link in page.links or link.startswith("data:"), f"{path.name} loads {link}"
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            target = target / "index.html" if target.is_dir() else target
            assert target.is_file(), f"{path.name}: {link}"
            if parts.fragment and target.suffix == ".html":
                assert unquote(parts.fragment) in pages[target].ids, f"{path.name}: {link}"
        assert all(page.pictures), f"{path.name}: a picture without words"
    for path in site.rglob("*.css"):
        loaded = re.findall(r"url\(\s*[\"']?(https?:[^)\"']+)", path.read_text(encoding="utf-8"))
        assert loaded == [], path


@pytest.mark.slow
def test_the_menu_names_every_page_and_every_part(site: Path) -> None:
    menu = (DOCS / "site" / "mkdocs.yml").read_text(encoding="utf-8").partition("nav:")[2]
    shown = (site / "index.html").read_text(encoding="utf-8").partition('data-md-level="0"')[2]
    links = re.findall(
        r'<a href="([^"]+)" class="md-nav__link[^"]*">\s*<span class="md-ellipsis">\s*([^<]+?)\s*</span>', shown
    )
    for title, page in re.findall(r"- (.+): (\S+)\.md$", menu, re.M):
        path = f"{page}.html".replace("README.html", "index.html")
        assert links.count((path, html.escape(title, quote=False))) == 1, title
    for part in re.findall(r'<label class="md-nav__link.*?</label>', shown, re.S):
        assert re.sub(r"<[^>]*>", "", part).strip(), "a part of the menu without a name"


@pytest.mark.slow
def test_every_public_name_has_its_words_and_every_schema_is_there(site: Path) -> None:
    pages = "".join(path.read_text(encoding="utf-8") for path in (site / "reference").glob("*.html"))
    anchors = set(re.findall(r'id="(featreg\.[\w.]+)"', pages))
    assert {f"featreg.{name}" for name in set(public_names()) - {"FeatregError"}} <= anchors
    assert "featreg.errors.FeatregError" in anchors
    schemas = {path.name for path in (ROOT / "featreg").rglob("*.schema.json")}
    assert {path.name for path in (site / "schema").iterdir()} == schemas


@pytest.mark.slow
def test_pictures_are_small_and_the_whole_fits_a_mail(site: Path) -> None:
    assert max(path.stat().st_size for path in (site / "notebooks").glob("*.webp")) <= 200_000
    assert sum(path.stat().st_size for path in site.rglob("*") if path.is_file()) < 12_000_000


@pytest.mark.slow
def test_the_search_works_from_the_disk(site: Path, chromium: Any) -> None:
    page = chromium.new_context(viewport={"width": 1280, "height": 900}).new_page()
    wanted: list[str] = []
    page.on("request", lambda request: wanted.append(request.url))
    page.goto((site / "index.html").as_uri())
    # The page listens to keys, and reads its field once more when the index is there: a filled field is not seen.
    page.locator("input[name=query]").press_sequentially("anisotropy")
    page.locator("a.md-search-result__link[href*='unreliable.html#anisotropy']").first.wait_for(timeout=120_000)
    assert [url for url in wanted if not url.startswith(("file:", "data:", "blob:", "about:"))] == []
    page.context.close()


def public_names() -> list[str]:
    return [name for name in vars(featreg)["__all__"] if name != "__version__"]


def test_every_public_name_stands_on_a_page_of_the_reference() -> None:
    text = "\n".join(path.read_text(encoding="utf-8") for path in (DOCS / "reference").glob("*.md"))
    shown = set(re.findall(r"^::: featreg\.(\w+)$", text, re.M)) | {"FeatregError"}  # with all errors
    assert sorted(set(public_names()) - shown) == []


def test_every_page_is_in_the_menu() -> None:
    menu = (DOCS / "site" / "mkdocs.yml").read_text(encoding="utf-8").partition("nav:")[2]
    pages = [path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md") if "site" not in path.parts]
    pages += [path.relative_to(DOCS).with_suffix(".md").as_posix() for path in NOTEBOOKS]
    assert sorted(re.findall(r": (\S+\.md)$", menu, re.M)) == sorted(pages)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_are_kept_without_what_they_gave(path: Path) -> None:
    form: Any = nbformat
    notebook = form.read(path, as_version=4)
    form.validate(notebook)
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(cell.outputs == [] and cell.execution_count is None for cell in cells)
    assert notebook.cells[0].source.startswith("# ")
    assert path.stat().st_size < 20_000
    assert json.loads(path.read_text(encoding="utf-8"))["metadata"].keys() == {"kernelspec", "language_info"}


def test_there_are_six_notebooks() -> None:
    assert len(NOTEBOOKS) == 6


def test_a_notebook_becomes_a_page_with_pictures() -> None:
    new: Any = nbformat.v4
    png = cv2.imencode(".png", np.full((40, 3000, 3), 200, np.uint8))[1].tobytes()
    outputs = [
        new.new_output("stream", text="said\n"),
        new.new_output("execute_result", data={"text/plain": "1", "text/html": "<p>a</p>\n\n<p>b</p>"}),
        new.new_output("display_data", data={"image/png": base64.b64encode(png).decode()}),
    ]
    cell = new.new_code_cell("f()", outputs=outputs, metadata={"alt": "grey"})
    pages = module("notebook_pages")
    made = list(pages.page_of("toy", new.new_notebook(cells=[new.new_markdown_cell("# Toy"), cell])))
    text = made[0][1]
    assert made[0][0] == "notebooks/toy.md"
    for part in ("# Toy", "```python\nf()\n```", "```text\nsaid\n```", "<p>a</p>\n<p>b</p>", "![grey](toy-1.webp)"):
        assert part in text
    assert made[1][0] == "notebooks/toy-1.webp"
    picture = cv2.imdecode(np.frombuffer(made[1][1], np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    assert picture.shape[1] == 1400


def test_meanings_stand_below_their_names() -> None:
    text = "Do.\n\nParameters\n----------\na, b : (N,) two\n    of them\n**c : any\n\nReturns\n-------\nx : y\n"
    expected = text.replace("a, b : (N,) two\n", "a, b\n    (N,) two\n").replace("**c : any", "**c\n    any")
    assert module("house_docstrings").as_numpydoc(text) == expected
