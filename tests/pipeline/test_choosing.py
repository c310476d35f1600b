"""The choice of a method: the first that is trusted, and what is said of the others."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import featreg
from featreg.errors import ParameterError
from featreg.io import as_image
from featreg.matching import check_keywords, keypoints_of
from featreg.pipeline.assembly import assemble, assemble_all
from featreg.pipeline.choosing import first_trusted, in_order
from featreg.presets import PRESETS
from featreg.results.explaining import explain_registration
from featreg.sar.speckle import equivalent_looks
from featreg.simulate import SimulatedPair, sar_pair


def attempts(method: str) -> tuple[list[str], featreg.Registration]:
    """The methods that a choice of three tries, and its result, on stand-ins of which only `method` is trusted."""
    shape = (100, 100)
    xy = np.stack(np.meshgrid(np.linspace(5, 95, 8), np.linspace(5, 95, 8)), -1).reshape(-1, 2)
    good = featreg.fit(np.column_stack([xy, xy + 1]), model="affine", reference_shape=shape, secondary_shape=shape)
    few = featreg.fit(np.column_stack([xy, xy + 1])[::6], model="affine", reference_shape=shape, secondary_shape=shape)
    none = featreg.fit(np.zeros((0, 4)), model="affine", reference_shape=shape, secondary_shape=shape)
    assert (good.status, few.status, none.status) == ("ok", "unreliable", "unreliable")
    names = ["orb", "akaze", "brisk"]
    seen: list[str] = []

    def attempt(pipeline: featreg.Pipeline) -> featreg.Registration:
        seen.append(pipeline.name)
        result = good if pipeline.name == method else few if pipeline.name == "akaze" else none
        return replace(result, provenance={"method": pipeline.name}, timings={"match": 1.0})

    return seen, first_trusted("any", [assemble(name) for name in names], attempt)


def test_the_first_trusted_method_ends_the_search() -> None:
    seen, found = attempts("akaze")
    assert seen == ["orb", "akaze"]
    assert found.status == "ok"
    assert found.provenance["method"] == "akaze"
    assert found.provenance["choice"]["name"] == "any"
    assert [(one["method"], one["status"]) for one in found.provenance["choice"]["tried"]] == [
        ("orb", "unreliable"),
        ("akaze", "ok"),
    ]
    assert found.timings["match"] == 2.0
    assert "tried: orb, unreliable" in explain_registration(found)


def test_where_none_is_trusted_the_nearest_is_returned_and_all_are_named() -> None:
    seen, found = attempts("none of them")
    assert seen == ["orb", "akaze", "brisk"]
    assert found.status == "unreliable"
    assert found.provenance["method"] == "akaze"  # it has a model, the others none
    assert found.reason.startswith("none of orb, akaze, brisk is trusted; akaze: ")
    assert all(one["reason"] for one in found.provenance["choice"]["tried"])


def test_an_easy_pair_needs_the_first_method_only(pair: SimulatedPair, tmp_path: Path) -> None:
    first = PRESETS["auto"].methods[0]
    found = featreg.match(pair.reference, pair.secondary, method="auto")
    alone = featreg.match(pair.reference, pair.secondary, method=first)
    assert found.status == "ok"
    assert [one["method"] for one in found.provenance["choice"]["tried"]] == [first]
    np.testing.assert_array_equal(found.matches.secondary_xy, alone.matches.secondary_xy)
    found.to_json(tmp_path / "result.json")
    assert featreg.Registration.from_json(tmp_path / "result.json").provenance["choice"]["name"] == "auto"


def test_keywords_go_to_every_method_or_none() -> None:
    made = assemble_all("auto", model="similarity", n_features=700)
    assert [pipeline.name for pipeline in made] == list(PRESETS["auto"].methods)
    assert {pipeline.parameters["model"] for pipeline in made} == {"similarity"}
    check_keywords({"method": "auto", "refine": False})
    with pytest.raises(ParameterError, match=r"'auto' is a choice of .*fsc_threshold"):
        assemble_all("auto", fsc_threshold=2.0)
    with pytest.raises(ParameterError, match="choice of methods, no pipeline"):
        assemble("auto")
    with pytest.raises(ParameterError, match="common_rotation is for methods"):
        assemble_all("auto", common_rotation=False)


def test_a_choice_has_no_keypoints_of_its_own(pair: SimulatedPair) -> None:
    assert keypoints_of(pair.reference, method="auto") is None


def test_unlike_images_are_given_to_the_method_for_them_first() -> None:
    made = assemble_all("auto")
    alike = sar_pair((300, 300), looks=1, seed=1)
    few, many = sar_pair((300, 300), looks=1, seed=1), sar_pair((300, 300), looks=200, seed=1)
    ordered, probe = in_order(made, as_image(alike.reference), as_image(alike.secondary))
    assert [one.name for one in ordered] == list(PRESETS["auto"].methods)
    assert not probe["unlike"]
    ordered, probe = in_order(made, as_image(few.reference), as_image(many.secondary))
    assert probe["unlike"]
    assert PRESETS[ordered[0].name].for_unlike
    assert {one.name for one in ordered} == set(PRESETS["auto"].methods)


def test_two_images_without_speckle_are_alike() -> None:
    rng = np.random.default_rng(0)
    flat = [as_image((1000 + 1e-4 * rng.normal(size=(100, 100))).astype(np.float32)) for _ in range(2)]
    ordered, probe = in_order(assemble_all("auto"), *flat)
    assert probe == {"looks": [np.inf, np.inf], "unlike": False}
    assert [one.name for one in ordered] == list(PRESETS["auto"].methods)


def test_looks_of_speckle_without_texture() -> None:
    rng = np.random.default_rng(0)
    for looks in (1, 2, 4, 16):
        speckle = np.sqrt(rng.gamma(looks, 1 / looks, (200, 200))).astype(np.float32)
        # The lower fifth of windows of 25 samples lies a quarter below the mean variance.
        assert equivalent_looks(as_image(speckle)) == pytest.approx(1.35 * looks, rel=0.25)
    even = featreg.Image(np.full((50, 50), 7.0, np.float32), np.ones((50, 50), np.bool_))
    assert equivalent_looks(even) == np.inf
