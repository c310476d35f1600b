"""What of the files' geolocation is used as prior, and that a wrong one can be left aside."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import featreg
from featreg.cli.main import main
from featreg.errors import InputError, ParameterError


def error_of(result: Any, pair: Any) -> float:
    points = np.array([[300.0, 300.0], [600.0, 300.0], [400.0, 600.0]])
    a = np.asarray(pair.truth, np.float64)
    return float(np.abs(result.model(points) - (points @ a[:2, :2].T + a[:2, 2])).max())


def test_prior_none_is_a_match_of_the_overviews(located_pair: Any) -> None:
    files = located_pair.reference, located_pair.secondary
    plain = featreg.match(*files, block=300, prior="none", workers=1)
    assert plain.provenance["prior"]["source"].startswith("coarse match of overviews")
    located = featreg.match(*files, block=300, prior="geolocation", workers=1)
    assert located.provenance["prior"]["source"].startswith("geolocation")
    for result in (plain, located):
        assert result.status == "ok"
        assert error_of(result, located_pair) < 1.0
    whole = featreg.match(*files, prior="none")
    assert whole.status == "ok"


def test_an_earlier_result_is_searched_around(located_pair: Any, tmp_path: Path) -> None:
    files = str(located_pair.reference), str(located_pair.secondary)
    featreg.match(*files, n_features=500).to_json(tmp_path / "r.json")
    result = featreg.match(*files, n_features=500, prior=tmp_path / "r.json")
    assert result.status == "ok"
    assert main(["match", *files, "--n-features", "500", "--prior", str(tmp_path / "r.json")]) == 0


def test_contradictions_are_named(located_pair: Any, tmp_path: Path) -> None:
    files = located_pair.reference, located_pair.secondary
    with pytest.raises(ParameterError, match="neither 'none' nor 'geolocation'"):
        featreg.match(*files, prior="nothing")
    with pytest.raises(ParameterError, match="leave one of them out"):
        featreg.match(*files, prior="none", initial=np.eye(3), search_radius=9)
    with pytest.raises(ParameterError, match="height does nothing here: prior='none'"):
        featreg.match(*files, prior="none", height=3.0)
    bare = np.random.default_rng(0).random((200, 200))
    for block in (None, 100):
        with pytest.raises(InputError, match="nothing says where the image lies"):
            featreg.match(bare, bare, prior="geolocation", block=block)
