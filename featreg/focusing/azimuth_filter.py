"""A phase over the pulses applied to a whole image, in strips, and the image's entropy before and after."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.focusing.pulse_spectra import STRIP, run
from featreg.types import FloatArray

C64 = NDArray[np.complex64]


def apply_phase(image: NDArray[Any], phase: FloatArray, azimuth_axis: int, out: C64, *, workers: int = 1) -> C64:
    """Write ``ifft(fft(image) * exp(-1j phase))`` along the azimuth into `out`, and return it.

    Parameters
    ----------
    image : (H, W) complex; may be `out` itself
    phase : (N,) radians in the order of the FFT
    azimuth_axis : 0 or 1
    out : (H, W) complex64
    """
    from scipy.fft import fft, ifft

    lines, written = (image.T, out.T) if azimuth_axis == 0 else (image, out)
    turn = np.exp(-1j * phase).astype(np.complex64)
    most = max(1, STRIP // lines.shape[1])

    def task(top: int) -> None:
        rows = slice(top, top + most)
        # A copy, never a view: the transform works in place.
        spectra = fft(np.array(lines[rows], np.complex64), axis=1, overwrite_x=True)
        written[rows] = ifft(spectra * turn, axis=1, overwrite_x=True)

    run(task, range(0, len(lines), most), workers)
    return out


def image_entropy(image: NDArray[Any], *, workers: int = 1) -> float:
    """Return the Shannon entropy of an image's power in nats (Eq. 1 and 2), 0 where there is no power.

    Parameters
    ----------
    image : (H, W) real amplitude or complex
    """
    most = max(1, STRIP // image.shape[1])
    tops = range(0, len(image), most)

    def powers(top: int) -> FloatArray:
        part = image[top : top + most]
        return np.asarray(part.real.astype(np.float64) ** 2 + part.imag.astype(np.float64) ** 2)

    total = float(sum(run(lambda top: float(powers(top).sum()), tops, workers)))
    if total == 0:
        return 0.0

    def task(top: int) -> float:
        share = powers(top) / total
        return float(np.sum(share * np.log(np.maximum(share, 1e-300))))

    return -float(sum(run(task, tops, workers)))
