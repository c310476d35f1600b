"""The published schemas hold for every kind of result and refuse others; as a script, this writes the page's tables."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest

import featreg
from featreg.cli.main import main
from featreg.results import json_file
from featreg.results.registration import Registration
from featreg.simulate import SimulatedPair, sar_series

PAGE = Path(__file__).parents[2] / "docs" / "results.md"
SCHEMAS = {
    "registration": ("featreg.results", "registration.schema.json"),
    "stack": ("featreg.stacks", "stack.schema.json"),
    "focus": ("featreg.focusing", "focus.schema.json"),
}


def schema(name: str) -> dict[str, Any]:
    package, file = SCHEMAS[name]
    loaded: dict[str, Any] = json.loads(files(package).joinpath(file).read_text(encoding="utf-8"))
    return loaded


def check(name: str, path: Path) -> dict[str, Any]:
    """The content of a file, which must hold to a schema."""
    content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    jsonschema.validate(content, schema(name), jsonschema.Draft202012Validator)
    return content


def whole(pair: SimulatedPair) -> Registration:
    return featreg.match(pair.reference, pair.secondary, n_features=1500)


def blocks(pair: SimulatedPair) -> Registration:
    return featreg.match(pair.reference, pair.secondary, block=150, workers=1)


def failed(pair: SimulatedPair) -> Registration:
    noise = np.random.default_rng(0).gamma(1, 1, (300, 300)).astype(np.float32)
    return featreg.match(pair.reference, noise, method="sar-orb")


def rigid(pair: SimulatedPair) -> Registration:
    return featreg.match(pair.reference, pair.reference[::-1, ::-1].copy(), method="sar-orb", model="rigid")


def fitted(pair: SimulatedPair) -> Registration:
    xy = np.random.default_rng(0).uniform(0, 299, (60, 2))
    return featreg.fit(np.column_stack([xy, xy @ pair.truth[:, :2].T + pair.truth[:, 2]]), model="polynomial2")


@pytest.mark.parametrize("make", [whole, blocks, failed, rigid, fitted], ids=lambda make: make.__name__)
def test_registrations_hold_to_their_schema(
    make: Callable[[SimulatedPair], Registration], pair: SimulatedPair, tmp_path: Path
) -> None:
    reg = make(pair)
    reg.to_json(tmp_path / "result.json")
    content = check("registration", tmp_path / "result.json")
    assert (content["model"] is None) == (make is failed)
    assert (content["blocks"]["total"] > 0) == (make is blocks)
    if make is rigid:
        assert content["model"]["rotation_deg_se"] is not None


def test_tie_points_in_a_file_beside_it_hold_too(
    pair: SimulatedPair, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(json_file, "MAX_ROWS", 100)
    whole(pair).to_json(tmp_path / "many.json")
    assert check("registration", tmp_path / "many.json")["tie_points"]["file"] == "many.tie_points.parquet"


@pytest.mark.parametrize(
    "damage",
    [
        lambda d: d.pop("gates"),
        lambda d: d.update(schema_version=2),
        lambda d: d.update(status="perhaps"),
        lambda d: d["model"].pop("type"),
        lambda d: d.update(model=None),
        lambda d: d["gates"]["inliers"].pop("passed"),
        lambda d: d["tie_points"].pop("rows"),
        lambda d: d["tie_points"]["columns"].append("colour"),
        lambda d: d.update(more=1),
    ],
)
def test_what_is_no_result_is_refused(damage: Callable[[dict[str, Any]], object], good: dict[str, Any]) -> None:
    content = copy.deepcopy(good)
    damage(content)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(content, schema("registration"), jsonschema.Draft202012Validator)


@pytest.fixture(scope="module")
def good(pair: SimulatedPair, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    path = tmp_path_factory.mktemp("good") / "result.json"
    whole(pair).to_json(path)
    return check("registration", path)


def test_a_stack_holds_to_its_schema(tmp_path: Path) -> None:
    series = sar_series(4, (160, 160), looks=8, seed=2)
    images = [*series.images, np.random.default_rng(0).gamma(1, 1, (160, 160)).astype(np.float32)]
    stack = featreg.register_stack(images, model="rigid")
    assert stack.status[-1] == "left out"
    stack.to_json(tmp_path / "stack.json")
    assert check("stack", tmp_path / "stack.json")["models"][-1] is None


def test_a_displacement_field_from_a_result_keeps_the_result_whole(pair: SimulatedPair, tmp_path: Path) -> None:
    """A field is a GeoTIFF, not JSON; the result from which it starts stays a valid one."""
    reg = whole(pair)
    reg.to_json(tmp_path / "result.json")
    field = featreg.offsets(pair.reference, pair.secondary, step=32, initial=str(tmp_path / "result.json"))
    assert (field.reason == 0).any()
    check("registration", tmp_path / "result.json")


def test_a_focus_holds_to_its_schema(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    speckle = (rng.normal(size=(64, 64)) + 1j * rng.normal(size=(64, 64))).astype(np.complex64)
    np.save(tmp_path / "image.npy", speckle)
    arguments = [str(tmp_path / "image.npy"), "-o", str(tmp_path / "out.npy"), "--json", str(tmp_path / "focus.json")]
    assert main(["focus", *arguments]) in (0, 3)
    check("focus", tmp_path / "focus.json")


@pytest.mark.parametrize("name", SCHEMAS)
def test_schemas_are_schemas_and_every_field_has_words(name: str) -> None:
    jsonschema.Draft202012Validator.check_schema(schema(name))

    def described(part: dict[str, Any]) -> None:
        for key, value in part.get("properties", {}).items():
            assert value.get("description", "").endswith("."), key
            described(value)

    described(schema(name))
    for part in schema(name)["$defs"].values():
        described(part)


# The page


def kinds(value: dict[str, Any]) -> str:
    """What a value may be, in a word or two."""
    if "const" in value:
        return f"`{json.dumps(value['const'])}`"
    if "enum" in value:
        return ", ".join(f"`{one}`" for one in value["enum"])
    if "$ref" in value:
        return str(value["$ref"]).rpartition("/")[2].replace("_", " ")
    if "anyOf" in value:
        return " or ".join(kinds(one) for one in value["anyOf"])
    given = value["type"]
    return given if isinstance(given, str) else " or ".join(given)


def table(part: dict[str, Any]) -> str:
    required = part.get("required", [])
    rows = ["| field | type | meaning |", "| --- | --- | --- |"]
    for name, value in part["properties"].items():
        mark = "" if name in required or not required else ", where known"
        rows.append(f"| `{name}` | {kinds(value)}{mark} | {value['description']} |")
    return "\n".join(rows)


def sections() -> dict[str, str]:
    found = {name: table(schema(name)) for name in SCHEMAS}
    registration = schema("registration")["$defs"]
    found |= {name: table(registration[name]) for name in ("gate", "image", "model", "searched", "tie_points")}
    found["pair"] = table(schema("stack")["$defs"]["pair"])
    return found


def written(page: str) -> str:
    for name, text in sections().items():
        start, end = f"<!-- {name} -->", f"<!-- end of {name} -->"
        assert page.count(start) == page.count(end) == 1, name
        page = page.partition(start)[0] + f"{start}\n{text}\n{end}" + page.partition(end)[2]
    return page


def test_the_page_says_what_the_schemas_say() -> None:
    page = PAGE.read_text(encoding="utf-8")
    assert page == written(page), f"python {Path(__file__).name} writes the tables anew"


if __name__ == "__main__":
    PAGE.write_text(written(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
