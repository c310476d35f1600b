"""Presets: each registers a pair whose warp is known; one's own are methods like ours."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import featreg
from featreg import registry, warming
from featreg.cli.main import main
from featreg.errors import DuplicatePluginError, ParameterError, PluginError
from featreg.presets import PRESETS
from featreg.simulate import SimulatedPair


@pytest.mark.parametrize("name", ["sar-sift", "sar-sift-paper", "bfsift", "bfsift-paper", "s-gof", "m-gof"])
def test_a_known_warp_is_found(pair: SimulatedPair, name: str) -> None:
    found = featreg.match(pair.reference, pair.secondary, method=name, n_features=1500, refine=False)
    assert found.status == "ok"
    assert found.model
    points = np.array([[x, y] for x in (20.0, 150.0, 280.0) for y in (20.0, 150.0, 280.0)])
    error = found.model(points) - (points @ pair.truth[:, :2].T + pair.truth[:, 2])
    assert np.hypot(*error.T).max() < 1.0


@pytest.fixture
def own() -> Iterator[str]:
    """The name of a preset of somebody else's, which is gone afterwards."""
    yield "somebodys-orb"
    PRESETS.pop("somebodys-orb", None)


def test_a_preset_of_ones_own_is_a_method(pair: SimulatedPair, own: str, capsys: pytest.CaptureFixture[str]) -> None:
    featreg.register_preset(own, dataclasses.replace(PRESETS["sar-orb"], summary="mine", model="similarity"))
    assert own in featreg.available("method")
    found = featreg.match(pair.reference, pair.secondary, method=own, n_features=1500, refine=False)
    assert found.status == "ok"
    assert found.provenance["method"] == own
    assert found.provenance["parameters"]["model"] == "similarity"
    assert main(["list", own]) == 0
    assert "mine" in capsys.readouterr().out


def test_a_preset_is_registered_once_or_again_as_it_was(own: str) -> None:
    mine = dataclasses.replace(PRESETS["sar-orb"], summary="mine")
    featreg.register_preset(own, mine)
    featreg.register_preset(own, dataclasses.replace(mine))
    with pytest.raises(DuplicatePluginError, match=f"another method is called '{own}': mine"):
        featreg.register_preset(own, dataclasses.replace(mine, summary="other"))
    with pytest.raises(DuplicatePluginError, match="another method is called 'sar-orb'"):
        featreg.register_preset("sar-orb", mine)


def changed(**fields: Any) -> featreg.Preset:
    return dataclasses.replace(PRESETS["sar-orb"], **fields)


@pytest.mark.parametrize(("given", "words"), [
    ({"trust": {"uncertainty": 0.5}}, "trust has no parameter 'uncertainty', did you mean 'uncertainty_px'"),
    ({"refinement": {"serch": 9}}, "refine has no parameter 'serch', did you mean 'search'"),
])  # fmt: skip
def test_a_misspelt_limit_of_a_preset_is_told(pair: SimulatedPair, own: str, given: Any, words: str) -> None:
    featreg.register_preset(own, changed(**given))
    with pytest.raises(ParameterError, match=words):
        featreg.match(pair.reference, pair.secondary, method=own)


def test_a_list_of_filters_is_as_good_as_a_tuple(own: str) -> None:
    featreg.register_preset(own, changed(filters=[featreg.Part("fsc")]))
    assert PRESETS[own].filters == (featreg.Part("fsc"),)


@pytest.mark.parametrize(
    ("name", "preset", "words"),
    [
        ("My Method", PRESETS["sar-orb"], "small letters, digits and hyphens, got 'My Method'"),
        ("mine", {"detector": "orb"}, "must be a featreg.Preset, got dict"),
        ("mine", featreg.Preset("nothing"), "needs a matcher, or a detector and a nearest"),
        ("mine", featreg.Preset("half", detector=featreg.Part("orb")), "needs a matcher, or a detector and a nearest"),
        ("mine", featreg.Preset("words", matcher="patch-grid"), "must be featreg.Part, got 'patch-grid'"),  # type: ignore[arg-type]
        ("mine", changed(filters=featreg.Part("gms")), "filters must be a tuple, got Part(name='gms'"),
        ("mine", featreg.Preset("letters", methods="sar-orb"), "methods must be a tuple, got 'sar-orb'"),  # type: ignore[arg-type]
        (
            "mine",
            featreg.Preset("itself", methods=("mine",)),
            "is a choice of methods and cannot have the choice 'mine'",
        ),
        ("mine", featreg.Preset("nested", methods=("auto",)), "cannot have the choice 'auto' in it"),
        ("mine", changed(methods=("sift",)), "is a choice of methods and cannot have a detector of its own"),
        ("mine", changed(matcher=featreg.Part("patch-grid")), "has a matcher, beside which a detector does nothing"),
        ("mine", changed(locate="no"), "locate must be True or False, got 'no'"),
        (
            "mine",
            changed(pixels_per_feature="many"),
            "pixels_per_feature must be a finite number from 0 on, got 'many'",
        ),
        ("mine", changed(pixels_per_feature=True), "pixels_per_feature must be a finite number from 0 on, got True"),
        ("mine", changed(pixels_per_feature=math.nan), "pixels_per_feature must be a finite number from 0 on, got nan"),
        ("mine", changed(trust=[0.5]), "trust must be a mapping, got [0.5]"),
        ("mine", changed(summary=None), "summary must be a line of text, got None"),
        (
            "mine",
            changed(nearest=featreg.Part("brute-force", ["ratio"])),  # type: ignore[arg-type]
            "parameters of 'brute-force' must be a mapping",
        ),
    ],
)
def test_what_is_no_method_is_refused(name: str, preset: Any, words: str) -> None:
    with pytest.raises(PluginError, match=re.escape(words)):
        featreg.register_preset(name, preset)
    assert name not in PRESETS


def test_a_module_that_fails_after_registering_a_preset_leaves_none(own: str) -> None:
    def load() -> None:
        featreg.register_preset(own, PRESETS["sar-orb"])
        raise ImportError("no such library")

    registry._import("somebodys.presets", load)
    try:
        assert own not in PRESETS
        assert "no such library" in registry.broken()["somebodys.presets"]
    finally:
        del registry._broken["somebodys.presets"]


def test_a_preset_whose_part_is_missing_does_not_keep_the_others_from_warming_up(own: str) -> None:
    before = list(warming._methods())
    featreg.register_preset(own, changed(detector=featreg.Part("no-such")))
    assert list(warming._methods()) == before
