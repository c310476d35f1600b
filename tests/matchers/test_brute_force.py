"""Brute-force nearest neighbours against numpy, for both norms, with ties, ratio and mutual pairs."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg import registry
from featreg.errors import ParameterError
from featreg.runtime.threads import limited_threads
from featreg.types import Features


def features(descriptors: NDArray[Any] | None, n: int | None = None) -> Features:
    n = (0 if descriptors is None else len(descriptors)) if n is None else n
    norm = "hamming" if descriptors is not None and descriptors.dtype == np.uint8 else "l2"
    return Features(np.zeros((n, 2)), np.ones(n), np.zeros(n), np.ones(n), np.zeros(n, np.int64), descriptors, norm)


def packed(n: int, length: int, seed: int) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 256, (n, length)).astype(np.uint8)


def hamming(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> NDArray[np.float64]:
    return np.asarray(np.unpackbits(a[:, None] ^ b[None], axis=2).sum(axis=2), np.float64)


def euclidean(a: NDArray[Any], b: NDArray[Any]) -> NDArray[np.float64]:
    return np.asarray(np.sqrt(((a[:, None].astype(np.float64) - b[None]) ** 2).sum(axis=2)))


def expected(distance: NDArray[np.float64], mutual: bool, ratio: float) -> NDArray[np.int64]:
    """argmin takes the first of equals, which is the rule for ties."""
    nearest = distance.argmin(axis=1)
    rows = np.arange(len(distance))
    keep = distance.argmin(axis=0)[nearest] == rows if mutual else np.ones(len(rows), np.bool_)
    if ratio < 1 and distance.shape[1] > 1:
        two = np.sort(distance, axis=1)[:, :2]
        keep &= two[:, 0] < ratio * two[:, 1]
    return np.asarray(np.column_stack([rows, nearest])[keep], np.int64)


def pairs(a: Any, b: Any, **parameters: Any) -> tuple[Any, Any]:
    return registry.create("nearest", "brute-force", **parameters).match_features(features(a), features(b))


modes = pytest.mark.parametrize(("mutual", "ratio"), [(False, 1.0), (True, 1.0), (False, 0.9), (True, 0.95)])


@pytest.fixture(params=[False, True], ids=["counted", "sliced"])
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both ways of comparing bits, whichever is quicker on this processor."""
    module = importlib.import_module(registry.entry("nearest", "brute-force").module)
    monkeypatch.setattr(module, "_slices_are_quicker", lambda: request.param)


@modes
@pytest.mark.usefixtures("way")
@pytest.mark.parametrize("length", [1, 16, 32, 61, 64, 96, 97])  # above 96 bytes never in slices
def test_hamming_equals_numpy(length: int, mutual: bool, ratio: float) -> None:
    a, b = packed(97, length, 0), packed(1100, length, 1)  # more columns than one block
    b[:50] = a[:50] ^ (packed(50, length, 2) & packed(50, length, 3) & packed(50, length, 4))
    distance = hamming(a, b)
    found, score = pairs(a, b, mutual=mutual, ratio=ratio)
    np.testing.assert_array_equal(found, expected(distance, mutual, ratio))
    np.testing.assert_allclose(score, 1 - distance[found[:, 0], found[:, 1]] / (8 * length))
    assert found.dtype == np.int64


@pytest.mark.usefixtures("way")
@pytest.mark.parametrize("count", [1, 63, 64, 65, 512, 513])
def test_hamming_of_any_number_of_descriptors(count: int) -> None:
    """Nothing beside the last descriptor of a word or a block is found, all ones and zeros among them."""
    a, b = packed(40, 32, 0), packed(count, 32, 1)
    a[0], a[1], b[-1] = 0, 255, 255 * (count % 2)
    distance = hamming(a, b)
    for one, two, between in ((a, b, distance), (b, a, distance.T)):
        found, score = pairs(one, two, mutual=False, ratio=1.0)
        np.testing.assert_array_equal(found, expected(between, mutual=False, ratio=1))
        np.testing.assert_allclose(score, 1 - between.min(axis=1) / 256)


@modes
def test_l2_equals_numpy_for_whole_numbers(mutual: bool, ratio: float) -> None:
    """Descriptors of whole numbers, as SIFT's, are compared without rounding."""
    rng = np.random.default_rng(0)
    a, b = (rng.integers(0, 100, (n, 128)).astype(np.float32) for n in (700, 300))
    b[:100] = a[:100] + rng.integers(-3, 4, (100, 128))
    found, score = pairs(a, b, mutual=mutual, ratio=ratio)
    distance = euclidean(a, b)
    np.testing.assert_array_equal(found, expected(distance, mutual, ratio))
    np.testing.assert_allclose(score, 1 / (1 + distance[found[:, 0], found[:, 1]]), rtol=1e-5)


def test_l2_of_real_numbers_finds_the_nearest_to_rounding() -> None:
    rng = np.random.default_rng(0)
    a, b = (rng.normal(size=(n, 64)).astype(np.float32) for n in (300, 200))
    found, _ = pairs(a, b, mutual=False)
    distance = euclidean(a, b)
    np.testing.assert_allclose(distance[found[:, 0], found[:, 1]], distance.min(axis=1), atol=1e-3)


def test_l2_of_descriptors_far_from_the_origin() -> None:
    """|a|^2 + |b|^2 - 2ab must not lose the small differences of long vectors."""
    rng = np.random.default_rng(0)
    a = (1000 + rng.normal(size=(100, 32))).astype(np.float32)
    b = a[::-1] + rng.normal(0, 0.05, (100, 32)).astype(np.float32)
    found, score = pairs(a, b)
    assert (found[:, 0] + found[:, 1] == 99).mean() > 0.99
    assert len(found) > 95
    np.testing.assert_allclose(1 / score - 1, euclidean(a, b)[found[:, 0], found[:, 1]], rtol=0.05)


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_ties_go_to_the_lower_index(dtype: Any) -> None:
    one = np.arange(32).astype(dtype)[None]
    a, b = np.repeat(one, 3, axis=0), np.repeat(one, 5, axis=0)
    assert pairs(a, b, mutual=False)[0].tolist() == [[0, 0], [1, 0], [2, 0]]
    assert pairs(a, b, mutual=True)[0].tolist() == [[0, 0]]


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_mutual_pairs_are_the_same_from_both_sides(dtype: Any) -> None:
    rng = np.random.default_rng(0)
    a, b = (rng.integers(0, 256, (n, 32)).astype(dtype) for n in (80, 120))
    there, back = pairs(a, b)[0], pairs(b, a)[0]
    assert sorted(map(tuple, there)) == sorted((i, j) for j, i in back)


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_ratio_drops_what_has_a_rival(dtype: Any) -> None:
    a = np.zeros((1, 32), dtype)
    near, rival, far = a.copy(), a.copy(), np.full((1, 32), 200, dtype)
    near[0, 0], rival[0, 0] = 1, 1
    assert len(pairs(a, np.concatenate([near, rival]), ratio=0.8)[0]) == 0
    assert len(pairs(a, np.concatenate([near, far]), ratio=0.8)[0]) == 1
    assert len(pairs(a, near, ratio=0.8)[0]) == 1  # no rival at all


@pytest.mark.parametrize(("n", "m"), [(0, 0), (0, 4), (4, 0)])
@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_nothing_gives_an_empty_result(n: int, m: int, dtype: Any) -> None:
    found, score = pairs(np.zeros((n, 32), dtype), np.zeros((m, 32), dtype))
    assert found.shape == (0, 2)
    assert found.dtype == np.int64
    assert score.shape == (0,)


@pytest.mark.parametrize(
    ("a", "b"),
    [
        (features(packed(3, 32, 0)), features(np.zeros((3, 32), np.float32))),
        (features(packed(3, 32, 0)), features(packed(3, 64, 0))),
        (features(np.zeros((3, 8), np.float32)), features(np.zeros((3, 9), np.float32))),
        (features(None, 3), features(packed(3, 32, 0))),
        (features(None, 3), features(None, 3)),
    ],
)
def test_descriptors_that_do_not_compare_are_refused(a: Features, b: Features) -> None:
    with pytest.raises(ParameterError, match="one kind"):
        registry.create("nearest", "brute-force").match_features(a, b)


@pytest.mark.parametrize("ratio", [0.0, -1.0, 1.5, float("nan")])
def test_an_impossible_ratio_is_refused(ratio: float) -> None:
    with pytest.raises(ParameterError, match="ratio"):
        registry.create("nearest", "brute-force", ratio=ratio)


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_the_same_pairs_whatever_the_parts_and_threads(dtype: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """With ties between rows of different parts."""
    rng = np.random.default_rng(0)
    a, b = rng.integers(0, 4, (700, 8)).astype(dtype), rng.integers(0, 4, (500, 8)).astype(dtype)
    matcher = registry.create("nearest", "brute-force", mutual=True, ratio=0.95)
    whole, score = matcher.match_features(features(a), features(b))
    assert len(whole) > 20
    monkeypatch.setattr("featreg.matchers.brute_force.LARGE", 1)
    for threads in (1, 2, 3):
        with limited_threads(threads):
            pairs, other = matcher.match_features(features(a), features(b))
        np.testing.assert_array_equal(pairs, whole)
        np.testing.assert_array_equal(other, score)
