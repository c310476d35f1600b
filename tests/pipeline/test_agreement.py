"""What two images say of a model is computed by compiled loops: each against its plain form."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.geometry import Affine, Homography
from featreg.interfaces import Model
from featreg.io import as_image
from featreg.pipeline import agreement_kernels, compared_views
from featreg.pipeline.agreement import Agreement
from featreg.pipeline.compared_views import contrasts
from featreg.sar.correlation import local_correlations
from featreg.sar.speckle import log_floor

F32 = NDArray[np.float32]
TURNED = Affine(np.array([[0.98, 0.1, 3.3], [-0.1, 1.02, 6.6]]))
BENT = Homography(np.array([[0.98, 0.1, 3.3], [-0.1, 1.02, 6.6], [1e-5, 2e-5, 1.0]]))


def rough(shape: tuple[int, int], seed: int, sigma: float = 2.0) -> F32:
    view = np.random.default_rng(seed).normal(size=shape).astype(np.float32)
    return np.asarray(cv2.GaussianBlur(view, (0, 0), sigma), np.float32)


@pytest.mark.parametrize("model", [TURNED, BENT])
@pytest.mark.parametrize("step", [2, 4])
def test_samples_lie_where_the_model_maps_and_what_they_show_is_valid(model: Model, step: int) -> None:
    rng = np.random.default_rng(0)
    mask = np.ones((181, 190), np.bool_)
    mask[100:130, 20:60], mask[40, 150] = False, False
    secondary = as_image(np.exp(rough(mask.shape, 1)), mask=mask)
    size, usable = (160 // step, 170 // step), (rng.random((170, 160)) > 0.001).astype(np.uint8)
    nodes, zoom = compared_views.mapped(model, size, step)
    view = compared_views.view_of(secondary, step // 2, zoom)
    found, valid = compared_views.sampled(secondary, view, nodes, zoom, size, step, usable, None)

    x, y = np.meshgrid(*((np.arange(n) + 0.5) * step - 0.5 for n in size))
    at = model(np.stack([x, y], -1).reshape(-1, 2)).reshape(*x.shape, 2)
    grid = (at * view.scale + view.offset).astype(np.float32)
    wanted = cv2.remap(view.pixels, grid[..., 0], grid[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    np.testing.assert_allclose(found[valid], wanted[valid], atol=0.02 * float(view.pixels.std()))
    assert not found[~valid].any()
    # Each pixel of a square must be valid, and where it is mapped; a margin of a pixel or two is the sampler's own.
    for i, j in np.ndindex(valid.shape):
        pixels = np.stack(np.meshgrid(*(np.arange(k * step, (k + 1) * step) for k in (j, i))), -1).reshape(-1, 2)
        there = np.rint(model(pixels.astype(float))).astype(int)
        inside = ((there >= 0) & (there < mask.shape[::-1])).all()
        good = bool(inside) and bool(usable[pixels[:, 1], pixels[:, 0]].all())
        good = good and bool(mask[there[:, 1], there[:, 0]].all())
        if valid[i, j]:
            assert good
        elif good:
            around = (np.rint(model(pixels.mean(axis=0)[None]))[0]).astype(int)
            box = mask[max(around[1] - 4, 0) : around[1] + 5, max(around[0] - 4, 0) : around[0] + 5]
            assert box.shape != (9, 9) or not box.all()


def test_a_model_that_zooms_beyond_all_measure_shares_nothing() -> None:
    mask = np.ones((160, 170), np.bool_)
    mask[:5] = False
    reference, secondary = as_image(np.exp(rough(mask.shape, 1))), as_image(np.exp(rough(mask.shape, 2)), mask=mask)
    assert Agreement.of(reference, secondary, Affine(np.array([[5e4, 0, 80.0], [0, 5e4, 80.0]]))) is None


def test_a_view_shows_the_mean_around_each_pixel() -> None:
    """A ramp of the logarithm comes back as it is, at every zoom and size of samples."""
    amplitude = np.exp(np.linspace(0, 1, 96, dtype=np.float32)[None, :].repeat(80, axis=0))
    image = as_image(amplitude)
    for unit in (1, 2):
        for zoom in (0.5, 1.0, 1.6):
            view = compared_views.view_of(image, unit, zoom)
            x = np.arange(24, 72)
            place = x * view.scale + view.offset
            at = np.interp(place, np.arange(view.pixels.shape[1]), view.pixels[30])
            np.testing.assert_allclose(at, np.log(amplitude[0, x]), atol=2e-3)
    halved = np.empty((40, 48), np.float32)
    agreement_kernels.halved_logarithms(image.amplitude, log_floor(image), halved)
    np.testing.assert_allclose(halved, np.log(amplitude.reshape(40, 2, 48, 2).mean(axis=(1, 3))), atol=1e-5)


def test_windows_of_a_grid_correlate_as_windows_of_any_points_do() -> None:
    first, second = rough((90, 101), 1), rough((90, 101), 2)
    second[:, 3:] += 0.5 * first[:, :-3]
    second[60:, :50] = 0.0
    gx, gy = np.array([15, 26, 38, 70, 85]), np.array([15, 31, 40, 74])
    at = np.stack(np.meshgrid(gx, gy), -1).reshape(-1, 2)
    found = np.empty((len(at), 13, 13))
    agreement_kernels.grid_correlations(first.ravel(), second.ravel(), 101, gx, gy, 8, 6, found)
    wanted = local_correlations(first, second, at, 8, 6)
    np.testing.assert_allclose(found, wanted, atol=2e-5)
    assert (wanted == 0).any()


def test_likeness_and_structure_are_those_of_squares_that_end_at_the_rim() -> None:
    first, second = rough((61, 70), 3, 1.5), rough((61, 70), 4, 1.0)
    second += first
    local, structure = np.empty((31, 35), np.float32), np.empty((31, 35), np.float32)
    agreement_kernels.likenesses(first, second, 4, 8, 2, local, structure)

    def total(view: F32, half: int) -> F32:
        side = (2 * half + 1, 2 * half + 1)
        return np.asarray(cv2.boxFilter(view, cv2.CV_32F, side, normalize=False, borderType=cv2.BORDER_CONSTANT))

    wanted = total(first * second, 4) / np.sqrt(total(first * first, 4) * total(second * second, 4))
    np.testing.assert_allclose(local, wanted[::2, ::2], atol=1e-4)
    both = []
    for view in (first, second):
        beside = np.pad(view, ((0, 0), (0, 1)))[:, 1:] + np.pad(view, ((0, 1), (0, 0)))[1:]
        both.append(total(beside * view, 8) / (2 * total(view * view, 8)))
    np.testing.assert_allclose(structure, np.minimum(*both)[::2, ::2], atol=1e-4)


def test_contrast_is_what_lies_above_the_mean_of_the_valid_samples() -> None:
    here, there = rough((60, 70), 5) + 3, rough((60, 70), 6) - 2
    valid = np.ones(here.shape, np.bool_)
    for found, view in zip(contrasts(here, there, valid), (here, there), strict=True):
        np.testing.assert_allclose(found, view - cv2.GaussianBlur(view, (0, 0), 3.0), atol=1e-5)
    valid[:20, :30] = False
    weight = valid.astype(np.float32)
    share = cv2.GaussianBlur(weight, (0, 0), 3.0)
    for found, view in zip(contrasts(here, there, valid), (here, there), strict=True):
        mean = cv2.GaussianBlur(view * weight, (0, 0), 3.0) / np.maximum(share, 1e-6)
        np.testing.assert_allclose(found[valid], (view - mean)[valid], atol=1e-4)
        assert not found[~valid].any()


def test_the_whole_correlates_as_zero_padded_transforms_do() -> None:
    here, there = rough((60, 80), 7), rough((60, 80), 8)
    there[:, :50] += 0.7 * here[:, 30:]
    there += 0.6 * here
    model, other, shift, turned = Agreement(here, there, np.ones(here.shape, np.bool_), 4).whole
    norm = math.sqrt(float((here**2).sum() * (there**2).sum()))
    a, b = (np.fft.rfft2(view.astype(np.float64), (120, 160)) for view in (here, there))
    product = np.roll(np.fft.irfft2(np.conj(a) * b, (120, 160)) / norm, (60, 80), (0, 1))
    near = product[56:65, 76:85]
    assert model == pytest.approx(near.max(), abs=1e-5)
    near[:] = -1
    row, column = np.unravel_index(product.argmax(), product.shape)
    assert shift == (4.0 * (column - 80), 4.0 * (row - 60))
    assert shift == (-120.0, 0.0)
    assert other == pytest.approx(product.max(), abs=0.02)
    assert turned == pytest.approx(np.fft.irfft2(a * b, (120, 160)).max() / norm, abs=0.1)
