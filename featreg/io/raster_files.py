"""The files behind scenes: what they say of themselves, and windows of their samples.

Files stay open, a few for each thread and process. Those that are decoded from their beginning (JPEG, MATLAB) are read
once in each process, and windows are cut from them.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from featreg.io.bands import BandLike, Choice, choose, name_of, read_choice
from featreg.io.nodata import holds_nodata
from featreg.io.opening import band_asked, check_plausible, open_reader
from featreg.io.product_folders import MANIFEST
from featreg.io.reader import Band, Raster, Reader, physical
from featreg.io.scales import real_pixels
from featreg.io.source_names import parse_source
from featreg.io.window import Window
from featreg.types import BoolArray, Geolocation

#: Open files a thread keeps.
OPEN_FILES = 4
#: Side of a square of as many pixels as are read to tell the scale of real samples.
SAMPLE = 1024

#: Names one version of a file: what it is called, size, time of its last change, its number on the disk, and the sizes
#: and times of what lies beside it.
Stamp: TypeAlias = tuple[str, int, int, int, tuple[tuple[str, int, int], ...]]
#: What may lie beside an image and say where it lies, which pixels are data, how its samples are laid out: after its
#: whole name, and in place of its suffix.
AFTER_NAME = (".aux.xml", ".msk", ".hdr", ".xml", ".rsc", ".ovr")
FOR_SUFFIX = (
    *(".hdr", ".HDR", ".aux", ".AUX", ".clr", ".CLR", ".prj", ".PRJ", ".wld", ".WLD", ".tab", ".TAB", ".stx", ".STX"),
    *("_RPC.TXT", "_rpc.txt", ".RPB", ".rpb", ".rdc", ".sgrd", ".gri"),
)

#: How long ago a folder must have changed for its time to tell of every later change: the coarsest clock of a disk.
SETTLED_NS = 2_000_000_000
#: Images of which it is remembered what lies beside them.
MOST_SEEN = 256

_local = threading.local()
#: Image -> the time of its folder, and what lay beside it then.
_seen_beside: dict[str, tuple[int, tuple[str, ...]]] = {}


@dataclass(frozen=True, eq=False)
class Head:
    """What a file says of itself and of the band that is asked for, the samples aside.

    Parameters
    ----------
    driver : what opened it
    bands : of the file
    choice : what is read
    shape, dtype : of that; complex samples of I and Q as complex64
    geolocation : where it lies
    band : how the band is asked for again, None where there is one only
    files : on disk, that hold the samples
    whole : whether it is kept whole, and windows cut from it
    """

    driver: str
    bands: tuple[Band, ...]
    choice: Choice
    shape: tuple[int, int]
    dtype: str
    geolocation: Geolocation | None
    band: str | None
    files: tuple[str, ...]
    whole: bool

    @property
    def first(self) -> Band:
        """The band that is read, the first of several."""
        return self.bands[self.choice.bands[0]]


def stamp_of(source: str) -> Stamp:
    """Names one version of a file; what is missing is left to the opener, whose message says so."""
    known: dict[str, Stamp] | None = getattr(_local, "stamps", None)
    if known is None:
        return _stamp_of(source)
    if source not in known:
        known[source] = _stamp_of(source)
    return known[source]


@contextmanager
def unchanged() -> Iterator[None]:
    """Take the files of scenes for unchanged while the block runs, in this thread: each is looked at once in it.

    GDAL's settings are made once as well, where it is in use.
    """
    outer = getattr(_local, "stamps", None)
    _local.stamps = {} if outer is None else outer
    try:
        # Another thread may just be importing it.
        with getattr(sys.modules.get("rasterio"), "Env", nullcontext)():
            yield
    finally:
        _local.stamps = outer


def _stamp_of(source: str) -> Stamp:
    path = parse_source(source).path
    try:
        known = os.stat(path) if path is not None else None
        if path is not None and path.is_dir() and (path / MANIFEST).is_file():
            known = os.stat(path / MANIFEST)
    except (OSError, ValueError):
        known = None
    if known is None or path is None:
        return source, -1, -1, -1, ()
    return source, known.st_size, known.st_mtime_ns, known.st_ino, _beside(str(path))


def _beside(path: str) -> tuple[tuple[str, int, int], ...]:
    """Name, size and time of everything beside an image that describes it."""
    stem, suffix = os.path.splitext(path)
    # The letters of a world file: .tfw or .tifw of .tif.
    letters = suffix[1:]
    worlds = (f".{letters[:1]}{letters[-1:]}w", f".{letters}w") if letters else ()
    names = [path + end for end in AFTER_NAME]
    names += [stem + end for end in (*FOR_SUFFIX, *worlds, *(world.upper() for world in worlds))]
    began = time.time_ns()
    try:
        changed = os.stat(os.path.dirname(path) or ".").st_mtime_ns
    except (OSError, ValueError):
        changed = began
    # A folder has its time changed where a file in it comes, goes or gets another name.
    seen = _seen_beside.get(path)
    if seen is not None and seen[0] == changed:
        names = list(seen[1])
    found = []
    for name in names:
        try:
            known = os.stat(name)
        except (OSError, ValueError):
            continue
        found.append((name, known.st_size, known.st_mtime_ns))
    if began - changed > SETTLED_NS:
        _seen_beside[path] = changed, tuple(name for name, _, _ in found)
        while len(_seen_beside) > MOST_SEEN:
            _seen_beside.pop(next(iter(_seen_beside)), None)
    return tuple(found)


@lru_cache(maxsize=64)
def read_head(stamp: Stamp, band: BandLike) -> Head:
    """What a file says of itself; errors as `featreg.io.opening.open_reader` and `featreg.io.bands.choose`."""
    source = stamp[0]
    reader = _opened(stamp)
    name = parse_source(source)
    choice = choose(reader.bands, band_asked(name, band), source)
    first = reader.bands[choice.bands[0]]
    dtype = "complex64" if choice.how == "iq" else first.dtype
    if reader.driver == "MATLAB":
        # It tells with the samples only whether they are complex.
        check_plausible(source, reader, choice)
        dtype = read_choice(reader, choice).dtype
    called = name_of(reader.bands, choice) if name.dataset is None or reader.driver == "ZIP" else None
    return Head(
        reader.driver,
        tuple(reader.bands),
        choice,
        first.shape,
        dtype,
        reader.geolocation(choice.bands[0]),
        called,
        tuple(reader.files),
        reader.whole,
    )


def read_samples(source: str, band: BandLike, window: Window, calibrate: str | None = None) -> Raster:
    """The samples of the part of a window inside the scene; (0, 0) of them where it lies outside."""
    stamp = stamp_of(source)
    head = read_head(stamp, band)
    part = window.within(head.shape)
    if part is None:
        return Raster(np.zeros((0, 0), "complex64" if head.dtype.startswith("complex") else head.dtype), head.dtype)
    if not head.whole or calibrate is not None:
        return read_choice(_opened(stamp), head.choice, part, calibrate=calibrate, called=source)
    raster = _whole(stamp, band)
    rows, cols = slice(part.y, part.y + part.height), slice(part.x, part.x + part.width)
    mask = None if raster.mask is None else raster.mask[rows, cols]
    return replace(raster, samples=raster.samples[rows, cols].copy(), mask=mask)


def _opened(stamp: Stamp) -> Reader:
    """An open file of this thread and process: GDAL's handles may be shared by neither."""
    if getattr(_local, "process", None) != os.getpid():
        # A handle that came through a fork is dropped without being closed: its descriptor is the parent's too.
        _local.inherited, _local.process, _local.files = getattr(_local, "files", None), os.getpid(), OrderedDict()
    files: OrderedDict[Any, Reader] = _local.files
    if stamp not in files:
        while len(files) >= OPEN_FILES:
            files.popitem(last=False)[1].close()
        files[stamp] = open_reader(stamp[0])
    files.move_to_end(stamp)
    return files[stamp]


@lru_cache(maxsize=2)
def _whole(stamp: Stamp, band: BandLike) -> Raster:
    head, reader = read_head(stamp, band), _opened(stamp)
    check_plausible(stamp[0], reader, head.choice)
    return read_choice(reader, head.choice)


def absolute_name(source: str) -> str:
    """The same source from any folder."""
    return parse_source(source).absolute()


def files_of(source: str) -> tuple[str, ...]:
    """Paths of the files on disk that hold the samples of a source."""
    return tuple(_opened(stamp_of(source)).files)


def is_there(source: str | Path) -> bool:
    """Whether what a source names is on this disk, so that it can be read again."""
    path = parse_source(source).path
    try:
        return path is not None and path.exists()
    except (OSError, ValueError):
        return False


def is_same(one: str | Path, other: str | Path) -> bool:
    """Whether two names stand for the same file, folder or dataset."""
    if str(one) == str(other):
        return True
    first, second = parse_source(one), parse_source(other)
    if first.path is None or second.path is None or not (is_there(one) and is_there(other)):
        return False
    same = (first.dataset or "").strip("/") == (second.dataset or "").strip("/")
    return same and first.path.samefile(second.path)


@lru_cache(maxsize=64)
def inferred_scale(
    stamp: Stamp, nodata: complex | None, band: BandLike, masked: Callable[[Window], BoolArray | None]
) -> str:
    """What real samples are, told from four strips over the scene as `featreg.io.as_image` does from all of them.

    A scene of no more pixels than the strips hold is looked at as a whole. `masked` gives the user's mask of a window.
    """
    return scale_by_strips(
        read_head(stamp, band).shape, lambda window: read_samples(stamp[0], band, window), nodata, masked, stamp[0]
    )


def scale_by_strips(
    shape: tuple[int, int],
    read: Callable[[Window], Raster],
    nodata: complex | None,
    masked: Callable[[Window], BoolArray | None],
    name: str,
) -> str:
    """What the real samples of a scene of (H, W) are, told from four strips over it; `read` gives those of a window."""
    # A damaged header may state rows that no memory holds.
    height, width = shape[0], min(shape[1], SAMPLE**2)
    rows = max(1, SAMPLE**2 // 4 // width)
    if height <= 4 * rows:
        rows = height
    parts = []
    for top in np.unique(np.linspace(0, max(0, height - rows), 4).astype(int)).tolist():
        window = Window(0, top, width, rows)
        raster = read(window)
        if raster.samples.dtype.kind == "u" and raster.offset >= 0 and raster.gain >= 0:
            return "amplitude"
        hole = holds_nodata(raster.samples, raster.nodata if nodata is None else nodata)
        valid = np.ones(raster.samples.shape, np.bool_) if hole is None else ~hole
        for more in (raster.mask, masked(window)):
            if more is not None:
                valid &= more
        values = physical(raster)[valid]
        parts.append(values[np.isfinite(values)])
    values = np.concatenate(parts)
    if not len(values):
        return "amplitude"
    return real_pixels(values[None], None, None, name, owned=False, content=False, said=raster.said)[2]
