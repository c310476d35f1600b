"""Which band of a file is meant, and what is made of several: luminance of colours, complex samples of I and Q."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from featreg.errors import InputError, ParameterError, suggest
from featreg.io.calibration import Factor, calibrated, factor_of
from featreg.io.reader import Band, Raster, Reader, physical
from featreg.io.window import Window

#: How a band is asked for: its number from 1, its name, "iq" (or "iq:VV"), "rgb"; None where there is no choice.
BandLike = str | int | None
#: Weights of red, green and blue in the luminance of Rec. 601.
LUMINANCE = (0.299, 0.587, 0.114)
COLOURS = ("red", "green", "blue")
#: Words by which the real and the imaginary part go.
IN_PHASE, QUADRATURE = ("i", "real", "re"), ("q", "imag", "im")
#: Bands that a message lists.
LISTED = 24
#: Sides of an image; what is smaller in a file of many datasets is a table.
LEAST_SIDE = 16


@dataclass(frozen=True)
class Choice:
    """What to read of a file: one band, the luminance of three, or complex samples of two; counted from 0."""

    how: Literal["one", "luminance", "iq"]
    bands: tuple[int, ...]


def check_band(band: Any) -> None:
    """Raise a `ParameterError` where no band can be asked for so."""
    if band is None or (isinstance(band, str) and band.strip()):
        return
    if isinstance(band, bool) or not isinstance(band, int | np.integer) or band < 1:
        raise ParameterError(f"band must be a name such as 'VV', a number from 1, 'iq' or 'rgb', got {band!r}")


def choose(bands: Sequence[Band], asked: BandLike, source: str) -> Choice:
    """Return what is to be read of a file.

    Parameters
    ----------
    bands : of the file
    asked : as the user named it: a name or a word of one ("VV" of "Sigma0_VV"), a number from 1, "iq" for complex
        samples of an I and a Q band, "iq:VV" where there are several such pairs, "rgb" for the luminance of three
        colours
    source : what the file is called in messages

    Raises
    ------
    InputError
        The file holds no such band, several that go by this name, or several and none was named.
    """
    check_band(asked)
    if not bands:
        raise InputError(f"{source}: holds no image, a 2-D array of numbers is needed")
    if asked is None:
        return _only(bands, source)
    text = str(asked).strip()
    if text.isdecimal():
        if not 1 <= int(text) <= len(bands):
            count = f"{len(bands)} bands" if len(bands) > 1 else "one band"
            raise InputError(f"{source}: has {count}, band {text} was asked for; it holds {listing(bands)}")
        return Choice("one", (int(text) - 1,))
    kind, _, more = text.partition(":")
    if kind.lower() == "iq":
        return _in_phase(bands, more, source)
    if text.lower() == "rgb":
        colours = _colours(bands, range(len(bands)))
        if colours is None:
            raise InputError(f"{source}: does not say which bands are red, green and blue; it holds {listing(bands)}")
        return colours
    return Choice("one", (_named(bands, text, source),))


def _only(bands: Sequence[Band], source: str) -> Choice:
    data = [i for i, band in enumerate(bands) if band.role not in ("alpha", "coordinate")]
    data = data or list(range(len(bands)))
    if len(data) == 1:
        return Choice("one", (data[0],))
    if len(data) == 3 and (colours := _colours(bands, data)) is not None:
        return colours
    images = [i for i in data if min(bands[i].shape) >= LEAST_SIDE]
    if len(images) == 1:
        return Choice("one", (images[0],))
    hint = ", or 'iq' for complex samples" if _pairs(bands, "") else ""
    raise InputError(
        f"{source}: has {len(data)} bands, state which one as band (--band, by name or number){hint}: {listing(bands)}"
    )


def _colours(bands: Sequence[Band], among: Sequence[int]) -> Choice | None:
    found = [[i for i in among if bands[i].role == colour] for colour in COLOURS]
    if any(len(one) != 1 for one in found) or len({bands[one[0]].shape for one in found}) != 1:
        return None
    return Choice("luminance", tuple(one[0] for one in found))


def _in_phase(bands: Sequence[Band], more: str, source: str) -> Choice:
    data = [i for i, band in enumerate(bands) if band.role != "alpha"]
    pairs = _pairs(bands, more)
    if not pairs and not more and len(data) == 2:
        pairs = [(data[0], data[1])]
    if len(pairs) != 1:
        why = "no I and Q band" if not pairs else f"{len(pairs)} pairs of I and Q, write iq:NAME"
        raise InputError(f"{source}: holds {why}{f' of {more!r}' if more else ''}; it holds {listing(bands)}")
    i, q = pairs[0]
    if bands[i].shape != bands[q].shape or bands[i].is_complex or bands[q].is_complex:
        raise InputError(f"{source}: I and Q must be two real bands of one size, got {listing([bands[i], bands[q]])}")
    return Choice("iq", (i, q))


def _pairs(bands: Sequence[Band], more: str) -> list[tuple[int, int]]:
    """Bands whose names differ in the word for the part only."""
    rest: dict[tuple[str, ...], dict[str, int]] = {}
    for k, band in enumerate(bands):
        words = _words(band.name)
        part = next((w for w in words if w in (*IN_PHASE, *QUADRATURE)), None)
        if part is not None and set(_words(more)) <= set(words):
            key = tuple(w for w in words if w != part)
            rest.setdefault(key, {})["i" if part in IN_PHASE else "q"] = k
    return [(found["i"], found["q"]) for found in rest.values() if len(found) == 2]


def _named(bands: Sequence[Band], text: str, source: str) -> int:
    wanted = text.lower().strip("/")
    ways: tuple[Callable[[str], bool], ...] = (
        lambda name: name.lower().strip("/") == wanted,
        lambda name: name.lower().rpartition("/")[2] == wanted,
        lambda name: set(_words(wanted)) <= set(_words(name)) if _words(wanted) else False,
    )
    for way in ways:
        found = [i for i, band in enumerate(bands) if band.name and way(band.name)]
        if len(found) == 1:
            return found[0]
        if found:
            raise InputError(
                f"{source}: {len(found)} bands go by '{text}', write more of the name: "
                f"{listing([bands[i] for i in found])}"
            )
    names = [name for band in bands for name in {band.name, band.name.rpartition("/")[2]} if name]
    near = f", {suggest(text, names)}" if names else ""
    raise InputError(f"{source}: has no band '{text}'{near}; it holds {listing(bands)}")


def _words(name: str) -> list[str]:
    return [word for word in re.split(r"[^a-z0-9]+", name.lower()) if word]


def listing(bands: Sequence[Band]) -> str:
    """The bands in one line: number, name, dtype, and the size where they differ in it."""
    sizes = {band.shape for band in bands}
    texts = []
    for number, band in enumerate(bands[:LISTED], start=1):
        size = f" {band.shape[1]} x {band.shape[0]}" if len(sizes) > 1 else ""
        name = f" '{band.name}'" if band.name else f" {band.role}" if band.role else ""
        texts.append(f"{number}{name} ({band.dtype}{size})")
    more = f" and {len(bands) - LISTED} more" if len(bands) > LISTED else ""
    return ", ".join(texts) + more


def name_of(bands: Sequence[Band], choice: Choice) -> str | None:
    """How what was chosen is asked for again; None where a file has nothing else."""
    if len(bands) == 1:
        return None
    if choice.how == "luminance":
        return "rgb"
    first = bands[choice.bands[0]]
    if choice.how == "iq":
        words = [w for w in _words(first.name) if w not in IN_PHASE]
        if len(_pairs(bands, "")) < 2:
            return "iq"
        alone = [word for word in words if len(_pairs(bands, word)) == 1]
        return f"iq:{alone[0] if alone else ' '.join(words)}"
    alike = sum(band.name.lower() == first.name.lower() for band in bands)
    if first.name and alike == 1 and not first.name.isdigit() and first.name.lower() not in ("iq", "rgb"):
        return first.name
    return str(choice.bands[0] + 1)


def read_choice(
    reader: Reader, choice: Choice, window: Window | None = None, *, calibrate: str | None = None, called: str = ""
) -> Raster:
    """The samples of what was chosen, with one mask; errors as `Reader.read` and `featreg.io.calibration.factor_of`."""
    factor = None if calibrate is None else _factor(reader, choice, calibrate, called)
    parts = [reader.read(band, window) for band in choice.bands]
    first = parts[0]
    if choice.how == "one":
        if factor is None:
            return first
        height, width = first.samples.shape
        return calibrated(first, factor, window or Window(0, 0, width, height))
    mask = first.mask
    for part in parts[1:]:
        if part.mask is not None:
            mask = part.mask if mask is None else mask & part.mask
    whole = replace(first, mask=mask, nodata=_scaled(first), gain=1.0, offset=0.0, said=None)
    if choice.how == "iq":
        samples = np.empty(first.samples.shape, np.complex64)
        samples.real, samples.imag = physical(parts[0]), physical(parts[1])
        return replace(whole, samples=samples, dtype="complex64")
    return replace(whole, samples=luminance([physical(part) for part in parts]), said=first.said)


def _factor(reader: Reader, choice: Choice, quantity: str, called: str) -> Factor:
    if choice.how != "one":
        raise InputError(f"{called}: nothing says how to calibrate the {choice.how} of several bands to {quantity}")
    return factor_of(reader, choice.bands[0], quantity, called)


def _scaled(raster: Raster) -> float | None:
    """The nodata value as `physical` leaves it among the samples."""
    kind = raster.samples.dtype
    if raster.nodata is None or (raster.gain, raster.offset) == (1.0, 0.0):
        return raster.nodata
    value = np.array([raster.nodata], kind if kind.kind == "f" else np.float64)
    return float((value * raster.gain + raster.offset)[0])


def luminance(colours: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Rec. 601 luminance of red, green and blue (H, W), in their own dtype; whole numbers are rounded."""
    red, green, blue = colours
    total = LUMINANCE[0] * red + LUMINANCE[1] * green.astype(np.float64) + LUMINANCE[2] * blue
    # Of gray pixels it is exactly the gray value, in any dtype.
    total = np.where((red == green) & (green == blue), red, total)
    return (np.rint(total) if red.dtype.kind in "iu" else total).astype(red.dtype)
