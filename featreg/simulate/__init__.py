"""Simulated SAR data with exactly known truth: image pairs, scenes with RPCs and terrain, circular phase histories.

Here stand the pairs of one landscape, still or moving; `featreg.simulate.scene` and `featreg.simulate.circle` are
imported by name.
"""

from featreg.simulate.displaced import DisplacedPair, displaced_pair
from featreg.simulate.pairs import (
    FINER,
    NOISE,
    STRIP,
    SimulatedPair,
    gamma_field,
    painted,
    sar_pair,
    similarity_matrix,
)
from featreg.simulate.series import SimulatedSeries, sar_series

__all__ = [
    "FINER",
    "NOISE",
    "STRIP",
    "DisplacedPair",
    "SimulatedPair",
    "SimulatedSeries",
    "displaced_pair",
    "gamma_field",
    "painted",
    "sar_pair",
    "sar_series",
    "similarity_matrix",
]
