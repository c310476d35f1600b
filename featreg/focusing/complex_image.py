"""Autofocus of complex SAR images: the phase error of every pulse estimated from the image, and taken out of it.

Phase convention: ``phase[m]`` is the error of ``numpy.fft.fft(image, axis=azimuth_axis)[m]``, so that the focused image
is ``ifft(fft(image) * exp(-1j * phase))``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from annotated_types import Interval
from numpy.typing import ArrayLike, NDArray

from featreg.errors import CancelledError, InputError, ParameterError, suggest
from featreg.focusing import autofocus
from featreg.focusing.azimuth_filter import apply_phase, image_entropy
from featreg.focusing.focus_gates import gates_of, reason_of
from featreg.focusing.minimum_entropy import Descent
from featreg.focusing.phase_error import Band, at_quick_length
from featreg.focusing.pulse_spectra import PulseSpectra, default_workers, grouped, pulse_spectra
from featreg.focusing.range_cells import cell_energies, choose_cells, count_points
from featreg.focusing.result import FocusResult
from featreg.interfaces import Detector
from featreg.io import SMALLEST, ImageLike, as_image
from featreg.registry import create, entry
from featreg.runtime.parameters import Count, Share, checked
from featreg.runtime.threads import worker_count
from featreg.runtime.watching import Canceller, Progress
from featreg.types import BoolArray, FloatArray, Image, IntArray, read_only, verdict

C64 = NDArray[np.complex64]

#: The plain forms of the PMEA paper and of those it compares with.
PAPER = ("pmea-paper", "mea-paper", "mca-paper", "pga-paper")
METHODS = ("auto", "mea", "pmea", "mca", "pga", "legendre", *PAPER)
#: Share of the range cells where none is given; PGA and the parametric phase take them all.
FRACTIONS = {
    "mea": 0.1, "pmea": 0.1, "mca": 0.1, "pga": 1.0, "legendre": 1.0,
    "pmea-paper": 0.05, "mea-paper": 0.05, "mca-paper": 0.05, "pga-paper": 1.0,
}  # fmt: skip
#: `auto` begins with this share, but no less than so many cells, and stops at so many samples.
FIRST, FEWEST, MOST_SAMPLES = 0.1, 64, 1 << 22


@dataclass(frozen=True, eq=False)
class _Settings:
    """The arguments of `focus`, checked."""

    method: str
    axis: int
    fraction: float | None
    normalize: bool
    detector: str | Detector
    max_iterations: int
    detrend: bool
    workers: int
    each: Callable[[int], None]


@checked("focus")
def focus(
    image: ImageLike,
    method: str = "auto",
    *,
    azimuth_axis: Annotated[int, Interval(ge=0, le=1)] = 0,
    fraction: Share | None = None,
    normalize: bool = True,
    detector: str | Detector = "prewitt",
    max_iterations: Count = 60,
    detrend: bool = False,
    carrier: ArrayLike | None = None,
    range_blocks: int = 1,
    workers: Count | None = None,
    progress: Progress | None = None,
    cancel: Canceller | None = None,
) -> FocusResult:
    """Estimate the phase error of every pulse from a complex image, and remove it.

    Parameters
    ----------
    image : path, (H, W) complex array or `Image`; samples that are not data, and NaN, count as 0
    method : "mea" (minimum entropy), "pmea" (the same on the range cells with most feature points), "mca" (maximum
        contrast), "pga" (phase gradient), "legendre" (minimum entropy of a polynomial of degree 8), "auto", or as
        published "pmea-paper", "mea-paper", "mca-paper", "pga-paper"
    azimuth_axis : 0 where azimuth runs down the columns and every column is a range cell, 1 where it runs along rows
    fraction : share of the range cells that are looked at, in (0, 1]; default 0.1 for mea, pmea and mca, 0.05 for them
        as published, all for legendre, as many as needed for auto. pga takes all
    normalize : weight range cells alike. Without it, the strongest decide, and a row of strong scatterers in one of
        them is collapsed to a point: entropy falls below that of the true image, with a wrong phase
    detector : any registered detector, by name or made: whose points pmea counts
    max_iterations : at most so many; fewer where the phase settles before
    detrend : take the part of the phase out that moves the image's centre of mass in azimuth, and its mean
    carrier : (H, W) factor that the image is multiplied by before, and divided by after: of back-projected images
        `featreg.carrier(history, grid)`
    range_blocks : blocks of range cells with a phase each, where the error changes with range
    workers : threads; default the cores, or as many as OpenCV and OMP_NUM_THREADS allow. They do not change the result
    progress : called with the iterations done and the most there can be
    cancel : when set, the work stops with a `CancelledError`

    Returns
    -------
    FocusResult

    Raises
    ------
    InputError
        A real image, which has no phase; one that cannot be read, is smaller than 16 x 16 or holds only zeros.
    ParameterError, UnknownNameError
        An unknown method or detector, or an impossible value.

    Notes
    -----
    Minimum-entropy autofocus on Prewitt feature points, PMEA (equations are numbered as in its paper), and the methods
    that it is compared with. Departures: range cells are brought to equal energy (see `normalize`); minimum entropy
    begins with eight steps of maximum contrast; feature points are counted in the image as minimum entropy on its
    strongest cells focuses it, so that the choice of cells hardly depends on the blur. The "-paper" methods depart in
    none of these: energies are kept whatever `normalize` is, 5 % of the cells (the paper's section 3.1), points counted
    in the image as it is, the fixed point of the entropy alone, PGA's window free to shrink.

    "auto" begins with a polynomial, frees the phase of every pulse, and takes all cells where
    the halves of the strongest disagree.

    Entropy alone is no evidence: a wrong phase may lower it. "ok" needs that the two halves of the range cells find the
    same phase, that the phase does not move when minimum entropy goes on from it, and that either half's phase sharpens
    the other half. Homogeneous speckle carries no information on the phase, and fails.

    The column spectrum of a back-projected image is an axis of pulses only after its carrier was taken out.
    """
    settings = _settings(
        method, azimuth_axis, fraction, normalize, detector, max_iterations, detrend, workers, progress, cancel
    )
    pixels, mask, name = _samples(image)
    factor = _carrier(carrier, pixels.shape)
    pixels = pixels if factor is None else np.multiply(pixels, factor, dtype=np.complex64)
    cells = pixels.shape[1 - azimuth_axis]
    if not isinstance(range_blocks, int | np.integer) or not 1 <= range_blocks <= cells // SMALLEST:
        raise ParameterError(
            f"range_blocks must be a whole number from 1 to {cells // SMALLEST} ({SMALLEST} range cells each), "
            f"got {range_blocks!r}"
        )
    energy = cell_energies(pixels, azimuth_axis, mask, workers=settings.workers)
    if not np.isfinite(energy).all():
        raise InputError(f"{name}: samples overflow float32; scale the image down")
    if not energy.any():
        raise InputError(f"{name}: holds only zeros, there is nothing to focus")
    before = image_entropy(pixels, workers=settings.workers)
    if range_blocks > 1:
        from featreg.focusing.range_blocks import focus_blocks

        edges = np.linspace(0, cells, int(range_blocks) + 1).round().astype(int).tolist()
        result = focus_blocks(
            pixels, mask, azimuth_axis, edges, before, settings.workers, partial(_whole, settings=settings)
        )
    else:
        result = _whole(pixels, energy, before, settings=settings)
    if factor is None:
        return result
    restored = result.image.copy() if result.image is pixels else result.image
    restored.flags.writeable = True
    restored /= factor
    return replace(result, image=read_only(restored))


def _whole(pixels: NDArray[Any], energy: FloatArray, before: float, *, settings: _Settings) -> FocusResult:
    """Focus with one phase for all range cells."""
    out = np.empty(pixels.shape, np.complex64)
    chosen, found, band, check = _estimated(pixels, energy, out, settings)
    phase = band.detrended(found.phase) if settings.detrend else found.phase
    apply_phase(pixels, phase, settings.axis, out, workers=settings.workers)
    after = image_entropy(out, workers=settings.workers)
    gates = gates_of(len(chosen), len(band.order), check, (before, after))
    return FocusResult(
        read_only(out), phase, found.entropy, found.iterations, chosen, *verdict(gates, reason_of),
        check.deviation, (before, after), gates, settings.method, (0, pixels.shape[1 - settings.axis]),
    )  # fmt: skip


def _estimated(
    pixels: NDArray[Any], energy: FloatArray, scratch: C64, settings: _Settings
) -> tuple[IntArray, Descent, Band, autofocus.Check]:
    """Cells, estimate, the band of pulses, and the estimate's check."""

    def spectra(cells: IntArray) -> PulseSpectra:
        made = pulse_spectra(pixels, settings.axis, cells, normalize=settings.normalize, workers=settings.workers)
        return made if settings.method in PAPER else at_quick_length(made)

    def in_image(found: Descent, cells: PulseSpectra) -> tuple[Descent, Band]:
        return replace(found, phase=cells.in_image(found.phase)), Band.of(cells.in_image(cells.power()))

    def band_of(cells: PulseSpectra) -> Band:
        return Band.of(cells.power())

    steps, each = settings.max_iterations, settings.each
    if settings.method == "auto":
        pulses = pixels.size // len(energy)
        found, used, check = autofocus.automatic(
            lambda wide: spectra(_automatic_cells(energy, pulses, settings, wide)),
            band_of,
            max_iterations=steps,
            each=each,
        )
        return used.index, *in_image(found, used), check
    given = None if settings.method in ("pga", "pga-paper") else settings.fraction
    fraction = FRACTIONS[settings.method] if given is None else given
    chosen = choose_cells(energy, fraction)
    if settings.method in ("pmea", "pmea-paper"):
        seen: NDArray[Any] = pixels
        if settings.normalize:
            strong = spectra(chosen)
            band = band_of(strong)
            first = autofocus.estimate("mea", strong, band, max_iterations=steps, each=each)
            phase = band.at_a_sample(first.phase, strong)
            seen = apply_phase(pixels, strong.in_image(phase), settings.axis, scratch, workers=settings.workers)
        chosen = choose_cells(energy, fraction, _counts(seen, len(energy), settings))
    cells = spectra(chosen)
    band = band_of(cells)
    estimate = partial(autofocus.estimate, settings.method, band=band, max_iterations=steps)
    found = estimate(cells, each=each)
    if settings.method == "legendre":
        free = autofocus.refined(cells, band, steps, each)
        free_check = autofocus.check(cells, band, free.phase, lambda part: autofocus.refined(part, band, steps, None))
        parametric_check = autofocus.check_parametric(cells, band, found.phase, free.phase, free_check)
        return chosen, *in_image(found, cells), parametric_check
    return chosen, *in_image(found, cells), autofocus.check(cells, band, found.phase, estimate)


def _automatic_cells(energy: FloatArray, pulses: int, settings: _Settings, wide: bool) -> IntArray:
    """The strongest cells, or groups spread over all of them up to the limit of samples."""
    if settings.fraction is not None:
        return choose_cells(energy, settings.fraction)
    if not wide:
        return choose_cells(energy, min(1.0, max(FIRST, FEWEST / len(energy))))
    every = choose_cells(energy, 1.0)
    groups = grouped(every)
    step = max(1, -(-len(every) * pulses // MOST_SAMPLES))
    return np.concatenate([every[start:stop] for start, stop in groups[::step]])


def _counts(pixels: NDArray[Any], cells: int, settings: _Settings) -> IntArray:
    """Feature points per range cell."""
    detector = settings.detector
    if isinstance(detector, str):
        # Every point counts, not only the best that a matcher would want.
        most = {"n_features": max(5000, pixels.size // 16)}
        has_budget = "n_features" in entry("detector", detector).parameters
        detector = create("detector", detector, **(most if has_budget else {}))
    amplitude = np.abs(pixels)
    found = detector.detect_features(Image(amplitude, np.ones(pixels.shape, np.bool_)))
    return count_points(found.xy, settings.axis, cells)


def _settings(
    method: str,
    azimuth_axis: int,
    fraction: float | None,
    normalize: bool,
    detector: str | Detector,
    max_iterations: int,
    detrend: bool,
    workers: int | None,
    progress: Progress | None,
    cancel: Canceller | None,
) -> _Settings:
    if method not in METHODS:
        raise ParameterError(f"unknown autofocus method {method!r}, {suggest(str(method), METHODS)}")
    if isinstance(detector, str):
        entry("detector", detector)
    elif not isinstance(detector, Detector):
        raise ParameterError(f"detector must be the name of one or a Detector, got {type(detector).__name__}")

    def each(done: int) -> None:
        if cancel is not None and cancel.is_set():
            raise CancelledError("autofocus was cancelled")
        if progress is not None:
            progress(done, max_iterations)

    count = worker_count(workers, default_workers())
    return _Settings(
        method,
        azimuth_axis,
        fraction,
        bool(normalize) and method not in PAPER,
        detector,
        int(max_iterations),
        bool(detrend),
        count,
        each,
    )


def _samples(image: ImageLike) -> tuple[NDArray[Any], BoolArray | None, str]:
    """Complex samples without copying them where that can be, which of them are data, and a name for messages."""
    if isinstance(image, Image | str | Path):
        made = as_image(image)
        if not made.is_complex:
            raise InputError(f"{made.name}: holds real samples, whose phase is lost; autofocus needs a complex image")
        return made.pixels, None if made.all_valid else made.mask, made.name
    if not hasattr(image, "__array__"):
        raise InputError(f"cannot focus {type(image).__name__}; give a path, a 2-D complex array or a featreg Image")
    array = np.asarray(image)
    if array.dtype.kind != "c":
        raise InputError(f"array: holds {array.dtype} samples, whose phase is lost; autofocus needs a complex image")
    if array.ndim != 2 or min(array.shape) < SMALLEST:
        raise InputError(f"array: has shape {array.shape}, (H, W) of at least {SMALLEST} x {SMALLEST} is needed")
    if not isinstance(image, np.ma.MaskedArray) and all(np.isfinite(row.sum()) for row in array):
        return array, None, "array"
    made = as_image(image)
    return made.pixels, made.mask, "array"


def _carrier(carrier: ArrayLike | None, shape: tuple[int, ...]) -> NDArray[Any] | None:
    if carrier is None:
        return None
    factor = np.asarray(carrier)
    if factor.shape != shape or factor.dtype.kind != "c" or not (np.abs(factor) > 0).all():
        raise InputError(
            f"carrier must be a complex factor of the image's shape {shape}, nowhere 0, got {factor.dtype} "
            f"{factor.shape}; make it with featreg.carrier(history, grid)"
        )
    return factor
