"""RIFT: log-Gabor bank, phase congruency, black rims, its detector and descriptor, and whole registrations."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import featreg
from featreg import registry
from featreg.errors import ParameterError
from featreg.io import as_image
from featreg.sar.log_gabor import LogGabor, _continued, _filters, responses
from featreg.sar.phase_congruency import STEPS, Congruency, bytes_of, congruency_maps, without_rim
from featreg.simulate import SimulatedPair
from featreg.types import Features, Image

Texture = Callable[..., NDArray[np.float32]]
FINE = Congruency(noise=1.0, floor=1e-4, view="amplitude")


def detect(picture: Image, **parameters: Any) -> Features:
    return registry.create("detector", "phase-congruency", **parameters).detect_features(picture)


def describe(picture: Image, features: Features, **parameters: Any) -> Features:
    return registry.create("descriptor", "max-index-map", **parameters).describe_features(picture, features)


def at(xy: Any, angle: Any = 0.0) -> Features:
    xy = np.asarray(xy, np.float64)
    return Features(xy, 20.0, angle, np.ones(len(xy)), np.zeros(len(xy), np.int64))  # type: ignore[arg-type]


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


@pytest.mark.parametrize("orientation", range(6))
@pytest.mark.parametrize("scale", [0, 1, 3])
def test_a_wave_answers_in_the_filter_made_for_it(scale: int, orientation: int) -> None:
    """One-sided filters of peak 1 give half the amplitude of a cosine, no ripple: even and odd in quadrature."""
    bank = LogGabor(min_wavelength=5.0, bandwidth=0.55)
    inside = slice(40, -40)
    view = wave(bank.wavelength(scale), math.pi * orientation / bank.orientations)
    amplitude = np.array([[np.abs(r[inside, inside]).mean() for r in parts] for parts in responses(view, bank)])
    assert amplitude.argmax() == orientation * bank.scales + scale
    assert amplitude[orientation, scale] == pytest.approx(0.5, rel=0.03)
    strongest = next(np.array(p[scale]) for o, p in enumerate(responses(view, bank)) if o == orientation)
    assert np.abs(strongest[inside, inside]).std() < 0.02


@pytest.mark.parametrize("shape", [(90, 130), (131, 77)])
@pytest.mark.parametrize("orientations", [6, 7, 8, 9])
def test_leaving_out_empty_parts_of_the_spectrum_changes_nothing(shape: tuple[int, int], orientations: int) -> None:
    bank = LogGabor(orientations=orientations, min_wavelength=4.0)
    view = np.random.default_rng(0).normal(size=shape).astype(np.float32)
    padded, top, left = _continued(view, bank.margin)
    radial, angular, _ = _filters(*padded.shape, bank)
    spectrum = np.fft.fft2(padded.astype(np.float64))
    for o, parts in enumerate(responses(view, bank)):
        for s, found in enumerate(parts):
            full = np.fft.ifft2(spectrum * radial[s] * angular[o])
            wanted = full[top : top + shape[0], left : left + shape[1]]
            assert np.abs(found - wanted).max() < 4e-3 * np.abs(wanted).max()


def test_all_directions_are_covered_alike() -> None:
    height, width = 64, 80
    _, angular, _ = _filters(height, width, LogGabor())
    both = angular + angular[:, -np.arange(height) % height][:, :, -np.arange(width) % width]
    total = both.sum(axis=0)[1:31, 1:39]
    np.testing.assert_allclose(total, total.mean(), rtol=1e-4)


def test_borders_give_no_edges() -> None:
    """A constant stays silent up to the border, and a ramp far below a step of its height."""
    bank = LogGabor()
    flat = np.full((60, 70), 3.0, np.float32)
    assert max(np.abs(parts).max() for parts in responses(flat, bank)) < 1e-4


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
    from featreg.sar import index_map_kernels as kernels

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
        single = tuple(np.pad(p, ((2, 1), (3, 0))).astype(np.complex64).view(np.float32) for p in parts[o])
        kernels.add_orientation(single, 2, 3, noise_, floor_, gain_, cut_, cosine, sine, moments, amplitudes[o])
        total, mean = np.abs(parts[o]).sum(axis=0), parts[o].sum(axis=0)
        unit = mean / np.abs(mean)
        turned = parts[o] * unit.conj()
        energy = np.maximum((turned.real - np.abs(turned.imag)).sum(axis=0) - noise, 0)
        width = (total / np.abs(parts[o]).max(axis=0) - 1) / (scales - 1)
        pc = energy / (total + floor) / (1 + np.exp(-gain * (width - cut_off)))
        sums += [pc**2 * v for v in (math.cos(angle) ** 2, math.sin(angle) ** 2, math.cos(angle) * math.sin(angle))]
        np.testing.assert_allclose(amplitudes[o], total, rtol=1e-5)
    np.testing.assert_allclose(moments, sums, atol=1e-3 * sums.max())
    largest, smallest = np.empty((2, *shape), np.float32)
    kernels.principal_moments(moments, np.float32(2 / orientations), largest, smallest)
    matrices = np.moveaxis(np.array([[moments[0], moments[2]], [moments[2], moments[1]]]), (0, 1), (2, 3))
    eigen = np.linalg.eigvalsh(matrices.astype(np.float64)) * 2 / orientations
    np.testing.assert_allclose(np.stack([smallest, largest], -1), eigen, atol=1e-6)
    index = np.empty(shape, np.uint8)
    kernels.dominant_index(amplitudes, STEPS, index)
    nearest = np.floor(index / (STEPS / orientations) + 0.5) % orientations
    on_a_boundary = (index % (STEPS // orientations)) == STEPS // orientations // 2
    np.testing.assert_array_equal(nearest[~on_a_boundary], amplitudes.argmax(axis=0)[~on_a_boundary])


def test_maps_are_quantised_by_their_valid_pixels() -> None:
    strength = np.linspace(0, 1, 100 * 100, dtype=np.float32).reshape(100, 100)
    valid = np.ones(strength.shape, np.bool_)
    valid[50:] = False
    assert bytes_of(strength, valid, 1.0)[49, 99] == 255
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


# Detector


@pytest.mark.parametrize("n_features", [1, 2, 50, 100000])
def test_the_budget_is_kept(sar_texture: Texture, n_features: int) -> None:
    found = detect(as_image(sar_texture()), n_features=n_features)
    assert 0 < len(found) <= n_features


def test_corners_and_edges_share_the_budget(sar_texture: Texture) -> None:
    picture = as_image(sar_texture(300, 300))
    points = {share: set(map(tuple, detect(picture, n_features=100, corner_share=share).xy)) for share in (0, 0.3, 1.0)}
    assert len(points[0.3]) == 100
    assert len(points[0.3] & points[1.0]) == 30
    assert len(points[0.3] & points[0]) == 70


def test_a_negative_has_the_same_points(sar_texture: Texture) -> None:
    """Phase congruency does not know bright from dark."""
    amplitude = sar_texture()
    negative = amplitude.max() - amplitude
    gain = amplitude.mean() / negative.mean()
    options: dict[str, Any] = {"view": "amplitude", "n_features": 200}
    a = detect(as_image(amplitude), floor=1e-4, **options)
    b = detect(as_image(negative * gain), floor=1e-4, **options)
    apart = np.hypot(*(a.xy[:, None] - b.xy[None]).transpose(2, 0, 1)).min(axis=1)
    assert (apart < 0.1).mean() > 0.95


def test_points_follow_a_scene_that_moves_by_a_fraction_of_a_pixel(sar_texture: Texture) -> None:
    from scipy.ndimage import fourier_shift, gaussian_filter

    shift = np.array([0.4, -0.3])
    smooth = gaussian_filter(sar_texture(240, 240).astype(np.float64), 1.2, mode="wrap")
    moved = np.maximum(np.fft.ifft2(fourier_shift(np.fft.fft2(smooth), shift[::-1])).real, 0)
    error = {}
    for subpixel in ("centroid", "none"):
        a, b = (detect(as_image(v), subpixel=subpixel).xy for v in (smooth, moved))
        apart = np.hypot(*(a[:, None] + shift - b[None]).transpose(2, 0, 1))
        partner = apart.argmin(axis=1)
        near = apart[np.arange(len(a)), partner] < 1.5
        assert near.mean() > 0.7
        found = (b[partner] - a)[near]
        error[subpixel] = float(np.hypot(*(found - shift).T).mean())
        np.testing.assert_allclose(found.mean(axis=0), shift, atol=0.1)
    assert error["centroid"] < 0.6 * error["none"]


def test_no_point_lies_on_a_black_rim(sar_texture: Texture) -> None:
    bytes_ = np.clip(sar_texture(200, 220) * 60 + 4, 1, 255).astype(np.uint8)
    bytes_[:, :50] = 0
    found = detect(as_image(bytes_))
    assert len(found) > 20
    assert found.xy[:, 0].min() >= 50 + 18


# Descriptor


@pytest.mark.parametrize("reindex", ["angle", "dominant"])
def test_turning_image_and_keypoint_by_a_quarter_keeps_the_descriptor(sar_texture: Texture, reindex: str) -> None:
    amplitude = sar_texture(220, 220)
    xy = np.random.default_rng(0).integers(45, 175, (40, 2)).astype(np.float64)
    turned_xy = np.column_stack([xy[:, 1], 219 - xy[:, 0]])
    angles = np.random.default_rng(1).integers(0, 24, 40) * math.pi / 12
    for angle in (0.0, 0.3, angles):
        a = describe(as_image(amplitude), at(xy, angle), reindex=reindex)
        b = describe(as_image(np.rot90(amplitude)), at(turned_xy, angle + math.pi / 2), reindex=reindex)
        wrong = describe(as_image(np.rot90(amplitude)), at(turned_xy, angle), reindex=reindex)
        assert a.descriptors is not None
        assert b.descriptors is not None
        assert wrong.descriptors is not None
        same, other = (np.einsum("ij,ij->i", a.descriptors, d) for d in (b.descriptors, wrong.descriptors))
        assert np.median(same) > 0.95
        assert np.median(other) < 0.6


def test_turning_by_twenty_degrees_keeps_most_of_the_descriptor(sar_texture: Texture) -> None:
    cv2 = pytest.importorskip("cv2")
    amplitude = cv2.GaussianBlur(sar_texture(260, 260), (0, 0), 1.2)
    matrix = cv2.getRotationMatrix2D((129.5, 129.5), 20.0, 1.0)  # counter-clockwise as seen
    turned = cv2.warpAffine(amplitude, matrix, (260, 260), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    xy = np.random.default_rng(0).integers(80, 180, (60, 2)).astype(np.float64)
    there = xy @ matrix[:, :2].T + matrix[:, 2]
    before = describe(as_image(amplitude), at(xy)).descriptors
    after = describe(as_image(np.maximum(turned, 0)), at(there, math.radians(20))).descriptors
    assert before is not None
    assert after is not None
    assert np.median(np.einsum("ij,ij->i", before, after)) > 0.8
    assert ((before @ after.T).argmax(axis=1) == np.arange(60)).mean() > 0.95


def test_summed_areas_hold_the_counts_also_where_they_wrap_around() -> None:
    from featreg.sar import index_map_kernels as kernels

    rng = np.random.default_rng(0)
    index = rng.integers(0, 4, (40, 50)).astype(np.uint8)
    weight = rng.integers(0, 256, (40, 50)).astype(np.uint8)
    votes = np.zeros((4, 8), np.int32)
    votes[np.arange(4), np.arange(4)] = 1 << 18  # 2^18 * 255 * 2000 pixels is far beyond 2^31, a cell's sum is not
    sums = np.empty((21, 26, 8), np.int32)
    kernels.index_sums(index, weight, votes, 4, sums)
    out = np.empty((2, 1, 8), np.float32)
    cells, turns = np.zeros((1, 1, 2), np.int64), np.zeros(2, np.int64)
    kernels.pooled(sums, np.array([25, 49]), np.array([30, 39]), cells, turns, np.array([1, 0]), 2, out)
    # To even pixels, and cut at the border.
    squares = (slice(28, 34), slice(24, 28)), (slice(38, 40), slice(48, 50))
    for found, (rows, columns) in zip(out[:, 0], squares, strict=True):
        part, w = index[rows, columns], weight[rows, columns].astype(np.int64)
        wanted = [(w * (part == k)).sum() * (1 << 18) for k in range(4)]
        np.testing.assert_allclose(found[:4], wanted, rtol=1e-6)
        assert found[4] == np.count_nonzero(w)


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
    assert whole.descriptors is not None
    assert cut.descriptors is not None
    cells = cut.descriptors[0].reshape(7, 7, 6)
    assert not cells[:, 0].any()  # the first column of cells, 88 to 97, is next to masked
    assert cells[:, 2:].any(axis=2).all()
    assert np.dot(whole.descriptors[2], cut.descriptors[1]) > 0.9


def test_maps_are_computed_once_for_both(sar_texture: Texture, monkeypatch: pytest.MonkeyPatch) -> None:
    from featreg.sar import phase_congruency

    calls: list[int] = []
    real = phase_congruency._view

    def counted(*values: Any) -> Any:
        calls.append(1)
        return real(*values)

    monkeypatch.setattr(phase_congruency, "_view", counted)
    picture = as_image(sar_texture())
    describe(picture, detect(picture))
    assert len(calls) == 1


# Whole registrations


def at_truth(pair: SimulatedPair, xy: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(xy @ pair.truth[:2, :2].T + pair.truth[:2, 2])


def error_px(result: featreg.Registration, pair: SimulatedPair) -> float:
    y, x = np.mgrid[30:270:60, 30:270:60]
    grid = np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)
    assert result.model
    return float(np.hypot(*(result.model(grid) - at_truth(pair, grid)).T).max())


def test_a_pair_is_registered(pair: SimulatedPair) -> None:
    result = featreg.match(pair.reference, pair.secondary, method="rift", refine=False)
    assert result.status == "ok", result.reason
    assert error_px(result, pair) < 1.5


def test_a_turned_pair_is_registered(turned_pair: SimulatedPair) -> None:
    result = featreg.match(turned_pair.reference, turned_pair.secondary, method="rift", refine=False)
    assert result.status == "ok", result.reason
    assert error_px(result, turned_pair) < 2.0


def test_another_sensor_with_brightness_reversed_is_registered(pair: SimulatedPair) -> None:
    relative = pair.secondary / pair.secondary.mean()
    other = np.asarray(1 / (0.3 + relative), np.float32)
    result = featreg.match(pair.reference, other, method="rift", refine=False)
    assert result.status == "ok", result.reason
    assert error_px(result, pair) < 2.0


def test_the_papers_form_runs(pair: SimulatedPair) -> None:
    result = featreg.match(pair.reference, pair.secondary, method="rift-paper")
    assert "gms" not in result.stages
    assert len(result.matches) > 50


@pytest.mark.realdata
def test_real_dates_are_registered_below_a_pixel(realdata: Path) -> None:
    files = sorted((realdata / "sentinel1_stack").glob("*.tif"))[:2]
    result = featreg.match(*(str(f) for f in files), method="rift", model="affine", refine=False)
    assert result.status == "ok", result.reason
    assert result.model
    corners = np.array([[50.0, 50.0], [450.0, 50.0], [50.0, 450.0], [450.0, 450.0]])
    assert np.hypot(*(result.model(corners) - corners).T).max() < 1.0


@pytest.mark.parametrize(
    ("kind", "name", "parameters"),
    [
        *(
            ("detector", "phase-congruency", p)
            for p in (
                {"n_features": 0},
                {"corner_share": 1.5},
                {"threshold": 255},
                {"support": 1.0},
                {"support": float("nan")},
                {"sigma": 0.0},
                {"subpixel": "parabola"},
                {"scales": 0},
                {"orientations": 5},
                {"min_wavelength": 1.0},
                {"multiplier": 1.0},
                {"bandwidth": 1.0},
                {"noise": float("nan")},
                {"floor": 0.0},
                {"view": "log"},
            )
        ),
        *(
            ("descriptor", "max-index-map", p)
            for p in (
                {"patch": 0.0},
                {"grid": 0},
                {"patch": 20.0},
                {"power": 0.0},
                {"least": 0.0},
                {"reindex": "most"},
                {"bandwidth": float("nan")},
            )
        ),
    ],
    ids=str,
)
def test_impossible_parameters_are_refused_when_the_plugin_is_made(
    kind: Any, name: str, parameters: dict[str, Any]
) -> None:
    with pytest.raises(ParameterError):
        registry.create(kind, name, **parameters)
