"""What threads share out the rows of: the same bits however they are divided."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from featreg.descriptors.brief import Brief
from featreg.detectors.sar_harris import SarHarris
from featreg.detectors.sar_ofast import SarOfast
from numpy.typing import NDArray

from featreg.geometry import Affine
from featreg.io import as_image
from featreg.pipeline.agreement import Agreement
from featreg.pipeline.identical import _drawn, _surveyed
from featreg.pipeline.refine import strongest_of_cells
from featreg.runtime import threads
from featreg.runtime.threads import limited_threads
from featreg.sar.correlation import _steps
from featreg.sar.filtered_rows import filtered_rows
from featreg.sar.gradients.ratio import quantised_edges, roewa, roewa_strength
from featreg.sar.keypoints.corners import fast_corners
from featreg.sar.keypoints.harris import harris_response
from featreg.sar.keypoints.maxima import local_maxima
from featreg.sar.pyramid import pyramid
from featreg.sar.speckle import despeckled, despeckled_bytes, despeckled_halved, log_amplitude, mean_amplitude
from featreg.types import Image

MODEL = Affine(np.array([[0.98, 0.1, 3.3], [-0.1, 1.02, 6.6]]))
ALL = np.ones((251, 333), np.bool_)


def _levels(image: Image, other: Image) -> list[Any]:
    return [array for level in pyramid(image, 3, 1.3)[1:] for array in (level.pixels, level.mask)]


def _keypoints(image: Image, other: Image) -> list[Any]:
    found = SarOfast(n_features=200, levels=2, factor=1.3, support=8).detect_features(image)
    described = Brief(levels=2, factor=1.3, radius=8).describe_features(image, found)
    corners = SarHarris(n_features=200, scales=3, support=4).detect_features(image)
    return [*(v for f in (described, corners) for v in (f.xy, f.angle, f.score)), described.descriptors]


def _agreement(image: Image, other: Image) -> list[Any]:
    found = Agreement.of(image, other, MODEL)
    assert found is not None
    return [found.here, found.there, found.valid, *found.whole[:2], found.elsewhere, found.windows.height]


def _drawing(image: Image, other: Image) -> list[Any]:
    first, second = (np.array(one.amplitude) for one in (image, other))
    for one in (first, second):
        one[20:60, 30:33] = 99
    drawn = _drawn(first, second, ALL, 99.0)
    assert drawn is not None
    return [drawn, *_surveyed(first, second, ALL)]


MADE: dict[str, Callable[[Image, Image], list[Any]]] = {
    "pyramid": _levels,
    "views": lambda a, b: [log_amplitude(a), despeckled(a), despeckled_halved(a), despeckled_bytes(a)],
    "mean": lambda a, b: [mean_amplitude(a)],
    "edges": lambda a, b: [quantised_edges(a, 2.0), roewa_strength(a.amplitude, 2.0), *roewa(a.amplitude, 2.0)],
    "response": lambda a, b: [harris_response(*roewa(a.amplitude, 2.0), 1.5)],
    "maxima": lambda a, b: [local_maxima(a.amplitude, ALL, 0.5, 300), *fast_corners(_bytes(a), 20, ALL, 300)],
    "keypoints": _keypoints,
    "steps": lambda a, b: [_steps(a.amplitude.ravel(), 9)],
    "cells": lambda a, b: [strongest_of_cells(despeckled(a), 90, 7)],
    "agreement": _agreement,
    "identical": _drawing,
    "filter": lambda a, b: [filtered_rows(lambda rows: cv2.GaussianBlur(rows, (0, 0), 2.0), a.amplitude, 8)],
    "read": lambda a, b: [as_image(a.pixels.astype(np.float64)).pixels],
}


def _bytes(image: Image) -> NDArray[np.uint8]:
    return np.asarray(np.minimum(80 * image.amplitude, 255), np.uint8)


@pytest.mark.parametrize("name", MADE)
@pytest.mark.parametrize("holes", [False, True])
def test_the_same_bits_however_the_rows_are_divided(name: str, holes: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("featreg.sar.gradients.ratio.TILE", 48)
    monkeypatch.setattr("featreg.sar.speckle.LARGE", 1000)
    monkeypatch.setattr("featreg.sar.speckle.STRIP", 7000)
    rng = np.random.default_rng(0)
    mask = ALL.copy()
    if holes:
        mask[90:130, 50:100] = False
    fields = [cv2.GaussianBlur(rng.normal(size=ALL.shape), (0, 0), 4.0) for _ in range(2)]
    fields[1] = fields[0] + 0.1 * fields[1]
    first, second = (
        as_image(np.exp(9 * field) * rng.gamma(2.0, 0.5, ALL.shape), mask=mask, scale="amplitude") for field in fields
    )

    def made() -> list[Any]:
        # Copies have made nothing yet.
        return MADE[name](replace(first), replace(second))

    whole = made()
    monkeypatch.setattr(threads, "LEAST", 1)
    monkeypatch.setattr(threads, "available_processors", lambda: 3)
    for count in (2, 3):
        with limited_threads(count):
            for one, other in zip(made(), whole, strict=True):
                np.testing.assert_array_equal(one, other)
