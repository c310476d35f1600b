"""The main job as functions: match two images, fit the user's own tie points."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from featreg.errors import InputError, ParameterError
from featreg.exports.reading import read_tie_points
from featreg.focusing.inputs import Focus, focused_inputs
from featreg.geometry import as_model
from featreg.interfaces import Matcher, Model
from featreg.io import ImageLike, as_image
from featreg.io.masks import MaskLike
from featreg.io.raster_source import open_source, pixel_count
from featreg.pipeline.assembly import DEFAULT_METHOD, assemble
from featreg.pipeline.inputs import input_image
from featreg.pipeline.pipeline import Pipeline
from featreg.results.input_image import InputImage
from featreg.results.registration import Registration
from featreg.runtime.timing import collecting, stage
from featreg.types import Image, Matches

#: Images of more pixels are worked on in blocks of so many pixels a side.
MOST_PIXELS = 4_000_000
BLOCK = 600
#: Ways of working that only blocks have.
BLOCK_ONLY = ("executor", "dem", "height", "resume")

logger = logging.getLogger(__name__)


def match(
    reference: ImageLike,
    secondary: ImageLike,
    *,
    method: str | Pipeline | Matcher = DEFAULT_METHOD,
    model: str | type[Model] | None = None,
    seed: int = 0,
    refine: bool | None = None,
    n_features: int | None = None,
    initial: Any = None,
    search_radius: float | None = None,
    reference_mask: MaskLike | None = None,
    secondary_mask: MaskLike | None = None,
    nodata: complex | None = None,
    scale: str | None = None,
    focus: Focus | None = None,
    block: int | bool | None = None,
    executor: Any = None,
    workers: int | None = None,
    dem: str | Path | None = None,
    height: float | None = None,
    resume: str | Path | None = None,
    progress: Callable[[int, int], None] | None = None,
    cancel: Any = None,
    **keywords: Any,
) -> Registration:
    """Register two SAR images.

    Parameters
    ----------
    reference, secondary : paths, 2-D arrays (real or complex) or `Image`
    method : a preset's name (`featreg.available("method")`), a `Pipeline` or a `Matcher`
    model : "translation", "rigid", "similarity", "affine" (default), "homography", "polynomial2", "polynomial3",
        "residual-field"; "rpc-bias" in blocks
    seed : of everything random; the same seed gives the same result
    refine : guided sub-pixel tie points after the first model; None leaves it to the method
    n_features : at most so many features per image and so many final tie points (default 5000)
    initial, search_radius : a model known beforehand, or a matrix, and how far from it, in px, a match may lie
    reference_mask, secondary_mask : pixels that are data: arrays, mask files or polygons
    nodata : value of samples that are not data
    scale : "amplitude", "intensity" or "db", what real samples are
    focus : autofocus of complex images first: a method of `featreg.focus`, or a function from an `Image` to its result,
        which may know the azimuth axis or a carrier; an image whose focus is not trusted stays as it is
    block : side in pixels of the blocks in which to work, False for the whole images at once; None works in blocks of
        600 where an image has more than 4 million pixels or one of the following is given (see docs/scenes.md). Then
        `n_features` is the budget of a block (default 1000)
    executor, workers : what runs the blocks: "serial", "threads", "processes", a `concurrent.futures.Executor` or a
        `dask.distributed.Client`; None takes `workers` processes (default: every processor) where they can be forked
        safely, else threads. The result is the same
    dem, height : heights of the ground for images with geolocation: an elevation model's file, or metres above the
        ellipsoid (default 0)
    resume : folder in which finished blocks are kept, and looked for
    progress : called with (blocks done, blocks in all)
    cancel : an event; when set, the work on blocks stops with a `CancelledError`
    keywords : replace a part (``detector="fast"``) or a parameter (``threshold=...``, ``**{"fsc.threshold": 2}``)

    Returns
    -------
    Registration
        With status "unreliable" and a reason where it cannot be trusted.

    Raises
    ------
    InputError, UnknownNameError, ParameterError
        An unreadable image, an unknown name, an unknown, ambiguous or impossible parameter.
    """
    if not isinstance(seed, int | np.integer) or seed < 0:
        raise ParameterError(f"seed must be a whole number >= 0, got {seed!r}")
    known = _initial(initial, search_radius)
    work = {"executor": executor, "workers": workers, "dem": dem, "height": height, "resume": resume}
    work |= {"progress": progress, "cancel": cancel}
    size = _block_size(block, work, model, reference, secondary)
    if size is not None:
        if focus is not None:
            raise ParameterError(
                "focus works on whole images, not on blocks: focus the files first (featreg focus IN -o OUT), or ask "
                "for the whole images at once (block=False, --whole)"
            )
        from featreg.scene.run import SceneOptions, assemble_scene, match_scene

        sources = (
            open_source(reference, mask=reference_mask, nodata=nodata, scale=scale),
            open_source(secondary, mask=secondary_mask, nodata=nodata, scale=scale),
        )
        pipeline = assemble_scene(method, model=model, refine=refine, n_features=n_features, **keywords)
        options = SceneOptions(size, **work)
        return match_scene(*sources, pipeline, options, seed=int(seed), initial=known, search_radius=search_radius)
    pipeline = assemble(method, model=model, refine=refine, n_features=n_features, **keywords)
    with collecting() as reading, stage("read"):
        first = as_image(reference, mask=reference_mask, nodata=nodata, scale=scale)
        second = as_image(secondary, mask=secondary_mask, nodata=nodata, scale=scale)
    focusing: dict[str, Any] = {}
    if focus is not None:
        with collecting() as seconds, stage("focus"):
            first, second, focusing["focus"] = focused_inputs(first, second, focus)
        reading |= seconds
    result = pipeline.run(first, second, seed=int(seed), initial=known, search_radius=search_radius)
    return replace(
        result,
        timings={**reading, **result.timings},
        provenance={**result.provenance, **focusing},
        reference=input_image(first),
        secondary=input_image(second),
    )


def fit(
    points: Matches | Any,
    *,
    model: str | type[Model] | None = None,
    filters: Any = ("fsc",),
    seed: int = 0,
    reference_shape: tuple[int, int] | None = None,
    secondary_shape: tuple[int, int] | None = None,
    **keywords: Any,
) -> Registration:
    """Run filters, model and trust on the user's own tie points.

    Parameters
    ----------
    points : `Matches`, an (M, 4) array of reference x, y, secondary x, y in pixels, or a file of tie points
        (`featreg.read_tie_points`)
    model, filters, seed, keywords : as in `match`
    reference_shape, secondary_shape : (H, W); without them the images are taken to end at the outermost tie points

    Returns
    -------
    Registration
    """
    matches = points if isinstance(points, Matches) else _as_matches(points)
    pipeline = assemble(_NoMatcher(), model=model, refine=False, filters=filters, **keywords)
    shapes = [
        given if given is not None else _outer_shape(xy)
        for given, xy in ((reference_shape, matches.reference_xy), (secondary_shape, matches.secondary_xy))
    ]
    with collecting() as timings:
        result = pipeline.finish(matches, shapes[0], shapes[1], seed=seed, timings=timings)
    first, second = (InputImage("tie points", shape) for shape in shapes)
    provenance = {**result.provenance, "method": "tie points"}
    return replace(result, provenance=provenance, reference=first, secondary=second)


def _block_size(
    block: int | bool | None, work: Mapping[str, Any], model: Any, reference: ImageLike, secondary: ImageLike
) -> int | None:
    """Side of the blocks in which to work, or None for the whole images at once."""
    asked = [name for name in BLOCK_ONLY if work[name] is not None]
    asked += ["model='rpc-bias'"] if model == "rpc-bias" else []
    if block is False:
        if asked:
            raise ParameterError(f"block=False works on the whole images, {', '.join(asked)} is for blocks")
        return None
    if block is None or block is True:
        large = block or asked or max(pixel_count(reference), pixel_count(secondary)) > MOST_PIXELS
        return BLOCK if large else None
    if not isinstance(block, int | np.integer):
        raise ParameterError(f"block must be a whole number of pixels or False, got {block!r}")
    return int(block)


class _NoMatcher(Matcher):
    """Stands for the user, who brings the tie points."""

    def match(self, reference: Image, secondary: Image) -> Matches:
        return Matches.empty()


def _initial(initial: Any, search_radius: float | None) -> Model | None:
    if initial is None:
        if search_radius is not None:
            raise ParameterError("search_radius needs initial, the model around which to search")
        return None
    if search_radius is None or not search_radius > 0:
        raise ParameterError(f"initial needs search_radius > 0 px, got {search_radius}")
    if isinstance(initial, Registration):
        initial = initial.model
    if isinstance(initial, Mapping):
        raise ParameterError("initial must be a model, a matrix or a Registration, got a mapping")
    return as_model(initial)


def _as_matches(points: Any) -> Matches:
    if isinstance(points, str | Path):
        return read_tie_points(points)
    try:
        array = np.asarray(points, np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"tie points must be Matches or an (M, 4) array of numbers, got {points!r:.40}") from error
    if array.ndim != 2 or array.shape[1] != 4:
        raise InputError(f"tie points must be an (M, 4) array of reference x, y, secondary x, y, got {array.shape}")
    return Matches(array[:, :2], array[:, 2:], np.ones(len(array)))


def _outer_shape(xy: Any) -> tuple[int, int]:
    if not len(xy):
        return 1, 1
    return int(np.ceil(xy[:, 1].max())) + 1, int(np.ceil(xy[:, 0].max())) + 1
