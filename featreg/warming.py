"""Compile or load every kernel that the methods use, so that the first real image does not pay for it."""

from __future__ import annotations

import importlib
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

from featreg.errors import FeatregError, UnknownNameError
from featreg.registry import entries, entry, presets
from featreg.runtime import machine, precompiled
from featreg.runtime.files import write_atomic
from featreg.runtime.jit import Kernel
from featreg.runtime.preparing import LIST

#: Small, yet with a scene in it that every method finds points on.
SHAPE = (200, 200)
#: The kernels of the default method, of the demonstration and of `warp`.
DEFAULT = (
    "featreg.products.resample_kernels",
    "featreg.geometry.correlated_kernels",
    "featreg.geometry.prediction_kernels",
    "featreg.geometry.reweighting_kernels",
    "featreg.geometry.robust_kernels",
    "featreg.pipeline.agreement_kernels",
    "featreg.pipeline.identical_kernels",
    "featreg.pipeline.located_kernels",
    "featreg.sar.bridging_kernels",
    "featreg.sar.keypoints.binary_kernels",
    "featreg.sar.keypoints.corner_kernels",
    "featreg.sar.keypoints.hamming_kernels",
    "featreg.sar.correlation_kernels",
    "featreg.sar.affine_kernels",
    "featreg.sar.keypoints.motion_kernels",
    "featreg.simulate.paint_kernels",
    "featreg.sar.gradients.ratio_kernels",
    "featreg.sar.sample_kernels",
    "featreg.sar.window_kernels",
    "featreg.sar.speckle_kernels",
    "featreg.sar.mask_kernels",
)


def warm_up() -> None:
    """Compile or load every kernel of the methods by registering a tiny simulated pair.

    Half a minute the first time, afterwards a second or two: compiled code is kept on disk and only loaded. For those
    who measure time, and for the start of a service.
    """
    import numpy as np

    from featreg.displacement.run import offsets
    from featreg.focusing import focus
    from featreg.matching import match
    from featreg.pipeline.assembly import assemble
    from featreg.products.in_memory import warp
    from featreg.simulate import sar_pair

    pair = sar_pair(SHAPE, rotation_deg=3.0, scale=1.0, shift=(2.0, 1.0))
    mask = np.ones(SHAPE, np.bool_)
    mask[:20, :30] = False
    real = (pair.reference, pair.secondary)
    complex_ = tuple(image.astype(np.complex64) for image in real)
    for keywords in _methods():
        matcher = assemble(**keywords).matcher
        images = complex_ if matcher is not None and matcher.complex_only else real
        for valid in (None, mask):
            match(*images, **keywords, reference_mask=valid, secondary_mask=valid)
    result = match(*real, refine=False)
    for image in (real[1], complex_[1]):
        warp(result, image, like=SHAPE)
    focus(complex_[1])
    offsets(*real, window=32)
    _warm_drawings(*real)
    _warm_reading(real[0])
    _warm_windows(real[0])
    _warm_pieces(real[0])
    _warm_agreement(real[0])
    _warm_bits()
    _warm_geometry()


def _warm_reading(pixels: Any) -> None:
    """Read samples of which one value stands for no data."""
    import numpy as np

    from featreg.io import as_image

    for kind in (np.float32, np.uint16, np.uint8):
        as_image(np.clip(pixels, 0, 255).astype(kind), nodata=0)


def _warm_windows(pixels: Any) -> None:
    """Make the views that large images get around points only, and correlate few windows."""
    import numpy as np

    from featreg.io import as_image
    from featreg.sar.correlation import local_correlations
    from featreg.sar.correlation_filter_kernels import HALF, TERMS
    from featreg.sar.speckle import despeckled_bytes_around
    from featreg.sar.windows import aligned_windows, gaussian

    image, at = as_image(pixels), np.array([[60, 60], [80, 90]])
    taps = np.ones((TERMS, 1 + HALF), np.float32)
    aligned_windows(image, np.tile(np.eye(2, 3), (2, 1, 1)), image.shape, at - 16, 32, gaussian(1.0), (taps, taps))
    local_correlations(pixels, pixels, at, 5, 1)
    despeckled_bytes_around(image, lambda: at, len(at), 4)


def _warm_drawings(reference: Any, secondary: Any) -> None:
    """Look for what is drawn on both images where something is: a bright bar."""
    import numpy as np

    from featreg.io import as_image
    from featreg.pipeline.identical import identical_pixels

    bar = np.zeros(SHAPE, np.bool_)
    bar[90:93, 20:180] = True
    bright = np.float32(4 * reference.max())
    identical_pixels(*(as_image(np.where(bar, bright, pixels)) for pixels in (reference, secondary)))


def _warm_bits() -> None:
    """Compare binary descriptors in slices, whether or not that is quicker on this processor."""
    import numpy as np

    from featreg.sar.keypoints import hamming_kernels as kernels

    words = np.zeros((3, 4), np.uint64)
    slices = np.zeros((1, 257 * kernels.LANES), np.uint64)
    kernels.slice_bits(words, slices)
    kernels.nearest_by_slices(
        words, slices, np.zeros(kernels.MEMORY, np.uint64), words[:, 0].copy(), words[:, 1].copy()
    )


def _warm_pieces(pixels: Any) -> None:
    """Filter an image that is wide enough to be filtered in pieces."""
    import numpy as np

    from featreg.io import as_image
    from featreg.sar.gradients.gabor import PIECE, gabor_gradients

    gabor_gradients(as_image(np.tile(pixels[:20], (1, PIECE // pixels.shape[1] + 2))), sigma=1.0, orientations=2)


def _warm_agreement(pixels: Any) -> None:
    """Compare two images of a size that are judged by coarser samples than the tiny pair."""
    import numpy as np

    from featreg.geometry import Translation
    from featreg.io import as_image
    from featreg.pipeline.agreement import SHORT, Agreement

    image = as_image(np.tile(pixels, (2, 2))[:SHORT, :SHORT])
    Agreement.of(image, image, Translation(0.0, 0.0))


def _warm_geometry() -> None:
    """Use the sensors, the back-projection and the residual field once."""
    import numpy as np

    from featreg.focusing.backprojection import back_project
    from featreg.focusing.ground_grid import GroundGrid
    from featreg.focusing.phase_history import PhaseHistory
    from featreg.geolocation.elevation_model import Patch
    from featreg.geolocation.orbit import Orbit
    from featreg.geometry.residual_field import ResidualField
    from featreg.simulate.orbit import RangeDoppler

    shape, heights = (64, 64), np.zeros(2)
    exact = RangeDoppler.over((12.0, 47.0), shape, incidence_deg=35.0, heading_deg=-12.0, pixel=3.0)
    orbiting = exact.sensor(shape, 0.0)
    rational = exact.rpc(shape, -100.0, 100.0, 1.0)
    cells = np.array([10.0, 0.0, -110.0, 0.0, -10.0, 480.0, 20.0, 20.0, 12.0, 360.0])
    rational.on_patch(np.array([[10.0, 20.0]]), Patch(cells, np.zeros((20, 20)), 0, 0), 0.0, 1e-3)
    for sensor in (rational, orbiting):
        ground = sensor.image_to_ground(np.array([[10.0, 20.0], [30.0, 40.0]]), heights)
        sensor.ground_to_image(ground, heights)
    Orbit(orbiting.times, orbiting.positions, orbiting.velocities).at(orbiting.times[:2])
    azimuth = np.linspace(0.0, 1.0, 8)
    turn = np.radians(azimuth)
    places = 7000 * np.column_stack([np.cos(turn), np.sin(turn), np.ones(8)])
    pulses = np.ones((8, 16), np.complex64)
    history = PhaseHistory(pulses, np.linspace(9.6e9, 9.615e9, 16), places, np.linalg.norm(places, axis=1), azimuth)
    back_project(history, GroundGrid((32, 32), 0.5))
    points = np.stack(np.meshgrid(np.arange(5.0), np.arange(5.0)), axis=-1).reshape(-1, 2)
    field = ResidualField.from_estimate(points, points)
    if isinstance(field, ResidualField):
        field.displacement(points)


def _methods() -> Iterator[dict[str, Any]]:
    """Keywords of `match` that run every plugin which compiles something: the presets', and those in no preset."""
    used: set[tuple[str, str]] = set()
    for method, preset in presets().items():
        if preset.methods:
            continue  # each has a turn of its own
        steps = [*preset.parts, *(("filter", part) for part in preset.filters)]
        try:
            found = [entry(kind, part.name) for kind, part in steps]
        except UnknownNameError:
            continue  # of somebody else's preset: said where it is used
        used.update((kind, part.name) for kind, part in steps)
        if not any(e.unavailable for e in found) and all(e.compiled for e in found):
            yield {"method": method}
    for kind in ("detector", "descriptor", "nearest", "matcher", "filter"):
        for other in entries(kind):
            if other.compiled and not other.unavailable and (kind, other.name) not in used:
                yield {"filters": [other.name]} if kind == "filter" else {kind: other.name}


def record_kernels() -> None:
    """List the kernels, with the kinds of arguments that `warm_up` gives them, for `featreg.runtime.preparing`.

    For those who add a kernel, or call one with arguments of another kind: what is not listed compiles at its first
    call.
    """
    from featreg.runtime import jit

    jit.calls = {}
    try:
        warm_up()
    finally:
        recorded, jit.calls = jit.calls, None
    modules: dict[str, dict[str, list[list[str]]]] = {}
    for (module, name), keys in sorted(recorded.items()):
        plain = sorted(list(key) for key in keys if key)  # nothing else than arrays and numbers can be handed over
        if plain:
            modules.setdefault(module, {})[name] = plain
    lines = ",\n".join(
        f"{json.dumps(module)}: {{\n"
        + ",\n".join(f"  {json.dumps(name)}: {json.dumps(keys)}" for name, keys in kernels.items())
        + "\n}"
        for module, kernels in modules.items()
    )
    write_atomic(LIST, f"{{\n{lines}\n}}\n".encode())


def stale_kernels() -> list[str]:
    """The modules of kernels whose prepared code is of another source; `make kernels` translates them again."""
    stale = []
    for module in _kernel_modules():
        kernels = _kernels(module).values()
        listed = {entry["kernel"] for entry in precompiled.listed(Path(str(module.__file__)))}
        if any(kernel.function.__name__ in listed and not precompiled.current(kernel) for kernel in kernels):
            stale.append(module.__name__)
    return stale


def _kernels(module: ModuleType) -> dict[str, Kernel]:
    """Name -> the kernels that a module defines."""
    return {
        name: value
        for name, value in vars(module).items()
        if isinstance(value, Kernel) and value.__module__ == module.__name__
    }


def kernels_cached() -> Mapping[str, bool]:
    """Return module of kernels -> whether its code is prepared, or was compiled before and lies on disk.

    Notes
    -----
    One function stands for its module. Argument types that were never used, and a source that changed since, compile
    when they are first used.
    """
    return {module.__name__: _cached(module) for module in _kernel_modules()}


def ready() -> bool:
    """Whether the default method, the demonstration and `warp` run without compiling."""
    return all(_cached(importlib.import_module(name)) for name in DEFAULT)


def _kernel_modules() -> list[ModuleType]:
    """The modules named `*_kernels` of this package."""
    root = Path(__file__).parent
    names = sorted(".".join(path.relative_to(root).with_suffix("").parts) for path in root.rglob("*_kernels.py"))
    modules = []
    for name in names:
        try:
            modules.append(importlib.import_module(f"featreg.{name}"))
        except (ImportError, FeatregError):
            continue
    return modules


def cache_folders() -> set[Path]:
    """The folders in which compiled kernels are kept."""
    kept = machine.folder()
    return set().union(*(_folders(module) for module in _kernel_modules()), () if kept is None else (kept,))


def _folders(module: ModuleType) -> set[Path]:
    """Where numba keeps what is not prepared."""
    left = [kernel for kernel in _kernels(module).values() if not precompiled.current(kernel)]
    # Where NUMBA_DISABLE_JIT keeps numba from compiling, it hands back plain functions, which have no such place.
    dispatchers = (kernel.dispatcher for kernel in left if kernel.inline == "never")
    kept = (one.stats.cache_path for one in dispatchers if hasattr(one, "stats"))
    # Without a folder that can be written, code has no place.
    return {Path(folder) for folder in kept if folder is not None}


def _cached(module: ModuleType) -> bool:
    short = module.__name__.rpartition(".")[2]
    if any(precompiled.current(kernel) for kernel in _kernels(module).values()):
        return True
    return any(any(folder.glob(f"{short}.*.nbi")) for folder in _folders(module))
