"""Pairing of descriptors by OpenCV 5: approximate nearest neighbours, and LightGlue from a file in the format ONNX."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from annotated_types import Ge, Interval

from featreg.errors import ParameterError
from featreg.interfaces import Nearest
from featreg.interop.family import Member, Row, option, register_table
from featreg.interop.opencv import NetworkRow, clear_errors, onnx_weights, resolve, unavailable
from featreg.types import Features, FloatArray, IntArray


class AnnRow(Row):
    """OpenCV's index of approximate nearest neighbours."""

    @property
    def unavailable(self) -> str:
        return unavailable(self.creator)


def _lightglue(create: Any, path: str, values: Mapping[str, Any]) -> Any:
    return create(path, values["score_threshold"])


TABLE: dict[str, Row] = {
    "opencv-ann": AnnRow(
        "ANNIndex",
        "Approximate nearest neighbours in a forest of random projection trees (Annoy), by OpenCV 5",
        {
            "trees": option(16, Ge(1), meaning="more are slower and find more of the true neighbours"),
            "search_k": option(-1, meaning="nodes looked at for each descriptor; -1: trees times neighbours"),
            "mutual": option(True, meaning="keep a pair only where each is the other's nearest"),
            "ratio": option(
                1.0, Interval(gt=0, le=1), meaning="keep a pair only where its distance is below that part of the next"
            ),
            "seed": option(0, Ge(0), meaning="of the projections"),
        },
    ),
    "opencv-lightglue": NetworkRow(
        "LightGlueMatcher",
        "LightGlue: learned matching of the points that its ONNX file was made for, by OpenCV 5",
        {"score_threshold": option(0.0, Interval(ge=0, le=1)), "weights": onnx_weights()},
        build=_lightglue,
        reads_image=False,
    ),
}


@register_table
class OpenCVNearest(Member, Nearest):
    """One way of OpenCV 5 to pair descriptors: a row of the table by name, and its parameters."""

    table = TABLE
    compiled = False

    def match_features(self, reference: Features, secondary: Features) -> tuple[IntArray, FloatArray]:
        """Return ((M, 2) rows of reference and secondary, (M,) score, higher is better).

        Raises
        ------
        ParameterError
            The two sets have descriptors of different kinds or lengths, or none at all.
        PluginUnavailableError
            This OpenCV has no such matcher, or no file of weights is given.

        Notes
        -----
        The score is 1 for equal descriptors and falls with the distance (opencv-ann), or LightGlue's own. Bits are
        given to the index as numbers 0 and 1: its own Hamming distance finds wrong neighbours in OpenCV 5.0 (with 16 of
        512 bits changed none of 2000 descriptors is found again, with none changed 56 %).
        """
        if not len(reference) or not len(secondary):
            return np.zeros((0, 2), np.int64), np.zeros(0)
        a, b = reference.descriptors, secondary.descriptors
        if a is None or b is None or reference.norm != secondary.norm or a.shape[1] != b.shape[1]:
            raise ParameterError(f"{self.name} needs descriptors of one kind and length in both images")
        if self.name == "opencv-lightglue":
            return self._lightglue(reference, secondary)
        forward, distance, second = self._nearest(a, b, reference.norm)
        rows = np.arange(len(a))
        keep = np.ones(len(a), np.bool_)
        if self.parameters["mutual"]:
            keep &= self._nearest(b, a, reference.norm)[0][forward] == rows
        if self.parameters["ratio"] < 1:
            keep &= distance < self.parameters["ratio"] * second
        bits = reference.norm == "hamming"
        score = 1 - distance / (8 * a.shape[1]) if bits else 1 / (1 + distance)
        return np.column_stack([rows, forward])[keep].astype(np.int64), score[keep]

    def _nearest(self, a: Any, b: Any, norm: str) -> tuple[IntArray, FloatArray, FloatArray]:
        """Of each row of a the nearest of b that the index finds, its distance, and that of the next."""
        import cv2

        library: Any = cv2
        create: Any = resolve("ANNIndex")
        if norm == "hamming":
            a, b = (np.unpackbits(np.asarray(table, np.uint8), axis=1) for table in (a, b))
        a, b = (np.ascontiguousarray(table, np.float32) for table in (a, b))
        with clear_errors("ANNIndex"):
            index = create(b.shape[1], library.ANNIndex_DIST_EUCLIDEAN)
            index.setSeed(self.parameters["seed"])
            index.addItems(b)
            index.build(self.parameters["trees"])
            found, distance = index.knnSearch(a, min(2, len(b)), search_k=self.parameters["search_k"])
        found = np.asarray(found, np.int64).reshape(len(a), -1)
        distance = np.asarray(distance, np.float64).reshape(len(a), -1)
        # Of bits the squared distance is the number that differ.
        distance = np.rint(distance**2) if norm == "hamming" else distance
        second = distance[:, 1] if len(b) > 1 else np.full(len(a), np.inf)
        return found[:, 0], distance[:, 0], second

    def _lightglue(self, reference: Features, secondary: Features) -> tuple[IntArray, FloatArray]:
        row: Any = self.row
        matcher = row.network(self.name, self.parameters)
        sides = []
        for features in (reference, secondary):
            xy = np.ascontiguousarray(features.xy, np.float32)
            # The size of the image is not known here: that of the point set stands for it.
            sides.append((xy, tuple(int(n) for n in np.maximum(np.ceil(xy.max(axis=0)), 1))))
        with clear_errors("LightGlueMatcher"):
            matcher.setPairInfo(sides[0][0], sides[1][0], sides[0][1], sides[1][1])
            found = matcher.match(*(np.ascontiguousarray(f.descriptors, np.float32) for f in (reference, secondary)))
        pairs = np.array([(m.queryIdx, m.trainIdx) for m in found], np.int64).reshape(-1, 2)
        return pairs, -np.array([m.distance for m in found], np.float64)
