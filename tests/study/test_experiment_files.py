"""Experiments as files: they come back as they were, and a mistake in one is a line that names the place."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

import featreg
from featreg import Experiment
from featreg.errors import InputError
from featreg.study.protocol import Protocol


def test_files_round_trip(tmp_path: Path) -> None:
    (tmp_path / "sub").mkdir()
    whole = Experiment(
        pairs=[
            {"name": 'a "port"', "reference": str(tmp_path / "a.tif"), "secondary": "b.tif", "truth": "identity"},
            ["c.tif", "d.tif", [[1.0, 0.0, 2.5], [0.0, 1.0, -3.0]]],
            ["e.tif", "f.tif"],
        ],
        methods=["sar-orb", {"method": "orb", "label": "strict", "fsc.threshold": 1.5, "filters": ["gms", "fsc"]}],
        parameters={"refine": False, "n_features": 2000},
        grid={"trust.least_inliers": [8, 12]},
        seeds=[0, 7],
        protocol=Protocol(threshold=2.0, time_limit=60.0, filters=("gms", "fsc"), refine=True, nodata=0.0),
        metrics=["ncm", "auc@3", "act.detect"],
        title="Ports at night: 50 % clouds",
    )
    for name in ("e.yaml", "sub/e.toml"):
        whole.to_file(tmp_path / name)
        back = Experiment.from_file(tmp_path / name)
        assert back.methods == whole.methods
        assert (back.protocol, back.seeds, back.metrics) == (whole.protocol, whole.seeds, whole.metrics)
        assert (back.grid, back.parameters, back.title) == (whole.grid, whole.parameters, whole.title)
        assert back.pairs[0] == whole.pairs[0] | {"secondary": back.pairs[0]["secondary"]}
        assert Path(back.pairs[0]["secondary"]).resolve() == Path("b.tif").resolve()
        assert back.pairs[1][2] == whole.pairs[1][2]
        back.to_file(tmp_path / "again.yaml")
        assert Path(Experiment.from_file(tmp_path / "again.yaml").pairs[2][0]).resolve() == Path("e.tif").resolve()


def test_an_array_cannot_stand_in_a_file(tmp_path: Path) -> None:
    image = np.zeros((20, 20), np.float32)
    with pytest.raises(InputError, match=r"pairs\[1\]\[1\] is a ndarray"):
        Experiment([(image, image)], ["orb"]).to_file(tmp_path / "e.yaml")
    assert list(tmp_path.iterdir()) == []


GOOD = "pairs: [[a.tif, b.tif]]\nmethods: [orb]\n"


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("pairs: [[a.tif, b.tif]]\nmethod: [orb]\n", "unknown key 'method', did you mean 'methods'"),
        ("methods: [orb]\n", "it has no pairs"),
        ("pairs: [[a.tif]]\nmethods: [orb]\n", r"pair 1 must be \(reference, secondary\)"),
        ("pairs: [{refrence: a, secondary: b}]\nmethods: [orb]\n", "pair 1: unknown key 'refrence', did you mean"),
        ("pairs: [{reference: a}]\nmethods: [orb]\n", "pair 1 has no secondary"),
        ("pairs: [{folder: nowhere}]\nmethods: [orb]\n", "nowhere' is not a folder"),
        ("pairs: [[a, b]]\nmethods: [3]\n", "method 1 must be a name or a mapping"),
        ("pairs: [[a, b]]\nmethods: orb\n", "methods must be a list"),
        (GOOD + "protocol: {treshold: 2}\n", "protocol: unknown key 'treshold', did you mean 'threshold'"),
        (GOOD + "protocol: {threshold: two}\n", "threshold must be a number of pixels > 0, got 'two'"),
        (GOOD + "protocol: {timing: 1}\n", "timing must be true or false"),
        (GOOD + "metrics: [ncmm]\n", "unknown metric 'ncmm', did you mean 'ncm'"),
        (GOOD + "grid: [1, 2]\n", "grid must be a mapping"),
        ("- 1\n- 2\n", "it must hold the keys"),
        ("pairs: [\n", "cannot be read"),
    ],
)
def test_a_mistake_in_a_file_is_one_line_that_names_the_place(text: str, why: str, tmp_path: Path) -> None:
    (tmp_path / "e.yaml").write_text(text)
    with pytest.raises(InputError, match=why) as caught:
        Experiment.from_file(tmp_path / "e.yaml")
    assert "e.yaml" in str(caught.value)
    assert "\n" not in str(caught.value)


BOMB = "".join(f"  x{i}: &x{i} [{', '.join([f'*x{i - 1}'] * 10)}]\n" for i in range(1, 12))


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ("parameters: &a {n_features: *a}", "an alias .* that holds itself"),
        ("grid:\n  n_features: [" + "[" * 3000, "nested more than 30 deep"),
        ("grid:\n  x0: &x0 [1, 2, 3, 4, 5, 6, 7, 8, 9, 10]\n" + BOMB, "aliases .* unfold to more than"),
        ("grid: {" + ", ".join(f"p{i}: [1, 2, 3, 4, 5, 6, 7, 8, 9, 10]" for i in range(9)) + "}", "1000000000 points"),
    ],
    ids=["recursive", "deep", "bomb", "grid"],
)  # fmt: skip
def test_a_file_that_would_never_end_is_refused_at_once(more: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "e.yaml"
    path.write_text(f"pairs: [[a.tif, b.tif]]\nmethods: [orb]\n{more}\n")
    start = time.perf_counter()
    with pytest.raises(featreg.FeatregError, match=words):
        Experiment.from_file(path).labelled()
    assert time.perf_counter() - start < 5


def test_shared_parameters_may_be_written_once(tmp_path: Path) -> None:
    path = tmp_path / "e.yaml"
    path.write_text(
        "pairs: [[a.tif, b.tif]]\nmethods:\n- {method: orb, n_features: &n 700}\n- {method: sift, n_features: *n}\n"
    )
    assert [m.keywords["n_features"] for m in Experiment.from_file(path).labelled().values()] == [700, 700]
