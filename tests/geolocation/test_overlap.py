"""The area that both images show."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from rasterio.transform import from_origin

from featreg.errors import InputError, NoOverlapError
from featreg.geolocation import ConstantHeight, DemHeights, GeotransformSensor, RpcSensor, find_overlap
from featreg.geolocation.overlap import largest_rectangle
from featreg.simulate.orbit import RangeDoppler

SHAPE = (2000, 2200)
UTM = "EPSG:32633"


class TestOverlap:
    def grid(self, x: float, y: float, step: float = 10.0, turn: float = 0.0) -> GeotransformSensor:
        c, s = step * math.cos(turn), step * math.sin(turn)
        return GeotransformSensor((c, s, 300_000 + x, s, -c, 5_200_000 - y), UTM, (100, 100))

    def test_shifted_grids_share_the_expected_windows(self) -> None:
        found = find_overlap(self.grid(0, 0), self.grid(200, 300), (100, 120), (90, 110), ConstantHeight())
        here, there = found.reference, found.secondary
        assert (here.x, here.y, here.width, here.height) == (20, 30, 100, 70)
        assert (there.x, there.y, there.width, there.height) == (0, 0, 100, 70)
        assert np.allclose(found.transfer(np.array([[20.0, 30.0]])), [[0, 0]], atol=1e-6)
        assert found.uncertainty_px == pytest.approx(5 * math.sqrt(2))

    def test_an_image_inside_the_other_is_kept_whole(self) -> None:
        found = find_overlap(self.grid(0, 0), self.grid(-1000, -1000), (100, 120), (900, 900), ConstantHeight())
        here, there = found.reference, found.secondary
        assert (here.x, here.y, here.width, here.height) == (0, 0, 120, 100)
        assert (there.x, there.y, there.width, there.height) == (100, 100, 120, 100)

    def test_every_pixel_of_a_turned_overlap_lies_in_both_images(self) -> None:
        shape = (400, 400)
        found = find_overlap(self.grid(0, 0), self.grid(300, 500, turn=0.1), shape, shape, ConstantHeight())
        w = found.reference
        x, y = np.meshgrid(np.arange(w.x, w.x + w.width), np.arange(w.y, w.y + w.height))
        mapped = found.transfer(np.column_stack([x.ravel(), y.ravel()]).astype(float))
        assert ((mapped > -0.51) & (mapped < 399.51)).all()
        low, high = mapped.min(axis=0), mapped.max(axis=0)
        s = found.secondary
        assert s.x - 1 <= low[0] + 1e-6
        assert s.x + s.width >= high[0]
        assert w.width * w.height > 0.6 * 400 * 400

    def test_no_overlap_says_where_each_image_lies(self, rpc: RpcSensor, orbit: Callable[..., RangeDoppler]) -> None:
        far = orbit(place=(13.0, 47.0)).rpc(SHAPE, -200.0, 1000.0, 15.0)
        with pytest.raises(NoOverlapError) as caught:
            find_overlap(rpc, far, SHAPE, SHAPE, ConstantHeight(400.0), names=("a.tif", "b.tif"))
        text = str(caught.value)
        assert "a.tif spans longitude 11.9" in text
        assert "b.tif spans longitude 12.9" in text
        assert "75.9 km apart" in text

    def test_an_elevation_model_elsewhere_is_refused(
        self, rpc: RpcSensor, tmp_path: Path, write_dem: Callable[..., str]
    ) -> None:
        dem = DemHeights(write_dem(tmp_path / "dem.tif", np.zeros((20, 20)), from_origin(80.0, 10.0, 0.01, 0.01)))
        with pytest.raises(InputError, match=r"dem.tif: covers none of the overlap; it spans longitude 80\.0000"):
            find_overlap(rpc, rpc, SHAPE, SHAPE, dem)

    def test_the_largest_rectangle_is_the_largest(self) -> None:
        rng = np.random.default_rng(0)
        for _ in range(60):
            cells = rng.random(rng.integers(1, 9, 2)) < 0.7
            rows, columns = cells.shape
            best = max(
                (
                    (b - t) * (r - left)
                    for t in range(rows)
                    for b in range(t + 1, rows + 1)
                    for left in range(columns)
                    for r in range(left + 1, columns + 1)
                    if cells[t:b, left:r].all()
                ),
                default=0,
            )
            found = largest_rectangle(cells)
            if found is None:
                assert best == 0
            else:
                top, left, bottom, right = found
                assert cells[top:bottom, left:right].all()
                assert (bottom - top) * (right - left) == best
