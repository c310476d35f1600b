"""A simulated pair, matched, and whether two results are the same."""

from __future__ import annotations

from typing import Any

import numpy as np

import featreg
from featreg.results.registration import Registration
from featreg.simulate import SimulatedPair


def matched(pair: SimulatedPair, **keywords: Any) -> Registration:
    return featreg.match(pair.reference, pair.secondary, **keywords)


def assert_same_bits(a: Registration, b: Registration) -> None:
    for name in ("reference_xy", "secondary_xy", "score", "covariance", "origin", "rotation", "scale_ratio"):
        np.testing.assert_array_equal(getattr(a.matches, name), getattr(b.matches, name))
    assert list(a.stages) == list(b.stages)
    for name, mask in a.stages.items():
        np.testing.assert_array_equal(mask, b.stages[name])
    np.testing.assert_array_equal(a.inliers, b.inliers)
    np.testing.assert_array_equal(a.model.matrix, b.model.matrix)
    assert (a.status, a.reason, dict(a.gates)) == (b.status, b.reason, dict(b.gates))
