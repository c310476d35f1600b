"""`featreg list`, `featreg demo` and `featreg doctor`: what there is, what it does, and what this machine has."""

from __future__ import annotations

import json
import shutil
import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from featreg.cli.options import COMPILING, check_folder, check_name, progress

KINDS = ("detector", "descriptor", "nearest", "matcher", "filter", "model", "method")


def list_plugins(
    kind: Annotated[
        str | None,
        typer.Argument(metavar="KIND", help=f"One of {', '.join(KINDS)}; without it, all.", show_default=False),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON for machines.")] = False,
) -> None:
    """List methods and parts with their parameters."""
    if kind is not None:
        check_name(kind, KINDS, "kind")
    found = [item for one in KINDS if kind in (None, one) for item in _items(one)]
    from featreg.registry import broken
    from featreg.results.json_file import plain

    hidden = broken()
    if as_json:
        found += [_item(None, module, "", {}, reason) for module, reason in hidden.items()]
        typer.echo(json.dumps(plain(found), indent=2))
        return
    for one in KINDS:
        items = [item for item in found if item["kind"] == one]
        if kind in (None, one):
            typer.echo(f"{one}{'' if items else ' (none yet)'}")
            for item in items:
                typer.echo(_entry(item))
    if hidden:
        typer.echo("hidden, because they cannot be imported")
        for module, reason in hidden.items():
            typer.echo(f"  {module}: {reason}")


def _items(kind: str) -> list[dict[str, Any]]:
    from featreg import registry

    if kind != "method":
        return [_item(kind, e.name, e.summary, e.parameters, e.unavailable) for e in registry.entries(kind)]
    from featreg.errors import FeatregError
    from featreg.pipeline.assembly import assemble
    from featreg.presets import PRESETS

    found = []
    for name, preset in sorted(PRESETS.items()):
        try:
            missing = [
                f"{role} {part.name}: {registry.entry(role, part.name).unavailable}"
                for role, part in preset.parts
                if registry.entry(role, part.name).unavailable
            ]
            found.append(_item(kind, name, preset.summary, assemble(name).parameters, "; ".join(missing)))
        except FeatregError as error:
            found.append(_item(kind, name, preset.summary, {}, str(error)))
    return found


def _item(kind: str | None, name: str, summary: str, parameters: Mapping[str, Any], unavailable: str) -> dict[str, Any]:
    return {
        "kind": kind,
        "name": name,
        "summary": summary,
        "parameters": dict(parameters),
        "available": not unavailable,
        "unavailable": unavailable,
    }


def _entry(item: Mapping[str, Any]) -> str:
    """Name and summary, then the parameters, then why it cannot be used."""
    pad = " " * 20
    lines = [f"  {item['name']:<17} {item['summary']}"]
    words = []
    for key, value in item["parameters"].items():
        if isinstance(value, Mapping):  # a method: the parts with their own parameters
            own = " ".join(f"{k}={_shown(v)}" for k, v in value.items() if k != "name")
            words.append(f"{key}: {value.get('name', '')} {own}".replace(":  ", ": "))
        else:
            words.append(f"{key}={_shown(value)}")
    parts = any(isinstance(value, Mapping) for value in item["parameters"].values())
    for text in words if parts else [" ".join(words)]:
        lines += _wrapped(text, pad)
    if item["unavailable"]:
        lines += _wrapped(f"not available here: {item['unavailable']}", pad)
    return "\n".join(lines)


def _wrapped(text: str, pad: str) -> list[str]:
    width = max(60, min(shutil.get_terminal_size().columns, 120))
    options = {"break_long_words": False, "break_on_hyphens": False}
    return textwrap.wrap(text, width, initial_indent=pad, subsequent_indent=f"{pad}  ", **options)  # type: ignore[arg-type]


def _shown(value: Any) -> str:
    return json.dumps(value) if isinstance(value, bool | list | tuple) or value is None else str(value)


def demo(
    out: Annotated[
        str, typer.Option("--out", metavar="DIR", help="Folder for images, pictures and results.")
    ] = "featreg-demo",
) -> None:
    """Try everything on a simulated pair.

    Simulates two SAR images with known truth, registers them, compares the method with two of OpenCV and draws the
    result.
    """
    folder = Path(out)
    check_folder(folder if folder.exists() else folder.absolute().parent, f"--out '{out}'")
    from featreg.cli.demo import demonstrate
    from featreg.warming import ready

    if not ready():
        typer.echo(f"{COMPILING} ...", err=True)
    made = demonstrate(folder, progress=progress)
    typer.echo("Two simulated SAR images of 600 x 600 pixels, 4 looks, turned by 6 degrees, scaled by 1.02:\n")
    typer.echo(made.table.to_markdown())
    typer.echo("Files:")
    for path, what in made.files:
        typer.echo(f"  {path!s:<36} {what}")
    reference, secondary, truth = (folder / name for name in ("reference.tif", "secondary.tif", "truth.json"))
    typer.echo("\nTry next:")
    typer.echo(f"  featreg match {reference} {secondary} --plot mine.png")
    typer.echo(f"  featreg compare {reference} {secondary} --methods sar-orb,sift --truth {truth}")
    if made.table.failed:
        raise typer.Exit(4)
    raise typer.Exit(0 if made.registration.status == "ok" else 3)


def doctor(as_json: Annotated[bool, typer.Option("--json", help="Print JSON for machines.")] = False) -> None:
    """Show what this installation is made of.

    Versions, cores and threads, compiled kernels, where OpenCV keeps what, plugins that cannot be used here and why,
    and extras that are not installed.
    """
    from featreg.cli.doctor import examine

    found = examine()
    if as_json:
        typer.echo(json.dumps(found, indent=2))
        return
    _section("versions", found["versions"])
    _section("threads", found["threads"])
    cached: Mapping[str, bool] = found["kernels"]["cached"]
    cold = [name for name, warm in cached.items() if not warm]
    state = f"{len(cached) - len(cold)} of {len(cached)} modules compiled, kept in {found['kernels']['folder']}"
    _section("kernels", {"": state})
    if cold:
        _section("", {"": f"compiled when first used: {', '.join(cold)}"})
    where = found["opencv"]
    homes = {home: [n for n, w in where.items() if w == home] for home in ("cv2", "cv2.xfeatures2d")}
    _section("OpenCV", {home: ", ".join(names) for home, names in homes.items() if names})
    _section("", {name: reason for name, reason in where.items() if reason not in homes})
    _section("plugins that cannot be used here", found["unavailable"] or {"": "none"})
    _section("plugins that cannot be imported", found["hidden_plugins"] or {"": "none"})
    extras = {
        name: f"missing {', '.join(e['missing'])}; install with: {e['install']}" if e["missing"] else "installed"
        for name, e in found["extras"].items()
    }
    _section("extras", extras or {"": "none declared"})


def _section(title: str, values: Mapping[str, Any]) -> None:
    if title:
        typer.echo(title)
    width = max((len(name) for name in values), default=0)
    columns = max(60, min(shutil.get_terminal_size().columns, 120))
    for name, value in values.items():
        head = f"  {name:<{width}}  " if name else "  "
        text = textwrap.fill(
            str(value), columns, initial_indent=head, subsequent_indent=" " * len(head), break_on_hyphens=False
        )
        typer.echo(text)
