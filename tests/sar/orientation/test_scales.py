"""Windows on two scales: what the coarser one adds where speckle drowns the finer, and where it has no say."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.geometry import Affine
from featreg.geometry.robust import irls
from featreg.interfaces import FailedFit
from featreg.sar.correlation import peaks
from featreg.sar.orientation.levels import Level, aligned
from featreg.sar.orientation.scales import finer, with_coarser
from featreg.sar.orientation.windows import Surfaces, correlated, correlated_around
from featreg.simulate import sar_pair
from featreg.types import Image
from made.images import image_of

F32 = NDArray[np.float32]
SIDE, ALPHA, STEP = 260, 0.8, 24
#: The secondary is displaced by (x, y) px.
MOVED = (2.0, -1.0)


def drawn(looks: float, speckle: float, seed: int) -> tuple[Image, Image]:
    """A scene under speckle of `looks`, and of `speckle` looks more in either image, the second one displaced."""
    pair = sar_pair((SIDE, SIDE), looks=looks, rotation_deg=0, scale=1, shift=MOVED, seed=seed)
    rng = np.random.default_rng(seed)
    more = [np.sqrt(rng.gamma(speckle, 1 / speckle, (SIDE, SIDE))) for _ in range(2)]
    return image_of(pair.reference * more[0]), image_of(np.maximum(pair.secondary, 1e-3) * more[1])


def level_of(one: Image, other: Image) -> tuple[Level, Surfaces]:
    level = aligned(one, other, np.eye(2, 3), SIDE, ALPHA)
    return level, correlated(level, 48, 6, STEP)


def error(found: Surfaces) -> float:
    """Of a robust affine fit to the peaks, px over the windows."""
    seen = peaks(found.values.astype(np.float64))
    model, _ = irls(Affine, found.xy[seen.sound], (found.xy + seen.shift)[seen.sound], scale_px=0.3, iterations=10)
    assert not isinstance(model, FailedFit)
    return float(np.hypot(*(model(found.xy) - found.xy - MOVED).T).mean())


@pytest.mark.parametrize("reach", [6, 5])
def test_a_surface_is_interpolated_at_the_finer_displacements(reach: int) -> None:
    side = np.arange(-3, 4)
    # Cubic convolution is exact for a quadratic away from the rim.
    values = np.asarray((side[:, None] - 0.4) ** 2 + 2 * side[None] + 1, np.float32)[None]
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1] / 2
    inside = (abs(x) <= 2) & (abs(y) <= 2)
    np.testing.assert_allclose(finer(values, reach)[0][inside], ((y - 0.4) ** 2 + 2 * x + 1)[inside], rtol=1e-5)


def test_what_speckle_drowns_is_found_on_two_scales() -> None:
    errors = []
    for seed in range(3):
        one, other = drawn(1, 0.5, seed)
        level, found = level_of(one, other)
        both = with_coarser(one, other, level, found, SIDE, ALPHA)
        assert both.side == 2 * found.side
        errors.append((error(found), error(both)))
    alone, together = np.mean(errors, axis=0)
    assert together < 0.6 * alone


def test_windows_that_agree_and_images_of_different_kind_stay_with_the_finer_level() -> None:
    one, other = drawn(4, 50, 1)
    level, found = level_of(one, other)
    assert with_coarser(one, other, level, found, SIDE, ALPHA) is found
    one, other = drawn(1, 0.5, 0)
    smooth = image_of(np.asarray(cv2.GaussianBlur(one.amplitude, (0, 0), 4), np.float32))
    level, found = level_of(smooth, other)
    assert with_coarser(smooth, other, level, found, SIDE, ALPHA) is found


def test_windows_around_points_are_those_of_the_grid_and_stay_inside() -> None:
    one, other = drawn(4, 50, 2)
    level, found = level_of(one, other)
    values = correlated_around(level, level.reference_xy(found.xy), found.side, found.reach)
    np.testing.assert_allclose(values, found.values, atol=1e-6)
    assert np.isfinite(correlated_around(level, np.array([[-50.0, 1e4]]), found.side, 6)).all()
    assert with_coarser(one, other, level, correlated(level, 400, 6), SIDE, ALPHA).values.size == 0
