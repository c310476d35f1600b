"""Files of products: windows computed by threads and written in order, tiled TIFFs, cloud-optimised GeoTIFFs."""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from featreg.errors import CancelledError
from featreg.io.raster_source import CACHE_BYTES, Window
from featreg.io.writers import geolocation_profile
from featreg.products.grid import Grid
from featreg.products.samples import Encoding
from featreg.runtime.threads import available_processors, worker_count
from featreg.runtime.watching import Canceller, Progress

#: Side of an output window, px; of the tiles inside the file.
WINDOW, TILE = 1024, 512
#: Threads without being asked.
MOST_WORKERS = 8


@dataclass(frozen=True)
class Runner:
    """Runs windows in threads and gives their results in order, a few ahead at most."""

    threads: int | None
    progress: Progress | None
    cancel: Canceller | None

    @property
    def workers(self) -> int:
        return worker_count(self.threads, min(available_processors(), MOST_WORKERS))

    def run(self, work: Callable[[Window], Any], shape: tuple[int, int]) -> Iterator[tuple[Window, Any]]:
        windows = list(windows_of(shape))
        pending: deque[Any] = deque()
        with ThreadPoolExecutor(self.workers) as pool:
            try:
                todo = iter(windows)
                for window in itertools.islice(todo, self.workers + 1):
                    pending.append((window, pool.submit(work, window)))
                done = 0
                while pending:
                    if self.cancel is not None and self.cancel.is_set():
                        raise CancelledError(f"stopped after {done} of {len(windows)} windows")
                    window, future = pending.popleft()
                    yield window, future.result()
                    done += 1
                    for more in itertools.islice(todo, 1):
                        pending.append((more, pool.submit(work, more)))
                    if self.progress is not None:
                        self.progress(done, len(windows))
            finally:
                for _, future in pending:
                    future.cancel()


def windows_of(shape: tuple[int, int]) -> Iterator[Window]:
    for y in range(0, shape[0], WINDOW):
        for x in range(0, shape[1], WINDOW):
            yield Window(x, y, min(WINDOW, shape[1] - x), min(WINDOW, shape[0] - y))


@contextmanager
def bounded_cache() -> Iterator[None]:
    """GDAL with a bounded cache."""
    import rasterio

    with rasterio.Env(GDAL_CACHEMAX=CACHE_BYTES):
        yield


def rasterio_window(window: Window) -> Any:
    from rasterio.windows import Window as RasterioWindow

    return RasterioWindow(window.x, window.y, window.width, window.height)


@contextmanager
def tiled_tiff(
    path: Path,
    grid: Grid,
    first: Encoding,
    count: int,
    tags: dict[str, str],
    encodings: Sequence[Encoding] = (),
    names: Sequence[str] = (),
) -> Iterator[Any]:
    """An open, tiled, uncompressed TIFF on a grid; `names` are those of its bands."""
    import rasterio

    height, width = grid.shape
    profile: dict[str, Any] = {"driver": "GTiff", "height": height, "width": width, "count": count}
    profile |= {"dtype": first.dtype, "nodata": first.nodata, "tiled": True, "blockxsize": TILE, "blockysize": TILE}
    profile |= {"bigtiff": "if_safer", **geolocation_profile(grid.geolocation)}
    with rasterio.open(path.absolute(), "w", **profile) as dataset:
        dataset.update_tags(**tags)
        if any((e.gain, e.offset) != (1.0, 0.0) for e in encodings):
            dataset.scales = [e.gain for e in encodings]
            dataset.offsets = [e.offset for e in encodings]
        if names:
            dataset.descriptions = tuple(names)
        yield dataset


def cloud_optimised(plain: Path, target: Path, overviews: str, dtype: str, workers: int) -> None:
    """Write a tiled TIFF anew as a cloud-optimised one with overviews."""
    from rasterio.shutil import copy

    options = {"compress": "DEFLATE", "level": "1", "blocksize": str(TILE), "bigtiff": "IF_SAFER"}
    options |= {"overview_resampling": overviews, "num_threads": str(workers)}
    # The predictor for floats knows real ones only.
    options |= {} if dtype.startswith("complex") else {"predictor": "YES"}
    copy(plain.absolute(), target.absolute(), driver="COG", **options)
