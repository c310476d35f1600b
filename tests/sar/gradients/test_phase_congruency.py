"""Log-Gabor filters and phase congruency: against waves, whole transforms and the formulas; black rims."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.io import as_image
from featreg.sar.gradients.log_gabor import LogGabor, _transfers, finest_amplitude, pieces
from featreg.sar.gradients.phase_congruency import STEPS, Congruency, bytes_of, congruency_maps, without_rim
from featreg.types import Image

Texture = Callable[..., NDArray[np.float32]]
FINE = Congruency(noise=1.0, floor=1e-4, view="amplitude")


def wave(wavelength: float, angle: float, side: int = 150) -> NDArray[np.float32]:
    """A cosine whose normal points at `angle`, from x towards y."""
    y, x = np.mgrid[:side, :side]
    return np.asarray(np.cos(2 * math.pi * (x * math.cos(angle) + y * math.sin(angle)) / wavelength), np.float32)


def edge(angle: float, contrast: float = 1.0, side: int = 128) -> Image:
    """A step through the centre whose normal points at `angle`, from x towards y."""
    y, x = np.mgrid[:side, :side] - (side - 1) / 2
    step = 1 / (1 + np.exp(-(x * math.cos(angle) + y * math.sin(angle))))
    return as_image((2 + contrast * step).astype(np.float32))


# Log-Gabor bank


def responses(view: NDArray[np.float32], bank: LogGabor) -> NDArray[np.complex64]:
    """(orientations, scales, H, W), put together from the pieces."""
    out = np.zeros((bank.orientations, bank.scales, *view.shape), np.complex64)
    for piece in pieces(view, bank):
        inside = tuple(slice(piece.margin, piece.margin + s.stop - s.start) for s in (piece.rows, piece.columns))
        for o in range(bank.orientations):
            out[o, :, piece.rows, piece.columns] = [part[inside] for part in piece.responses(o)]
    return out


@pytest.mark.parametrize("orientation", range(6))
@pytest.mark.parametrize("scale", [0, 1, 3])
def test_a_wave_answers_in_the_filter_made_for_it(scale: int, orientation: int) -> None:
    """One-sided filters of peak 1 give half the amplitude of a cosine, no ripple: even and odd in quadrature."""
    bank = LogGabor(min_wavelength=5.0, bandwidth=0.55)
    inside = slice(40, -40)
    view = wave(bank.wavelength(scale), math.pi * orientation / bank.orientations)
    parts = np.abs(responses(view, bank)[:, :, inside, inside])
    amplitude = parts.mean(axis=(2, 3))
    assert amplitude.argmax() == orientation * bank.scales + scale
    assert amplitude[orientation, scale] == pytest.approx(0.5, rel=0.03)
    assert parts[orientation, scale].std() < 0.02


@pytest.mark.parametrize("shape", [(90, 130), (300, 77), (40, 500)])
@pytest.mark.parametrize(
    "bank",
    [
        LogGabor(2, 4, 6.0, 3.0, 0.35),
        LogGabor(2, 6, 4.0, 3.0, 0.5),
        LogGabor(4, 6, 3.0, 1.6, 0.75),
        LogGabor(1, 9, 50.0),
    ],
    ids=str,
)
def test_pieces_answer_as_the_whole_image_does(shape: tuple[int, int], bank: LogGabor) -> None:
    """Against transforms of the image far beyond its reflected borders, by the formulas of the filters."""
    view = np.random.default_rng(0).normal(size=shape).astype(np.float32)
    far = 5 * bank.margin
    spectrum = np.fft.fft2(np.pad(view, far, mode="symmetric").astype(np.float64))
    y, x = np.meshgrid(*(np.fft.fftfreq(n) for n in spectrum.shape), indexing="ij")
    radius = np.maximum(np.hypot(x, y), 1e-9)
    found = responses(view, bank)
    for o in range(bank.orientations):
        away = np.abs(np.angle(np.exp(1j * (np.arctan2(y, x) - math.pi * o / bank.orientations))))
        angular = np.where(away < 2 * math.pi / bank.orientations, np.cos(away * bank.orientations / 4) ** 2, 0)
        for s in range(bank.scales):
            radial = np.exp(-(np.log(radius * bank.wavelength(s)) ** 2) / (2 * math.log(bank.bandwidth) ** 2))
            radial /= 1 + (radius / 0.45) ** 30
            wanted = np.fft.ifft2(spectrum * radial * angular)[far:-far, far:-far]
            error = np.abs(found[o, s] - wanted)
            assert np.sqrt((error**2).mean()) < 0.04 * np.sqrt((np.abs(wanted) ** 2).mean())


def test_the_finest_amplitude_is_that_of_the_transforms() -> None:
    view = np.random.default_rng(1).normal(size=(70, 90)).astype(np.float32)
    for bank in (LogGabor(2, 4, 6.0, 3.0, 0.35), LogGabor(4, 6, 3.0, 1.6, 0.75)):
        rows, columns = slice(3, None, 9), slice(None, None, 7)
        found = finest_amplitude(view, rows, columns, bank)
        wanted = np.abs(responses(view, bank)[:, 0, rows, columns])
        assert np.abs(found - wanted).max() < 0.05 * wanted.max()


@pytest.mark.parametrize("orientations", [4, 5, 6, 24])
def test_all_directions_are_covered_alike(orientations: int) -> None:
    height, width = 64, 80
    bank = LogGabor(1, orientations, 8.0, 2.0, 0.4)
    total = _transfers(height, width, bank).sum(axis=0)
    both = total + total[-np.arange(height) % height][:, -np.arange(width) % width]
    y, x = np.meshgrid(np.fft.fftfreq(height), np.fft.fftfreq(width), indexing="ij")
    ring = np.abs(np.hypot(x, y) - 0.125) < 0.01
    np.testing.assert_allclose(both[ring], both[ring].mean(), rtol=0.02)


def test_borders_give_no_edges() -> None:
    """A constant stays silent up to the border, also where pieces meet."""
    flat = np.full((60, 570), 3.0, np.float32)
    assert np.abs(responses(flat, LogGabor())).max() < 1e-4


# Phase congruency


@pytest.mark.parametrize("degrees", [0, 20, 45, 75, 90, 130, 165])
def test_the_index_is_the_normal_of_an_edge(degrees: int) -> None:
    _, _, index, _ = congruency_maps(edge(math.radians(degrees)), LogGabor(min_wavelength=5.0), FINE)
    found = index[62:66, 62:66].astype(float) * 180 / STEPS
    away = np.abs((found - degrees + 90) % 180 - 90)
    assert away.max() < 4


def test_congruency_does_not_depend_on_contrast_or_its_sign() -> None:
    maps = []
    for contrast in (1.0, 0.2, 5.0, -1.0):
        relative = edge(0.4, contrast)
        largest, smallest, _, _ = congruency_maps(
            relative, LogGabor(min_wavelength=6.0), Congruency(floor=1e-6, view="amplitude")
        )
        maps.append(np.stack([largest, smallest])[:, 60:68, 60:68])
    for other in maps[1:]:
        assert np.abs(other - maps[0]).max() < 0.02 * maps[0].max()


def test_the_edge_map_follows_edges_and_the_corner_map_corners() -> None:
    square = np.ones((120, 120), np.float32)
    square[40:80, 40:80] = 2
    largest, smallest, _, _ = congruency_maps(as_image(square), LogGabor(), FINE)
    middle, corner = (slice(38, 42), slice(58, 62)), (slice(37, 43), slice(37, 43))
    assert largest[middle].max() > 0.5 * largest.max()
    assert smallest[corner].max() > 3 * smallest[middle].max()


def test_moments_and_index_are_those_of_the_formulas() -> None:
    """The compiled loops against the formulas in double precision."""
    from featreg.sar.gradients import congruency_kernels as kernels

    rng = np.random.default_rng(0)
    scales, orientations, shape = 4, 6, (9, 21)
    parts = rng.normal(size=(orientations, scales, *shape)) + 1j * rng.normal(size=(orientations, scales, *shape))
    noise, floor, gain, cut_off = 0.4, 0.1, 3.0, 0.5
    moments, amplitudes = np.zeros((3, *shape), np.float32), np.empty((orientations, *shape), np.float32)
    sums = np.zeros((3, *shape))
    for o in range(orientations):
        angle = math.pi * o / orientations
        noise_, floor_, gain_, cut_, cosine, sine = (
            np.float32(v) for v in (noise, floor, gain, cut_off, math.cos(angle), math.sin(angle))
        )
        flat = tuple(np.pad(p, ((2, 1), (3, 0))).astype(np.complex64).view(np.float32).ravel() for p in parts[o])
        kernels.add_orientation(flat, 24, 2, 3, noise_, floor_, gain_, cut_, cosine, sine, moments, amplitudes[o])
        total, mean = np.abs(parts[o]).sum(axis=0), parts[o].sum(axis=0)
        unit = mean / np.abs(mean)
        turned = parts[o] * unit.conj()
        energy = np.maximum((turned.real - np.abs(turned.imag)).sum(axis=0) - noise, 0)
        width = (total / np.abs(parts[o]).max(axis=0) - 1) / (scales - 1)
        pc = energy / (total + floor) / (1 + np.exp(-gain * (width - cut_off)))
        sums += [pc**2 * v for v in (math.cos(angle) ** 2, math.sin(angle) ** 2, math.cos(angle) * math.sin(angle))]
        np.testing.assert_allclose(amplitudes[o], total, rtol=1e-5)
    np.testing.assert_allclose(moments, sums, atol=1e-3 * sums.max())
    # Into a part of larger maps.
    largest, smallest = np.zeros((2, 12, 30), np.float32)
    index = np.full((12, 30), 255, np.uint8)
    here = slice(2, 11), slice(4, 25)
    kernels.principal_moments(moments, np.float32(2 / orientations), 2, 4, largest, smallest)
    matrices = np.moveaxis(np.array([[moments[0], moments[2]], [moments[2], moments[1]]]), (0, 1), (2, 3))
    eigen = np.linalg.eigvalsh(matrices.astype(np.float64)) * 2 / orientations
    np.testing.assert_allclose(np.stack([smallest[here], largest[here]], -1), eigen, atol=1e-6)
    kernels.dominant_index(tuple(a.ravel() for a in amplitudes), shape[1], STEPS, 2, 4, index)
    left, best, right = (
        np.take_along_axis(amplitudes, (amplitudes.argmax(axis=0) + step)[None] % orientations, 0)[0].astype(np.float64)
        for step in (-1, 0, 1)
    )
    vertex = amplitudes.argmax(axis=0) + (right - left) / (2 * (2 * best - left - right))
    away = (index[here] - vertex * STEPS / orientations + STEPS / 2) % STEPS - STEPS / 2
    assert np.abs(away).max() < 0.51
    outside = np.ones(index.shape, np.bool_)
    outside[here] = False
    assert (index[outside] == 255).all()
    assert not largest[outside].any()


def test_the_noise_threshold_is_kovesis_of_speckle_alone(sar_texture: Texture) -> None:
    """Doubling the standard deviations that count as noise leaves less of everything, and of noise alone nothing."""
    from featreg.sar.gradients.phase_congruency import _noise

    bank = LogGabor(2, 4, 6.0, 3.0, 0.35)
    view = np.random.default_rng(0).normal(size=(200, 300)).astype(np.float32)
    valid = np.ones(view.shape, np.bool_)
    tau = np.median(np.abs(responses(view, bank)[:, 0])) / math.sqrt(math.log(4))
    for deviations in (0.0, 2.0):
        wanted = tau * (1 + 1 / 3) * (math.sqrt(math.pi / 2) + deviations * math.sqrt((4 - math.pi) / 2))
        found = _noise(view, valid, bank, Congruency(noise=deviations))
        assert found == pytest.approx(np.full(4, wanted), rel=0.05)
    assert not _noise(view, ~valid, bank, Congruency(noise=1.0)).any()


def test_the_published_noise_threshold_is_that_of_all_pixels_of_each_orientation() -> None:
    """Speckle that runs along x, whose orientations differ."""
    from featreg.sar.gradients.phase_congruency import _noise

    bank = LogGabor(2, 4, 3.0, 1.6, 0.75)
    view = np.random.default_rng(0).normal(size=(120, 150)).astype(np.float32)
    view[:, 1:] += 0.9 * view[:, :-1]
    valid = np.arange(150) > 60 + np.zeros((120, 1))
    middle = np.median(np.abs(responses(view, bank)[:, 0])[:, valid], axis=1)
    wanted = middle / math.sqrt(math.log(4)) * (1 + 1 / 1.6) * (math.sqrt(math.pi / 2) + math.sqrt((4 - math.pi) / 2))
    found = _noise(view, valid, bank, Congruency(noise=1.0, exact=True))
    np.testing.assert_allclose(found, wanted, rtol=1e-3)
    assert found.max() > 1.2 * found.min()


def test_maps_are_quantised_by_their_valid_pixels() -> None:
    strength = np.linspace(0, 1, 100 * 100, dtype=np.float32).reshape(100, 100)
    valid = np.ones(strength.shape, np.bool_)
    valid[50:] = False
    assert bytes_of(strength, valid, 1.0)[49, 99] == 255
    # A single bright pixel that is not among those looked at.
    ship = np.ones((150, 150), np.float32)
    ship[1, 1] = 50
    everywhere = np.ones(ship.shape, np.bool_)
    assert (bytes_of(ship, everywhere, 1.0) == 255).all()
    assert (bytes_of(ship, everywhere, 1.0, whole=True) == 255).sum() == 1
    assert int(bytes_of(strength, valid, 1.0)[25, 0]) == pytest.approx(127, abs=3)
    assert not bytes_of(np.zeros_like(strength), valid).any()


# Black rims


def test_black_corners_of_a_warp_count_as_invalid(sar_texture: Texture) -> None:
    cv2 = pytest.importorskip("cv2")
    bytes_ = np.clip(sar_texture(220, 220) * 60 + 4, 1, 255).astype(np.uint8)
    matrix = cv2.getRotationMatrix2D((109.5, 109.5), 30, 1.0)
    turned = cv2.warpAffine(bytes_, matrix, (220, 220))
    inside = cv2.warpAffine(np.ones_like(bytes_), matrix, (220, 220), flags=cv2.INTER_NEAREST) > 0
    mask = without_rim(as_image(turned)).mask
    assert (~mask[~inside]).mean() > 0.97
    assert mask[inside].mean() > 0.97


def test_black_inside_an_image_stays_and_an_image_without_black_is_returned_as_it_is(sar_texture: Texture) -> None:
    amplitude = sar_texture(150, 150) + np.float32(0.2)
    picture = as_image(amplitude)
    assert without_rim(picture) is picture
    amplitude[50:90, 60:100] = 0
    assert without_rim(as_image(amplitude)).all_valid
