"""What samples mean: amplitude, intensity, decibels or complex, brought to linear amplitude or complex64."""

from __future__ import annotations

import logging
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.errors import InputError
from featreg.runtime.threads import in_parts
from featreg.types import BoolArray

SCALES = ("amplitude", "intensity", "db", "complex")
DB_RANGE = (-90.0, 60.0)
#: Share of samples outside that range from which they are no decibels.
MOST_OUTSIDE = 0.5
DB_NEGATIVE_SHARE = 0.01
#: A distribution is that of linear samples where its upper tail (median to 99th percentile) is so many times as long as
#: its lower one. Speckle of one look: 6 in intensity, 0.4 in decibels; of four 2.2 and 0.7, but where noise was removed
#: the scene holds dark and bright ground and the ratio is above 5. Decibels of a dark sea with a bright coast reach 2.
LINEAR_TAIL = 3.0
#: Linear samples of which a larger share is negative are none, whatever they are called.
MOST_NEGATIVE = 0.5
#: What noise removal leaves below 0 is at most so large, its median over the 99th percentile of all samples.
SMALL_NEGATIVE = 0.1

WORDS = {
    "db": ("db", "decibel", "decibels"),
    "amplitude": ("amplitude", "magnitude", "amp", "mag"),
    "intensity": ("intensity", "power"),
    "backscatter": ("sigma0", "gamma0", "beta0", "sigma", "gamma", "beta", "nrcs"),
}
#: Median of a backscatter coefficient at most, 10 dB: no ground scatters so much, and what is above is something else
#: that is called so.
MOST_BACKSCATTER = 10.0

#: Those by which also the name of a file tells: no other thing is called so.
FILE_WORDS = {"db": ("db",), "backscatter": ("sigma0", "gamma0", "beta0", "nrcs")}

logger = logging.getLogger("featreg.io")


class NoContentError(InputError):
    """There is nothing on an image: too few pixels, none that is valid, or one value everywhere."""


def real_pixels(
    samples: NDArray[Any],
    valid: BoolArray | None,
    scale: str | None,
    name: str,
    owned: bool,
    content: bool = True,
    said: str | None = None,
) -> tuple[NDArray[np.float32], BoolArray | None, str]:
    """Return amplitude, the mask (None = all valid) and the scale the samples had.

    Parameters
    ----------
    samples : (H, W) real
    valid : (H, W) bool known so far, None = all; not changed
    scale : as stated, or None
    name : what the image is called in messages
    owned : whether `samples` may be kept instead of copied
    content : whether one value, or none, is an error; a window of a scene may hold nothing
    said : what the names and units of the file say the samples are, see `scale_in_words`; it counts where the samples
        themselves leave a choice

    Raises
    ------
    InputError
        The scale cannot be told, or nothing but one value is left.
    """
    if samples.size and scale in (None, "amplitude"):
        # The common case in two quick passes: NaN fails both comparisons.
        low, high = _extremes(samples)
        plain = scale is not None or said is None or samples.dtype.kind != "f"
        plain = plain or (valid is None and _by_words(said, samples.dtype, samples) == "amplitude")
        if plain and low >= 0 and high <= np.finfo(np.float32).max:
            if valid is None and low == high and content:
                raise NoContentError(_constant(name, float(low)))
            pixels = _as_float32(samples, owned)
            if valid is not None and content:
                check_content(pixels, valid, name)
            return pixels, None if valid is None else valid.copy(), "amplitude"
    # Small integers and halves become float32, which holds them all; numpy would take their root in half precision.
    values = samples.astype(np.result_type(samples.dtype, np.float32), copy=False)
    known = np.isfinite(values)
    valid = known if valid is None else valid & known
    negative = (values < 0) & valid
    below = int(np.count_nonzero(negative))
    if scale is None:
        if below:
            scale = _inferred_scale(values[valid], below, name, said)
        else:
            scale = _by_words(said, samples.dtype, values[valid]) if valid.any() else "amplitude"
    elif scale == "db" and content:
        _check_decibels(values[valid], name)
    if below and scale == "intensity":
        # What the subtraction of noise leaves below zero is data: ground that is very dark.
        values = np.maximum(values, 0)
        logger.info("%s: %d negative intensities count as 0", name, below)
    elif below and scale == "amplitude":
        valid &= ~negative
        level = logging.WARNING if content else logging.DEBUG  # once a scene, not once a window
        logger.log(level, "%s: %d negative samples cannot be amplitude and were masked", name, below)
    with np.errstate(all="ignore"):  # samples that are not valid may do anything here
        if scale == "db":
            values = 10.0 ** (values / 20.0)
        elif scale == "intensity":
            values = np.sqrt(values)
        pixels = values.astype(np.float32, order="C", copy=not owned and np.may_share_memory(values, samples))
    valid &= np.isfinite(pixels)
    if content:
        check_content(pixels, valid, name)
    return pixels, valid, scale


def _extremes(samples: NDArray[Any]) -> tuple[Any, Any]:
    """The least and the greatest sample; NaN where one is NaN."""
    found: list[tuple[Any, Any]] = []

    def part(first: int, stop: int) -> None:
        found.append((samples[first:stop].min(), samples[first:stop].max()))

    in_parts(part, len(samples), samples[0].size)
    lows, highs = zip(*found, strict=True)
    return np.min(lows), np.max(highs)


def _as_float32(samples: NDArray[Any], owned: bool) -> NDArray[np.float32]:
    """Samples as contiguous float32; themselves where they are and may be kept."""
    if owned and samples.dtype == np.float32 and samples.flags.c_contiguous:
        return samples
    pixels = np.empty(samples.shape, np.float32)

    def part(first: int, stop: int) -> None:
        pixels[first:stop] = samples[first:stop]

    in_parts(part, len(samples), samples[0].size)
    return pixels


def _check_decibels(values: NDArray[Any], name: str) -> None:
    """Raise where most samples can be no decibels, as linear ones that somebody calls so."""
    outside = _share_outside(values)
    if outside > MOST_OUTSIDE:
        raise InputError(
            f"{name}: scale 'db' cannot be: {100 * outside:.0f} % of the samples lie outside "
            f"{DB_RANGE[0]:g} to {DB_RANGE[1]:g} dB (they reach from {float(values.min()):.4g} to "
            f"{float(values.max()):.4g}); leave the scale out, or state amplitude or intensity"
        )


def _share_outside(values: NDArray[Any]) -> float:
    """Share of samples that can be no decibels."""
    return float(((values < DB_RANGE[0]) | (values > DB_RANGE[1])).mean()) if values.size else 0.0


def complex_pixels(
    samples: NDArray[Any], valid: BoolArray | None, name: str, owned: bool, content: bool = True
) -> tuple[NDArray[np.complex64], BoolArray | None]:
    """Return complex64 samples and the mask (None = all valid); arguments and errors as in `real_pixels`."""
    with np.errstate(over="ignore"):
        pixels = samples.astype(np.complex64, order="C", copy=not owned)
    known = np.isfinite(pixels)
    if valid is not None:
        known &= valid
    if content:
        check_content(pixels, known, name)
    return pixels, None if known.all() else known


def check_content(pixels: NDArray[Any], valid: BoolArray, name: str) -> None:
    """Raise `NoContentError` where no pixel is valid or all valid ones hold the same value."""
    if not valid.any():
        reason = "holds no valid pixel (all are NaN, infinite, nodata or masked)"
        raise NoContentError(f"{name}: {reason}; check the file, mask= and nodata=")
    first = pixels[np.unravel_index(int(valid.argmax()), valid.shape)]
    # A row tells in nearly every case.
    rows = slice(len(pixels) // 2, len(pixels) // 2 + 1), slice(None)
    if not any(((pixels[some] != first) & valid[some]).any() for some in rows):
        raise NoContentError(_constant(name, first))


def scale_in_words(*texts: str | None) -> str | None:
    """Return what the name or unit of a band states ("Sigma0_VV_db", "Intensity_VH", "dB").

    A scale, "backscatter" for a coefficient, which its samples must bear out, or None.
    """
    words = set(re.split(r"[^a-z0-9]+", " ".join(text for text in texts if text).lower()))
    return next((scale for scale, known in WORDS.items() if words.intersection(known)), None)


def scale_in_name(stem: str) -> str | None:
    """Return the scale that the name of a file states which says nothing inside ("..._VV_gamma0-rtc_db"), or None."""
    words = set(re.split(r"[^a-z0-9]+", stem.lower()))
    found = next((scale for scale, known in FILE_WORDS.items() if words.intersection(known)), None)
    # "gamma0_amplitude" is the root of the coefficient.
    return scale_in_words(stem) if found == "backscatter" else found


def _inferred_scale(values: NDArray[Any], below: int, name: str, said: str | None) -> str:
    """Return the scale of valid samples, `below` of them negative, where it can be told without a silent guess."""
    low, high = values.min(), values.max()
    share = below / values.size
    said = scale_of_words(said)
    in_range = DB_RANGE[0] <= low and high <= DB_RANGE[1]
    if said == "db" and _share_outside(values) > MOST_OUTSIDE:
        logger.warning("%s: is called decibels, but most of its values cannot be: the word was left out", name)
        said = None
    if said in ("amplitude", "intensity") and in_range and share > MOST_NEGATIVE:
        message = "%s: is called %s, but %.0f %% of its values are negative: taken as decibels; state scale= to be sure"
        logger.warning(message, name, said, 100 * share)
        return "db"
    if said is not None:
        logger.info("%s: %d negative samples; the file's own words say %s", name, below, said)
        return said
    if _noise_removed(values):
        message = (
            "%s: values %.4g .. %.4g, %.2g %% of them small negatives below a long upper tail, were taken as intensity "
            "with its noise removed; state scale= to be sure"
        )
        logger.warning(message, name, low, high, 100 * share)
        return "intensity"
    if in_range and share >= DB_NEGATIVE_SHARE:
        message = "%s: values %.4g .. %.4g, %.0f %% of them negative, were taken as decibels; state scale= to be sure"
        logger.warning(message, name, low, high, 100 * share)
        return "db"
    raise InputError(
        f"{name}: {below} samples are negative (lowest {low:.6g}), so it is no amplitude and its scale cannot be told; "
        "state scale='amplitude', 'intensity' or 'db', or the nodata value as nodata="
    )


def _by_words(said: str | None, dtype: np.dtype[Any], values: NDArray[Any]) -> str:
    """Return the scale of valid samples none of which is negative; `dtype` is that in which they are stored.

    What the file says counts for numbers that are no whole ones, where they can be decibels or a backscatter
    coefficient; digital numbers are amplitudes whatever they are called.
    """
    if said is None or dtype.kind != "f":
        return "amplitude"
    if said == "db":
        return "db" if float(values.max()) <= DB_RANGE[1] else "amplitude"
    if said == "backscatter":
        return "intensity" if float(np.median(values)) <= MOST_BACKSCATTER else "amplitude"
    return said


def scale_of_words(said: str | None) -> str | None:
    """Return the scale that is meant by what `scale_in_words` found: a backscatter coefficient is an intensity."""
    return "intensity" if said == "backscatter" else said


def _noise_removed(values: NDArray[Any]) -> bool:
    """Whether samples some of which are negative are distributed as linear ones from which noise was subtracted."""
    low, middle, high = np.quantile(values, [0.01, 0.5, 0.99])
    if not middle > 0:
        return False
    deep = float(np.median(-values[values < 0]))
    return bool(high - middle >= LINEAR_TAIL * (middle - low) and deep <= SMALL_NEGATIVE * high)


def _constant(name: str, value: complex) -> str:
    return f"{name}: every valid pixel holds the same value ({value:.6g}), an image with content is needed"
