"""The grids of a product: that of the reference, and how a file at hand relates to the secondary that was matched."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from featreg.errors import InputError, ParameterError
from featreg.interfaces import Model
from featreg.io.raster_files import is_same, is_there
from featreg.io.raster_source import RasterSource, located_source
from featreg.products.lattice import OtherGrids, resized
from featreg.products.placement import IDENTITY, Placed, relation
from featreg.products.resample import model_of, stated_shape
from featreg.results.input_image import InputImage
from featreg.results.registration import Registration
from featreg.types import FloatArray, Geolocation

#: Pixel sizes that are taken as meant where the sizes of two images allow them: whole multiples and parts.
PLAIN_FACTORS = (*range(2, 17), *(1 / n for n in range(2, 17)))

logger = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Grid:
    """What a product lies on.

    Parameters
    ----------
    shape : (H, W)
    geolocation : where it lies, when known
    path : the reference image, when it is at hand
    to_matched : (2, 3) map of its pixels to those of the reference as it was matched
    """

    shape: tuple[int, int]
    geolocation: Geolocation | None
    path: str | None
    to_matched: FloatArray


def inputs_of(registration: Registration) -> list[str]:
    """Return the files that a registration rests on and that no output may replace: images, an elevation model."""
    from featreg.geolocation import DemHeights, RpcBias

    paths = [image.path for image in (registration.reference, registration.secondary) if image is not None]
    model = registration.model
    if isinstance(model, RpcBias) and isinstance(model.heights, DemHeights):
        paths.append(model.heights.path)
    return paths


def reference_grid(registration: Registration, like: str | Path | tuple[int, int] | None) -> Grid:
    """Return the grid of the reference, or of `like`, a file of the same footprint.

    Raises
    ------
    InputError
        The size is not known, or `like` cannot be the reference.
    """
    known = registration.reference
    size = None if known is None else known.shape
    if isinstance(like, tuple):
        return Grid(stated_shape(like), None, None, IDENTITY)
    if like is not None:
        source = located_source(like)
        placed = None if known is None else relation(_placed(source), _matched(known, "reference"))
        if placed is None:
            same = IDENTITY if size is None else _same_footprint(str(like), source.shape, "reference", size)
            placed = _inverse_scale(same)
        return Grid(source.shape, source.geolocation, str(like), placed)
    if known is None or size is None:
        raise InputError("the registration does not say the reference's size; give the reference image as like")
    path = known.path
    if is_there(path):
        try:
            source = located_source(path, known.band)
            if source.shape != size:
                logger.warning(
                    "%s is not the reference any more: %s, it was %s", path, _size(source.shape), _size(size)
                )
            elif known.geolocation is not None and not _in_place(source, known):
                logger.warning("%s is not the reference any more: it lies elsewhere than that did", path)
            else:
                return Grid(size, source.geolocation, path, IDENTITY)
        except InputError as error:
            logger.warning("the reference cannot be read (%s)", error)
    elif known.geolocation is None and path not in ("array", "tie points"):
        logger.warning(
            "the reference '%s' is not there, and the result does not say where it lies: the output gets no "
            "georeferencing; give the reference's file as like (--like)", path,
        )  # fmt: skip
    return Grid(size, known.geolocation, None, IDENTITY)


def _in_place(source: RasterSource, known: InputImage) -> bool:
    """Whether a file lies where the image that was matched did."""
    try:
        found = relation(_placed(source), Placed(known.path, known.shape, known.geolocation))
    except InputError:
        return False
    return found is not None and bool((found == IDENTITY).all())


def _placed(source: RasterSource) -> Placed:
    return Placed(source.path, source.shape, source.geolocation)


def _matched(image: InputImage, role: str) -> Placed:
    """Where an image was when it was matched: as the result says, else as its file does, where it is the same still."""
    name = f"the {role} of the result"
    if image.geolocation is None and is_there(image.path):
        try:
            source = located_source(image.path, image.band)
            if source.shape == image.shape:
                return Placed(name, image.shape, source.geolocation)
        except InputError:
            pass
    return Placed(name, image.shape, image.geolocation)


def grid_model(
    registration: Registration, grid: Grid, source: RasterSource, scale: tuple[float, float] | None
) -> Model:
    """Return the model from the pixels of a grid to those of a file of the secondary's footprint.

    Parameters
    ----------
    registration, grid : the result, and where the output lies
    source : the file to resample
    scale : its pixels per pixel of the matched secondary along x and y; None tells it from both files' georeferencing
        where that is at hand, else from the sizes

    Raises
    ------
    InputError
        The file cannot show the footprint of the matched secondary.
    """
    model = model_of(registration)
    known, secondary = registration.secondary, source.path
    size = None if known is None else known.shape
    if scale is not None:
        if not all(np.isfinite(s) and s > 0 for s in scale):
            raise ParameterError(f"the secondary's scale must be > 0, got {scale}")
        after = resized(scale)
        if size is not None:
            _check_scale(secondary, source.shape, size, scale)
    else:
        located = None if known is None else _by_georeferencing(known, source)
        if located is not None:
            after = located
        else:
            after = IDENTITY if size is None else _same_footprint(secondary, source.shape, "secondary", size)
    if (grid.to_matched == IDENTITY).all() and (after == IDENTITY).all():
        return model
    return OtherGrids(model, grid.to_matched, after)


def _by_georeferencing(matched: InputImage, source: RasterSource) -> FloatArray | None:
    """The map from the matched secondary to another file, where both say where they lie."""
    if is_same(matched.path, source.path) and source.shape == matched.shape:
        return None
    return relation(_matched(matched, "secondary"), _placed(source))


def _same_footprint(name: str, shape: tuple[int, int], role: str, size: tuple[int, int]) -> FloatArray:
    """The map from an image as it was matched to a version of it with another pixel size, told from the sizes."""
    if shape == size:
        return IDENTITY
    # Any other ratio is as likely another place: it must be stated.
    for factor in PLAIN_FACTORS:
        if all(abs(old * factor - new) <= 1 for old, new in zip(size, shape, strict=True)):
            logger.warning(
                "%s: %s, the %s that was matched had %s: taken as the same footprint with %.6g times as many pixels "
                "along each axis",
                name, _size(shape), role, _size(size), factor,
            )  # fmt: skip
            return resized((factor, factor))
    hint = (
        "; where it shows the same place with other pixels, state the secondary's scale" if role == "secondary" else ""
    )
    raise InputError(f"{name}: {_size(shape)}, but the {role} of the result was {_size(size)}{hint}")


def _check_scale(name: str, shape: tuple[int, int], size: tuple[int, int], scale: tuple[float, float]) -> None:
    wanted = size[0] * scale[1], size[1] * scale[0]
    if any(abs(w - n) > 1 + 0.01 * w for w, n in zip(wanted, shape, strict=True)):
        logger.warning(
            "%s: %s, with the stated scale %.6g x %.6g the secondary of the result would have %s",
            name, _size(shape), *scale, _size((round(wanted[0]), round(wanted[1]))),
        )  # fmt: skip


def _inverse_scale(affine: FloatArray) -> FloatArray:
    return IDENTITY if affine is IDENTITY else resized((1 / affine[0, 0], 1 / affine[1, 1]))


def _size(shape: tuple[int, int]) -> str:
    return f"{shape[1]} x {shape[0]} pixels"
