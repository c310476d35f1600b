"""The main job as a function: match two images."""

from __future__ import annotations

import logging
import math
import warnings
from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from featreg.errors import ParameterError
from featreg.geometry import as_model
from featreg.interfaces import Matcher, Model
from featreg.io import ImageLike
from featreg.io.bands import BandLike, check_band
from featreg.io.calibration import check_calibration
from featreg.io.images import small_image
from featreg.io.masks import MaskLike
from featreg.io.raster_source import open_source
from featreg.pipeline.assembly import assemble_all
from featreg.pipeline.choosing import registered
from featreg.pipeline.feature_matcher import FeatureMatcher
from featreg.pipeline.keywords import bands_of, of_pipeline
from featreg.pipeline.pipeline import Pipeline
from featreg.presets import DEFAULT_METHOD
from featreg.results.registration import Registration
from featreg.runtime.buffers import reusing
from featreg.runtime.cluster import dask_client
from featreg.runtime.executors import check_executor
from featreg.runtime.parameters import check_seed
from featreg.runtime.threads import limited_threads, side_by_side, worker_count
from featreg.runtime.timing import collecting, stage
from featreg.runtime.watching import Canceller, Progress, cancellable, check_watch
from featreg.sar.bridging import bridged, on_sample
from featreg.scene.blocks import SPLITS
from featreg.types import FloatArray, Image

if TYPE_CHECKING:
    from featreg.focusing.inputs import Focus

#: Images of more pixels are worked on in blocks.
MOST_PIXELS = 4_000_000
#: In blocks, of a side that suits the scene.
SUITABLE = -1
FOCUS_IN_BLOCKS = (
    "focus works on whole images, not on blocks: focus the files first (featreg focus IN -o OUT), or ask for the whole "
    "images at once (block=False, --whole)"
)
#: What may be said of the geolocation as prior, and how far, px, around the model of an earlier result is searched.
PRIORS, PRIOR_PX = ("none", "geolocation"), 35.0

logger = logging.getLogger(__name__)


def match(
    reference: ImageLike,
    secondary: ImageLike,
    *,
    method: str | Pipeline | Matcher = DEFAULT_METHOD,
    model: str | type[Model] | None = None,
    seed: int = 0,
    locate: bool | None = None,
    refine: bool | None = None,
    n_features: int | None = None,
    initial: Any = None,
    search_radius: float | None = None,
    prior: str | Path | None = None,
    reference_mask: MaskLike | None = None,
    secondary_mask: MaskLike | None = None,
    nodata: complex | None = None,
    scale: str | None = None,
    calibrate: str | None = None,
    band: BandLike = None,
    reference_band: BandLike = None,
    secondary_band: BandLike = None,
    focus: Focus | None = None,
    block: int | bool | None = None,
    dem: str | Path | None = None,
    height: float | None = None,
    split: str | None = None,
    executor: Any = None,
    workers: int | None = None,
    scheduler: str | None = None,
    threads: int | None = None,
    resume: str | Path | None = None,
    progress: Progress | None = None,
    cancel: Canceller | None = None,
    **keywords: Any,
) -> Registration:
    """Register two SAR images.

    Parameters
    ----------
    reference, secondary : paths (docs/formats.md), 2-D arrays (real or complex) or `Image`
    method : a preset's name (`featreg.available("method")`), a `Pipeline` or a `Matcher`; "auto" tries several presets
        and stops at the first that is trusted, `progress` then counts each anew
    model : "translation", "rigid", "similarity", "affine" (default), "homography", "polynomial2", "polynomial3",
        "residual-field"; "rpc-bias" in blocks
    seed : of everything random; the same seed gives the same result
    locate : measure the positions of the matches again after the first model; None leaves it to the method
    refine : guided sub-pixel tie points after that; None leaves it to the method
    n_features : at most so many features per image and so many final tie points (default 5000)
    initial, search_radius : a model known beforehand, or a matrix, and how far from it, in px, a match may lie
    prior : "none" leaves aside where both files say they lie, "geolocation" fails where they do not; the file of a
        result is its model, as `initial` with a `search_radius` of 35. None takes what the files say where they say it;
        in blocks it is searched as far as 300 px around that
    reference_mask, secondary_mask : pixels that are data: arrays, mask files or polygons
    nodata : value of samples that are not data
    scale : "amplitude", "intensity" or "db", what real samples are
    calibrate : "sigma0", "beta0" or "gamma0": read both files, of products that state how, as amplitudes of it
    band : of both files: a name ("VV"), a number from 1, "iq" for complex samples of two bands, "rgb"
    reference_band, secondary_band : of either file, in place of `band`
    focus : autofocus of complex images first: a method of `featreg.focus`, or a function from an `Image` to its result,
        which may know the azimuth axis or a carrier; an image whose focus is not trusted stays as it is
    block : side in pixels of the blocks in which to work, False for the whole images at once, True for blocks of 600 to
        1000 px, as suits the scene; None works in such where an image has more than 4 million pixels, or where `dem`,
        `height` or the model asks for it (see docs/scenes.md). Then `n_features` is the budget of a block (default
        1000)
    dem, height : heights of the ground for images with geolocation: an elevation model's file, or metres above the
        ellipsoid (default: the height offset of an RPC, else 0); in blocks only
    split : how the secondary is divided in blocks: "prior" (default) searches each block where the prior puts it, with
        a margin; "proportional" divides the rectangle that the overlap covers in the secondary into as many parts of
        equal size, as the SAR-ORB paper does (section 2.2)
    executor, workers : what runs the blocks: "serial", "threads", "processes", a `concurrent.futures.Executor` or a
        `dask.distributed.Client`; None takes `workers` processes (default: every processor) where they can be forked
        safely, else threads. Of whole images `workers` is the most threads. How the work is run, by these and those
        below, never changes the result
    scheduler : address of a dask scheduler that runs the blocks, in place of `executor`
    threads : most threads on whole images, in place of `workers`, and no more than there are processors. They share
        out rows of the images and windows around points where there is work for each, or look at an image each; at
        600 x 600 px that gains little or nothing. A worker uses one
    resume : folder in which finished blocks are kept, and looked for; of whole images nothing is kept
    progress : called with (blocks done, blocks in all), of whole images with (steps done, steps in all)
    cancel : an event; when set, the work stops between blocks or stages with a `CancelledError`
    keywords : replace a part (``detector="fast"``) or a parameter (``threshold=...``, ``**{"fsc.threshold": 2}``)

    Returns
    -------
    Registration
        With status "unreliable" and a reason where it cannot be trusted.

    Raises
    ------
    InputError, UnknownNameError, ParameterError
        An unreadable image, an unknown name, an unknown, ambiguous or impossible parameter, one that does nothing here.
    CancelledError
        `cancel` was set.
    """
    check_seed(seed)
    _check_running(workers=workers, threads=threads, executor=executor, progress=progress, cancel=cancel)
    prior, initial, search_radius = _prior(prior, initial, search_radius)
    known = _initial(initial, search_radius)
    search: Any = {"seed": int(seed), "initial": known, "search_radius": search_radius}
    whole: Any = search | ({} if prior is None else {"prior": prior})
    parts: Any = {"model": model, "locate": locate, "refine": refine, "n_features": n_features, **keywords}
    size = block_side(block, dem, height, model, split)
    most = MOST_PIXELS if size is None else math.inf
    given, masks = (reference, secondary), (reference_mask, secondary_mask)
    bands = bands_of({"band": band, "reference_band": reference_band, "secondary_band": secondary_band})
    for asked in bands:
        check_band(asked)
    check_calibration(calibrate, scale)
    reading: Any = {"nodata": nodata, "scale": scale, "calibrate": calibrate}
    images: list[Image | None] = [None, None]
    # Only whole images that were asked for may be large.
    memory = reusing if size == 0 else nullcontext

    def read(i: int) -> Image | None:
        return small_image(given[i], most, mask=masks[i], band=bands[i], **reading)

    shared = worker_count(workers if threads is None else threads, default=1)
    with cancellable(cancel), collecting() as seconds, stage("read"), memory():
        if size == 0 and shared > 1:
            # Readers keep libraries' warnings quiet for a while, which is of the process: threads that end in another
            # order than they began would leave it so.
            with limited_threads(shared), warnings.catch_warnings():
                both = [partial(read, 0), partial(read, 1)]
                # Of arrays that are there the rows are shared out.
                files = any(isinstance(one, str | Path) for one in given)
                images = side_by_side(both) if files else [one() for one in both]
        else:
            for i in range(0 if size else 2):
                images[i] = read(i)
                if images[i] is None:
                    break
    first, second = images
    if first is None or second is None:
        if focus is not None:
            raise ParameterError(FOCUS_IN_BLOCKS)
        from featreg.scene.run import SceneOptions, match_scene
        from featreg.scene.samples import sampled

        here, there = (open_source(i, mask=m, band=b, **reading) for i, m, b in zip(given, masks, bands, strict=True))
        pipelines = assemble_all(method, blocks=True, **parts)
        with dask_client(scheduler, executor) as runner:
            options = SceneOptions(
                _side(size), runner, workers, dem, height, resume, progress, cancel, prior, split or SPLITS[0]
            )  # fmt: skip
            return registered(
                method,
                pipelines,
                lambda pipeline: match_scene(here, there, pipeline, options, **search),
                lambda: (sampled(here), sampled(there)),
            )
    if prior == "geolocation":
        from featreg.geolocation import sensor_of

        for image in (first, second):
            sensor_of(image.geolocation, image.shape, image.name)
    pipelines = assemble_all(method, **parts)
    if resume is not None:
        logger.warning("the images are matched whole, so nothing is kept in '%s': give block= for blocks", resume)
    focusing: dict[str, Any] = {}
    with cancellable(cancel), limited_threads(workers if threads is None else threads), memory():
        if focus is not None:
            from featreg.focusing.inputs import focused_inputs

            with collecting() as focused, stage("focus"):
                first, second, focusing["focus"] = focused_inputs(first, second, focus)
            seconds |= focused
        pair = first, second
        result = registered(
            method, pipelines, lambda pipeline: pipeline.run(*pair, progress=progress, **whole), lambda: pair
        )
    return replace(
        result,
        timings={**seconds, **result.timings},
        provenance={**result.provenance, **focusing},
    )


def keypoints_of(
    image: ImageLike,
    *,
    mask: MaskLike | None = None,
    nodata: complex | None = None,
    scale: str | None = None,
    calibrate: str | None = None,
    band: BandLike = None,
    focus: Focus | None = None,
    block: int | bool | None = None,
    split: str | None = None,
    **keywords: Any,
) -> FloatArray | None:
    """(N, 2) keypoints that a method looks at in an image, at most its budget; None where it has no detector.

    `mask` and `band` are those of this image; the other keywords are those of `match` that build the pipeline. An image
    that is so large that it is worked on in blocks, or for which blocks are asked, is looked at block by block; `focus`
    is an error there, as it is in `match`.
    """
    size = block_side(block, None, None, None, split)
    reading: Any = {"nodata": nodata, "scale": scale, "calibrate": calibrate, "mask": mask, "band": band}
    whole = None if size else small_image(image, MOST_PIXELS if size is None else math.inf, **reading)
    if whole is None and focus is not None:
        raise ParameterError(FOCUS_IN_BLOCKS)
    pipelines = assemble_all(**keywords, blocks=whole is None or None)
    matcher = pipelines[0].matcher
    if len(pipelines) > 1 or not isinstance(matcher, FeatureMatcher):
        return None
    if whole is None:
        from featreg.scene.keypoints import scene_keypoints

        return scene_keypoints(open_source(image, **reading), pipelines[0], _side(size), split or SPLITS[0])
    if focus is not None and whole.is_complex:
        from featreg.focusing.inputs import focused_input

        whole, _ = focused_input(whole, focus)
    seen = bridged(whole)
    xy = matcher.keypoints(seen)
    return xy[on_sample(xy, seen)]


def check_keywords(keywords: Mapping[str, Any]) -> None:
    """Raise where keywords of `match` cannot be right whatever the images are: names, parameters, contradictions."""
    known = {name: value for name, value in keywords.items() if value is not None}
    check_seed(known.get("seed", 0))
    size = block_side(*(known.get(name) for name in ("block", "dem", "height", "model", "split")))
    _check_running(**{name: known.get(name) for name in ("workers", "threads", "executor", "progress", "cancel")})
    if isinstance(known.get("focus"), str):
        from featreg.focusing.inputs import check_method

        check_method(known["focus"])
    for band in bands_of(known):
        check_band(band)
    check_calibration(known.get("calibrate"), known.get("scale"))
    _, initial, radius = _prior(known.get("prior"), known.get("initial"), known.get("search_radius"))
    _initial(initial, radius)
    assemble_all(**of_pipeline(keywords), blocks=None if size is None else bool(size))


def _check_running(*, workers: Any, threads: Any, executor: Any, progress: Any, cancel: Any) -> None:
    """Raise where the work cannot be run so, whether or not this call would come to it."""
    worker_count(workers)
    worker_count(threads, name="threads")
    check_executor(executor)
    check_watch(progress, cancel)


def block_side(block: Any, dem: Any, height: Any, model: Any, split: Any = None) -> int | None:
    """Side of the blocks in which to work, `SUITABLE` where that is left to the scene, 0 for the whole images at once,
    None where their size decides.
    """
    if split is not None and split not in SPLITS:
        raise ParameterError(f"split must be 'prior' or 'proportional', got {split!r:.60}")
    asked = [name for name, value in (("dem", dem), ("height", height), ("split", split)) if value is not None]
    asked += ["model='rpc-bias'"] if model == "rpc-bias" else []
    if block is False:
        if asked:
            raise ParameterError(f"block=False works on the whole images, {', '.join(asked)} is for blocks")
        return 0
    if block is None:
        return SUITABLE if asked else None
    if block is True:
        return SUITABLE
    if not isinstance(block, int | np.integer) or block < 1:
        raise ParameterError(f"block must be a whole number of pixels >= 1 or False, got {block!r}")
    return int(block)


def _side(size: int | None) -> int | None:
    """The side that was asked for, or None."""
    return None if size == SUITABLE else size


def _prior(prior: Any, initial: Any, search_radius: float | None) -> tuple[str | None, Any, float | None]:
    """(what of the geolocation is used, the model known beforehand, how far around it) by `prior` and `initial`."""
    if prior is None:
        return None, initial, search_radius
    if initial is not None:
        raise ParameterError("prior and initial both say where to look: leave one of them out")
    if prior in PRIORS:
        if search_radius is not None:
            raise ParameterError(f"search_radius needs a model around which to search, prior='{prior}' is none")
        return str(prior), None, None
    if not isinstance(prior, str | Path):
        raise ParameterError(f"prior must be 'none', 'geolocation' or the file of a result, got {prior!r:.60}")
    if not Path(prior).is_file():
        raise ParameterError(f"prior '{prior}' is neither 'none' nor 'geolocation', and no such file is there")
    return None, Registration.from_json(prior, tie_points=False), PRIOR_PX if search_radius is None else search_radius


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
