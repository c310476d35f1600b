"""What counts rows or levels is whole: fractions are refused, not cut off."""

from __future__ import annotations

import numpy as np
import pytest

from featreg.errors import InputError
from featreg.types import Features, Matches


def test_fractions_are_refused_where_whole_numbers_are_needed() -> None:
    a = np.zeros((4, 2))
    with pytest.raises(InputError, match=r"Matches\.origin must be an array of int64: some have fractions"):
        Matches(a, a, np.ones(4), origin=[0, 1.5, -1, 2])
    with pytest.raises(InputError, match=r"Features\.level must be an array of int64: some have fractions"):
        Features(a, np.ones(4), np.zeros(4), np.ones(4), np.full(4, 0.5))
    assert Matches(a, a, np.ones(4), origin=np.array([0.0, 1.0, -1.0, 2.0])).origin.tolist() == [0, 1, -1, 2]
