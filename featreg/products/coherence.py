"""Interferometric coherence of two co-registered complex images."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.errors import InputError, ParameterError
from featreg.types import FloatArray, Image

#: Nodes of the table that the correction of the bias looks up.
NODES = 100
#: Points of the integral over its density.
POINTS = 300


def coherence(
    reference: Image | NDArray[Any],
    aligned: Image | NDArray[Any],
    *,
    window: int | tuple[int, int] = 5,
    correct_bias: bool = False,
    looks: float | None = None,
) -> NDArray[np.float32]:
    """Return the magnitude of the complex coherence of two images of one grid.

    Parameters
    ----------
    reference, aligned : (H, W) complex arrays, NaN = no data, or complex `Image`
    window : side of the boxcar in pixels, or (rows, columns); odd, so that it has a centre
    correct_bias : take out the mean overestimate at low coherence
    looks : independent samples in a full window, for the correction; without it as many as the window has pixels, too
        many where the image is oversampled

    Returns
    -------
    (H, W) float32, 0 to 1; NaN where fewer than half of the window's pixels are data in both images, and where one of
    them holds nothing but 0

    Raises
    ------
    InputError
        Images that are not complex or not of one size.
    ParameterError
        An impossible window or number of looks.

    Notes
    -----
    ``|sum a conj(b)| / sqrt(sum |a|^2 sum |b|^2)``, sums in float64 over the pixels valid in both. The estimate is
    biased: two unrelated images give about ``sqrt(pi / (4 L))`` with L looks. `correct_bias` inverts the mean of the
    estimator [1]_, so that the mean is right well above the level of no coherence; what lies below it becomes 0, and
    the scatter grows. Fringes within the window lower the coherence: nothing is flattened.

    References
    ----------
    .. [1] R. Touzi, A. Lopes, J. Bruniquel, P. W. Vachon, Coherence estimation for SAR imagery, IEEE Trans. Geoscience
       and Remote Sensing, 1999, doi:10.1109/36.739146
    """
    rows, cols = window_size(window)
    count = float(rows * cols) if looks is None else float(looks)
    if not 2 <= count <= rows * cols:
        raise ParameterError(f"looks must be 2 to {rows * cols}, the pixels of the window, got {looks}")
    a, valid_a = _samples(reference, "reference")
    b, valid_b = _samples(aligned, "aligned")
    if a.shape != b.shape:
        raise InputError(f"the two images must have one shape (H, W), got {a.shape} and {b.shape}")
    import cv2

    both = valid_a & valid_b

    def summed(values: NDArray[Any]) -> FloatArray:
        options: Any = {"normalize": False, "borderType": cv2.BORDER_CONSTANT}
        return np.asarray(cv2.boxFilter(values.astype(np.float64), cv2.CV_64F, (int(cols), int(rows)), **options))

    a, b = np.where(both, a, 0), np.where(both, b, 0)
    cross = a * b.conj()
    across = np.hypot(summed(cross.real), summed(cross.imag))
    power_a, power_b, known = summed(_power(a)), summed(_power(b)), summed(both)
    # Counted, since a running sum of powers leaves rounding errors behind where there is nothing.
    lit = (summed(a != 0) > 0.5) & (summed(b != 0) > 0.5) & (power_a > 0) & (power_b > 0)
    found = np.divide(across, np.sqrt(power_a * power_b, where=lit, out=np.ones_like(across)), where=lit, out=across)
    found = np.minimum(found, 1.0)
    if correct_bias:
        true, mean = _bias(count)
        found = np.interp(found, mean, true)
    return np.where(lit & (known >= 0.5 * rows * cols), found, np.nan).astype(np.float32)


def window_size(window: int | tuple[int, int]) -> tuple[int, int]:
    """Return (rows, columns) of a window; a `ParameterError` where it is no window of `coherence`."""
    sides = window if isinstance(window, tuple) and len(window) == 2 else (window, window)
    rows, cols = (n if isinstance(n, int | np.integer) else 0 for n in sides)
    if rows < 1 or cols < 1 or rows % 2 == 0 or cols % 2 == 0 or rows * cols < 2:
        raise ParameterError(f"window must be an odd number of pixels or two (rows, columns), not 1 x 1, got {window}")
    return rows, cols


def expected_coherence(true: float, looks: float) -> float:
    """Return the mean of the estimate for a true coherence magnitude and a number of independent looks (>= 2)."""
    return float(_expected(np.array([true], np.float64), looks)[0])


def _expected(true: FloatArray, looks: float) -> FloatArray:
    """Means of the estimate (N,), from its density, equation (16) of Touzi et al. (1999).

    Euler's transformation of the hypergeometric function leaves a series of positive terms, summed as logarithms:
    2F1(L, L; 1; z) = (1 - z)^(1 - 2 L) 2F1(1 - L, 1 - L; 1; z).
    """
    from scipy.special import gammaln, logsumexp

    nodes, weights = np.polynomial.legendre.leggauss(POINTS)
    d, weights = 0.5 * (nodes + 1.0), 0.5 * weights
    k = np.arange(1, int(looks) + 60)
    with np.errstate(divide="ignore"):
        terms = np.concatenate([[0.0], np.cumsum(2.0 * np.log(np.abs(k - looks) / k))])
    means = np.empty(len(true))
    for i, t in enumerate(true.tolist()):
        if t <= 0.0 or t >= 1.0:
            means[i] = 1.0 if t >= 1.0 else np.exp(gammaln(looks) + gammaln(1.5) - gammaln(looks + 0.5))
            continue
        log_z = 2.0 * np.log(t * d)
        series = logsumexp(terms + log_z[:, None] * np.arange(len(terms)), axis=1)
        log_density = np.log(d) + (looks - 2.0) * np.log1p(-d * d) + (1.0 - 2.0 * looks) * np.log1p(-np.exp(log_z))
        log_density += series
        density = weights * np.exp(log_density - log_density.max())
        means[i] = (density * d).sum() / density.sum()
    return means


@lru_cache(maxsize=8)
def _bias(looks: float) -> tuple[FloatArray, FloatArray]:
    true = np.sin(np.linspace(0.0, 0.5 * np.pi, NODES))
    return true, np.maximum.accumulate(_expected(true, looks))


def _samples(image: Image | NDArray[Any], what: str) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    pixels = image.pixels if isinstance(image, Image) else np.asarray(image)
    if pixels.ndim != 2 or pixels.dtype.kind != "c":
        raise InputError(f"coherence needs complex (H, W) images, the {what} image is {pixels.dtype} {pixels.shape}")
    return pixels, np.asarray(np.isfinite(pixels) & (image.mask if isinstance(image, Image) else True))


def _power(samples: NDArray[Any]) -> FloatArray:
    return np.asarray(samples.real.astype(np.float64) ** 2 + samples.imag.astype(np.float64) ** 2)
