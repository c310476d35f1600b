"""Scenes without geolocation: overviews or a model known beforehand say where the blocks lie."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import featreg
from featreg.io import as_image
from made.scene_results import BLOCK, same_bits, scene_error


def test_without_geolocation_overviews_give_the_prior(located_pair: Any) -> None:
    a, b = as_image(located_pair.reference).pixels, as_image(located_pair.secondary).pixels
    got = featreg.match(a, b, **BLOCK, nodata=0)
    assert got.status == "ok", got.reason
    assert "overviews" in got.provenance["prior"]["source"]
    assert scene_error(got, located_pair.truth) < 0.05
    again = featreg.match(a, b, block=200, nodata=0, executor="processes", workers=2)
    assert same_bits(got, again)


def test_without_geolocation_unrelated_images_are_unreliable() -> None:
    a, b = (np.random.default_rng(k).gamma(1.0, 1.0, (500, 500)).astype(np.float32) for k in (0, 1))
    got = featreg.match(a, b, **BLOCK)
    assert got.status == "unreliable"
    assert "overviews" in got.reason


def test_a_known_model_is_the_prior(located_pair: Any) -> None:
    near = located_pair.truth + np.array([[0, 0, 5.0], [0, 0, -4.0]])
    got = featreg.match(located_pair.reference, located_pair.secondary, **BLOCK, initial=near, search_radius=12)
    assert got.status == "ok", got.reason
    assert got.provenance["prior"]["source"].startswith("initial model")
    assert scene_error(got, located_pair.truth) < 0.05
    wrong = located_pair.truth + np.array([[0, 0, 60.0], [0, 0, 0]])
    lost = featreg.match(located_pair.reference, located_pair.secondary, **BLOCK, initial=wrong, search_radius=12)
    assert lost.status == "unreliable"


def test_large_images_are_worked_on_in_blocks_by_themselves(monkeypatch: pytest.MonkeyPatch, located_pair: Any) -> None:
    monkeypatch.setattr("featreg.matching.MOST_PIXELS", 500_000)
    assert "blocks" in featreg.match(located_pair.reference, located_pair.secondary, workers=1).provenance
    whole = featreg.match(located_pair.reference, located_pair.secondary, block=False)
    assert "blocks" not in whole.provenance
