"""Series of dates: the truth between them, a jump, a date of another place."""

from __future__ import annotations

import math

import numpy as np
import pytest

from featreg.errors import ParameterError
from featreg.simulate import sar_series


def test_dates_lie_where_their_truth_says() -> None:
    series = sar_series(3, (128, 128), looks=math.inf, drift=0.0, rotation_deg=0.0, jump=(1, 3.0, -2.0), seed=2)
    assert series.truths[0].tolist() == [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    assert series.truths[2][:, 2].tolist() == [3.0, -2.0]
    moved = np.roll(series.images[0], (-2, 3), (0, 1))
    assert np.abs(series.images[1] - moved)[10:-10, 10:-10].max() < 0.05 * series.images[0].max()


def test_a_changed_and_an_unrelated_date_differ() -> None:
    series = sar_series(4, (128, 128), looks=math.inf, drift=0.0, rotation_deg=0.0, changed=1, unrelated=2, seed=3)
    alike = [np.corrcoef(series.images[0].ravel(), image.ravel())[0, 1] for image in series.images]
    assert alike[3] > 0.999
    assert 0.2 < alike[1] < 0.99
    assert abs(alike[2]) < 0.3
    with pytest.raises(ParameterError, match="unrelated must name a date"):
        sar_series(4, unrelated=4)
