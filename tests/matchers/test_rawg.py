"""RAWG: aligned images are registered whatever their contrast, others are refused however narrow the search."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

import featreg
from featreg import registry
from featreg.geometry import Affine
from featreg.io import as_image
from featreg.simulate import SimulatedPair, sar_pair
from made.models import grid_rmse

SHAPE = (260, 260)


def known(pair: SimulatedPair, dx: float, dy: float) -> Affine:
    """The truth, displaced."""
    return Affine(pair.truth + np.array([[0, 0, dx], [0, 0, dy]]))


@pytest.mark.parametrize(("rotation", "scale"), [(0.0, 1.0), (128.0, 1.3), (-71.0, 0.8)])
def test_a_model_known_to_some_pixels_is_made_exact(rotation: float, scale: float) -> None:
    pair = sar_pair(SHAPE, looks=1, rotation_deg=rotation, scale=scale, shift=(11, -7), seed=2)
    reg = featreg.match(
        pair.reference, pair.secondary, method="rawg", seed=0, nodata=0, initial=known(pair, 5, -4), search_radius=10
    )
    assert reg.status == "ok", reg.reason
    assert grid_rmse(reg, pair.truth, 260, 50) < 0.4
    assert len(reg.matches) > 30


def test_reversed_contrast_is_no_obstacle() -> None:
    pair = sar_pair(SHAPE, looks=4, rotation_deg=0, scale=1, shift=(6, 9), seed=6)
    reverse = np.where(pair.secondary > 0, 1 / np.maximum(cv2.blur(pair.secondary, (5, 5)), 1e-6), 0)
    reg = featreg.match(pair.reference, reverse, method="rawg", model="similarity", seed=0, nodata=0)
    assert reg.status == "ok", reg.reason
    assert grid_rmse(reg, pair.truth, 260, 50) < 0.7


def test_without_a_model_one_grid_is_taken_for_granted_and_that_is_said() -> None:
    pair = sar_pair(SHAPE, looks=4, rotation_deg=25, scale=1, shift=(0, 0), seed=3)
    reg = featreg.match(pair.reference, pair.secondary, method="rawg", seed=0, nodata=0)
    assert reg.status == "unreliable"
    assert "give 'initial' and 'search_radius'" in reg.reason
    told = featreg.match(
        pair.reference, pair.secondary, method="rawg", seed=0, nodata=0, initial=known(pair, 40, 0), search_radius=5
    )
    assert told.status == "unreliable"
    assert "initial" not in told.reason.split(";")[-1]


@pytest.mark.parametrize("radius", [2.0, 30.0])
def test_other_places_give_nothing_however_narrow_the_search(radius: float) -> None:
    one = sar_pair(SHAPE, looks=4, rotation_deg=0, scale=1, shift=(0, 0), seed=8).reference
    other = sar_pair(SHAPE, looks=4, rotation_deg=0, scale=1, shift=(0, 0), seed=9).reference
    same = Affine(np.array([[1.0, 0, 0], [0, 1, 0]]))
    reg = featreg.match(one, other, method="rawg", seed=0, initial=same, search_radius=radius)
    assert reg.status == "unreliable"
    assert len(reg.matches) == 0


def test_templates_avoid_nodata_and_regions_change_nothing() -> None:
    pair = sar_pair((300, 320), looks=4, rotation_deg=0, scale=1, shift=(4, 3), seed=4)
    y, x = np.mgrid[0:300, 0:320]
    mask: NDArray[np.bool_] = np.asarray(x + y > 150)
    images = as_image(pair.reference, mask=mask), as_image(pair.secondary, nodata=0)
    whole = registry.create("matcher", "angle-weighted-templates").match(*images)
    assert len(whole) > 20
    for dx, dy in ((-48, -48), (48, -48), (-48, 48), (48, 48)):
        corner = whole.reference_xy.astype(int) + np.array([dx, dy])
        assert mask[corner[:, 1], corner[:, 0]].all()
    parts = registry.create("matcher", "angle-weighted-templates", points=9, merge=1, chance=-0.1).match(*images)
    few = registry.create("matcher", "angle-weighted-templates", points=9, merge=1 << 40, chance=-0.1).match(*images)
    assert len(parts) == len(few) > 3
    assert np.allclose(parts.secondary_xy, few.secondary_xy, atol=1e-3)
