"""The maximum index map's descriptor: its cells against their formulas, turned images, nodata."""

from __future__ import annotations

import math
from collections.abc import Callable
from statistics import NormalDist
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg import registry
from featreg.errors import ParameterError
from featreg.io import as_image
from featreg.sar.gradients.log_gabor import LogGabor
from featreg.sar.gradients.phase_congruency import STEPS, Congruency, bytes_of, congruency_maps
from featreg.sar.keypoints import index_map
from featreg.sar.keypoints.index_map import Cells, cell_list, level_bits, places_of, turned_histograms, turned_triples
from featreg.types import Features, Image
from made.keypoints import at

Texture = Callable[..., NDArray[np.float32]]


def describe(picture: Image, features: Features, **parameters: Any) -> Features:
    return registry.create("descriptor", "max-index-map", **parameters).describe_features(picture, features)


def alike(a: Features, b: Features) -> NDArray[np.float64]:
    """The share of equal bits of each pair of descriptors, from 0 for as many as by chance to 1 for all."""
    assert a.descriptors is not None
    assert b.descriptors is not None
    bits = [np.unpackbits(f.descriptors, axis=1).astype(np.int64) for f in (a, b)]  # type: ignore[arg-type]
    different = (bits[0] != bits[1]).mean(axis=1)
    chance = (bits[0][:-1] != bits[1][1:]).mean()
    return np.asarray(1 - different / chance)


@pytest.mark.parametrize("reindex", ["angle", "dominant"])
@pytest.mark.parametrize("soft", [True, False])
def test_turning_image_and_keypoint_by_a_quarter_keeps_the_descriptor(
    sar_texture: Texture, reindex: str, soft: bool
) -> None:
    amplitude = sar_texture(220, 220)
    xy = np.random.default_rng(0).integers(45, 175, (40, 2)).astype(np.float64)
    turned_xy = np.column_stack([xy[:, 1], 219 - xy[:, 0]])
    angles = np.random.default_rng(1).integers(0, 24, 40) * math.pi / 12
    options: dict[str, Any] = {"reindex": reindex} if soft else {"reindex": reindex, "soft": False, "grid": 7}
    for angle in (0.0, 0.3, angles):
        a = describe(as_image(amplitude), at(xy, angle=angle), **options)
        b = describe(as_image(np.rot90(amplitude)), at(turned_xy, angle=angle + math.pi / 2), **options)
        wrong = describe(as_image(np.rot90(amplitude)), at(turned_xy, angle=angle), **options)
        if soft:
            assert np.median(alike(a, b)) > 0.8
            assert np.median(alike(a, wrong)) < 0.2
        else:
            one, *others = (np.asarray(f.descriptors, np.float32) for f in (a, b, wrong))
            same, other = (np.einsum("ij,ij->i", one, rows) for rows in others)
            assert np.median(same) > np.median(other) + 0.05
            assert np.median(same) > 0.9


def test_turning_by_twenty_degrees_keeps_most_of_the_descriptor(sar_texture: Texture) -> None:
    cv2 = pytest.importorskip("cv2")
    amplitude = cv2.GaussianBlur(sar_texture(260, 260), (0, 0), 1.2)
    matrix = cv2.getRotationMatrix2D((129.5, 129.5), 20.0, 1.0)  # counter-clockwise as seen
    turned = cv2.warpAffine(amplitude, matrix, (260, 260), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    xy = np.random.default_rng(0).integers(80, 180, (60, 2)).astype(np.float64)
    there = xy @ matrix[:, :2].T + matrix[:, 2]
    before = describe(as_image(amplitude), at(xy))
    after = describe(as_image(np.maximum(turned, 0)), at(there, angle=math.radians(20)))
    assert np.median(alike(before, after)) > 0.6
    pairs, _ = registry.create("nearest", "brute-force").match_features(before, after)
    assert (pairs[:, 0] == pairs[:, 1]).mean() > 0.95


@pytest.mark.parametrize("shape", [(41, 50), (96, 33)])
@pytest.mark.parametrize("cells", [Cells(7.0), Cells(9.0, power=0.8, centred=False), Cells(8.0, False), Cells(3.0)])
def test_cells_are_the_sums_of_their_formulas(
    sar_texture: Texture, monkeypatch: pytest.MonkeyPatch, shape: tuple[int, int], cells: Cells
) -> None:
    """Against sums over every block one by one, with nodata, in strips that meet inside the image."""
    from scipy import ndimage

    monkeypatch.setattr(index_map, "STRIP", 7)
    bank, congruency = LogGabor(2, 4, 6.0), Congruency()
    mask = np.ones(shape, np.bool_)
    mask[:20, :12] = False
    picture = as_image(sar_texture(*shape), mask=mask)
    found = cell_list(picture, bank, congruency, cells)
    largest, _, index, valid = congruency_maps(picture, bank, congruency)
    y, x = np.mgrid[: shape[0], : shape[1]]
    seen = ndimage.minimum_filter(valid, 13, mode="constant", cval=1)  # six pixels more than is masked
    weight = np.maximum(bytes_of(largest, valid, 0.95), 1) * seen
    phi = index * (2 * math.pi / STEPS)
    if cells.soft:
        lanes = [weight * 1.0, weight * np.cos(phi), weight * np.sin(phi)]
    else:
        lanes = [weight * (np.floor(index.astype(int) * 4 / STEPS + 0.5) % 4 == k) for k in range(4)]
    height, width = (shape[0] + 1) // 2, (shape[1] + 1) // 2
    blocks = np.zeros((len(lanes) + 1, height, width))
    for plane, lane in zip(blocks, [*lanes, seen], strict=True):
        np.add.at(plane, (y // 2, x // 2), lane)
    taps = np.array(cells.taps)
    sums = np.zeros_like(blocks)
    for row in range(height):
        for column in range(width):
            for i, first in enumerate(taps):
                for j, second in enumerate(taps):
                    u, v = row + i - len(taps) // 2, column + j - len(taps) // 2
                    if 0 <= u < height and 0 <= v < width:
                        sums[:, row, column] += first * second * blocks[:, u, v]
    known = sums[-1] >= 2 * taps.sum() ** 2
    every = weight[::3, ::3].ravel() > 0
    average = np.array([lane[::3, ::3].ravel()[every].mean() for lane in lanes])
    votes = sums[:-1] / np.maximum(sums[-1], 1)

    def compressed(v: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(v * np.maximum(v[0], 1e-9) ** (cells.power - 1) if cells.soft else v**cells.power)

    wanted = compressed(votes) - (compressed(average)[:, None, None] if cells.centred else 0)
    assert found.shape == (height * width + 1, len(lanes) + 1)
    assert not found[-1].any()
    assert 0 < known.mean() < 1
    np.testing.assert_array_equal(found[:-1, -1], known.ravel())
    np.testing.assert_allclose(found[:-1, :-1], (wanted * known).reshape(len(lanes), -1).T, atol=2e-3 * votes.max())


@pytest.mark.parametrize("side", [6.0, 8.0])
def test_cells_are_placed_around_the_point_and_turn_with_it(side: float) -> None:
    cells = Cells(side)
    shape, width = (99, 120), 60
    xy = np.array([[60.2, 50.7], [60.2, 50.7], [1.0, 97.0]])
    angle = np.array([0.0, math.radians(30), 0.0])
    place = places_of(cells, shape, xy, angle, 3)
    row, column = np.divmod(place, width)
    # A cell of even many blocks ends before the two pixels of its own.
    middle = np.stack([2 * column, 2 * row], -1) + (0.5 if len(cells.taps) % 2 else -0.5)
    step = np.array([-side, 0.0, side])
    offset = np.stack(np.meshgrid(step, step), -1).reshape(-1, 2)
    back = np.array([[math.cos(angle[1]), math.sin(angle[1])], [-math.sin(angle[1]), math.cos(angle[1])]])
    for i, turned in enumerate((offset, offset @ back.T)):
        assert np.abs(middle[i] - xy[i] - turned).max() <= 1 + 1e-5
    outside = (xy[2] + offset < 0).any(axis=1) | (xy[2] + offset > [120, 99]).any(axis=1)
    assert (place[2][outside] == 50 * width).all()
    assert (place[2][~outside] < 50 * width).all()


def test_a_triple_turns_as_its_directions_do() -> None:
    phi, turn = np.array([0.2, 1.1, 2.5]), np.array([0.0, 0.7])
    listed = np.zeros((4, 4), np.float32)
    listed[:3] = np.column_stack([np.ones(3), np.cos(2 * phi), np.sin(2 * phi), np.ones(3)])
    place = np.array([[0, 1, 2, 3], [2, 1, 0, 3]], np.int32)
    triples, known = turned_triples(listed, place, turn)
    assert known.tolist() == [0.75, 0.75]
    found = np.arctan2(triples[:, 2, :3], triples[:, 1, :3]) / 2
    np.testing.assert_allclose(found % math.pi, (phi[place[:, :3]] + turn[:, None]) % math.pi, atol=1e-5)
    assert not triples[:, :, 3].any()


def test_histograms_are_turned_by_bins() -> None:
    listed = np.zeros((3, 5), np.float32)
    listed[0] = [5, 0, 2, 1, 1]
    listed[1] = [0, 9, 0, 1, 1]
    place = np.array([[0, 1], [1, 2]], np.int32)
    turned, known = turned_histograms(listed, place, np.array([1.0, 0.5]))
    assert turned[0, 0].tolist() == [1, 5, 0, 2]
    assert turned[1, 0].tolist() == [0.5, 4.5, 4.5, 0.5]
    assert known.tolist() == [1, 0.5]
    most, _ = turned_histograms(listed, place, None)
    assert most.sum(axis=1).argmax(axis=1).tolist() == [0, 0]


@pytest.mark.parametrize("levels", [2, 4, 5])
def test_differing_bits_count_differences_in_levels(levels: int) -> None:
    rng = np.random.default_rng(0)
    triples = rng.normal(size=(2, 3, 5000)).astype(np.float32)
    triples[:, 0] *= 7
    bits = np.unpackbits(level_bits(triples, np.ones(2, np.float32), levels), axis=1)[:, : 15000 * (levels - 1)]
    level = bits.reshape(2, levels - 1, 15000).astype(np.int64).sum(axis=1)
    assert np.count_nonzero(bits[0] != bits[1]) == np.abs(level[0] - level[1]).sum()
    for part in (level[:, :5000], level[:, 5000:]):
        np.testing.assert_allclose(np.bincount(part.ravel(), minlength=levels) / part.size, 1 / levels, atol=0.02)


@pytest.mark.parametrize(("levels", "cells"), [(2, 1), (3, 169), (5, 30)])
def test_bits_are_those_of_plain_comparisons(levels: int, cells: int) -> None:
    rng = np.random.default_rng(levels)
    triples, known = rng.normal(size=(20, 3, cells)).astype(np.float32), rng.uniform(0.5, 1, 20).astype(np.float32)
    energy = np.einsum("nkc,nkc->nk", triples, triples)
    energy[:, 1:] = energy[:, 1:].mean(axis=1, keepdims=True)
    spread = np.sqrt(energy / (cells * known)[:, None])
    above = [triples > np.float32(NormalDist().inv_cdf(k / levels)) * spread[:, :, None] for k in range(1, levels)]
    wanted = np.packbits(np.stack(above, axis=1).reshape(20, -1), axis=1)
    np.testing.assert_array_equal(level_bits(triples, known, levels), wanted)


def test_what_is_missing_counts_as_average_and_too_little_is_dropped(sar_texture: Texture) -> None:
    amplitude = sar_texture(240, 240)
    mask = np.ones(amplitude.shape, np.bool_)
    mask[:, :95] = False
    xy = [[120.0, 120.0], [100.0, 120.0], [180.0, 120.0]]
    whole, cut = describe(as_image(amplitude), at(xy)), describe(as_image(amplitude, mask=mask), at(xy))
    assert whole.index is not None
    assert cut.index is not None
    assert whole.index.tolist() == [0, 1, 2]
    assert cut.index.tolist() == [0, 2]
    near, far = alike(whole.take(np.array([0, 2])), cut)
    assert far > 0.9
    assert 0.3 < near < 0.9
    empty = describe(as_image(amplitude, mask=mask), at(np.zeros((0, 2))))
    assert empty.descriptors is not None
    assert cut.descriptors is not None
    assert empty.descriptors.shape == (0, cut.descriptors.shape[1])


@pytest.mark.parametrize(
    "parameters",
    [
        {"patch": 0.0},
        {"grid": 0},
        {"patch": 20.0},
        {"power": 0.0},
        {"least": 0.0},
        {"reindex": "most"},
        {"levels": 1},
        {"bandwidth": float("nan")},
    ],
    ids=str,
)
def test_impossible_parameters_are_refused_when_the_plugin_is_made(parameters: dict[str, Any]) -> None:
    with pytest.raises(ParameterError):
        registry.create("descriptor", "max-index-map", **parameters)
