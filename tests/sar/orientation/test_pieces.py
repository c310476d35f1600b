"""Strips, and small images in large ones: found by pieces, refused where they fit in several places."""

from __future__ import annotations

import numpy as np

import featreg
from featreg.geometry import Translation
from featreg.sar.orientation.pieces import Piece, in_part, in_whole, pairs_of_pieces, shared_part
from featreg.sar.orientation.search import Alignment
from featreg.simulate import sar_pair
from featreg.types import Image


def blank(height: int, width: int) -> Image:
    return Image(np.ones((height, width), np.float32), np.ones((height, width), np.bool_))


def test_images_of_like_size_and_form_are_not_cut() -> None:
    assert not pairs_of_pieces(blank(300, 400), blank(256, 256))


def test_pieces_cover_both_images_and_overlap_by_half() -> None:
    strip, small = blank(60, 700), blank(50, 50)
    pairs = pairs_of_pieces(strip, small)
    assert all(second.corner == (0, 0) and second.image is small for _, second in pairs)
    covered = np.zeros(700, int)
    for first, _ in pairs:
        assert first.corner[1] == 0
        assert first.image.shape == (60, 100)
        covered[first.corner[0] : first.corner[0] + 100] += 1
    assert covered.min() == 1
    assert covered[50:650].min() == 2
    # However long the images are, the pairs stay few.
    assert len(pairs_of_pieces(blank(40, 4000), blank(40, 4000))) <= 100


def test_an_alignment_of_pieces_is_one_of_the_whole() -> None:
    linear = np.array([[0.8, -0.3], [0.3, 0.8]])
    whole = np.column_stack([linear, [5.0, -7.0]])
    first, second = Piece(blank(20, 20), (100, 30)), Piece(blank(20, 20), (11, 60))
    of_pieces = in_part(whole, first) - np.column_stack([np.zeros((2, 2)), second.corner])
    assert np.allclose(in_whole(Alignment(of_pieces, 1.0), first, second).affine, whole)


def test_the_shared_part_holds_all_of_a_small_image() -> None:
    affine = np.array([[0.0, -1.0, 500.0], [1.0, 0.0, -200.0]])
    part = shared_part(blank(900, 800), blank(100, 120), affine, 10.0)
    corners = np.array([[0.0, 0.0], [119.0, 0.0], [0.0, 99.0], [119.0, 99.0]])
    here = (corners - affine[:, 2]) @ np.linalg.inv(affine[:, :2]).T - np.array(part.corner)
    assert (here >= 10).all()
    assert (here <= np.array(part.image.shape[::-1]) - 11).all()
    assert part.image.pixels.size < 900 * 800 / 4


def test_a_long_strip_is_registered() -> None:
    pair = sar_pair((110, 1000), looks=4, rotation_deg=1.5, scale=1.02, shift=(9, -6), seed=3)
    reg = featreg.match(pair.reference, pair.secondary, method="sar-dense", model="affine", seed=0, nodata=0)
    assert reg.status == "ok", reg.reason
    xy = np.array([[60.0, 50.0], [500.0, 55.0], [940.0, 60.0]])
    assert np.abs(reg.model(xy) - (xy @ pair.truth[:, :2].T + pair.truth[:, 2])).max() < 0.3


def test_a_small_image_is_found_in_a_large_one_where_it_does_not_repeat() -> None:
    pair = sar_pair((480, 480), looks=4, rotation_deg=0, scale=1, shift=(0, 0), seed=5)
    chip = pair.secondary[210:370, 250:410]
    reg = featreg.match(pair.reference, chip, method="sar-dense", model="similarity", seed=0)
    assert reg.status == "ok", reg.reason
    assert np.abs(reg.model(np.array([[330.0, 290.0]])) - [[80.0, 80.0]]).max() < 0.3
    known = Translation(-244.0, -215.0)
    reg = featreg.match(
        pair.reference, chip, method="sar-dense", model="similarity", initial=known, search_radius=10, seed=0
    )
    assert reg.status == "ok", reg.reason
    assert np.abs(reg.model(np.array([[330.0, 290.0]])) - [[80.0, 80.0]]).max() < 0.3


def test_a_small_image_that_fits_in_several_places_is_refused() -> None:
    pair = sar_pair((160, 160), looks=16, rotation_deg=0, scale=1, shift=(0, 0), seed=6)
    rng = np.random.default_rng(0)
    mosaic = np.tile(pair.reference, (3, 3)) * np.sqrt(rng.gamma(4, 0.25, (480, 480)))
    reg = featreg.match(mosaic.astype(np.float32), pair.secondary, method="sar-dense", model="similarity", seed=0)
    assert reg.status == "unreliable"
