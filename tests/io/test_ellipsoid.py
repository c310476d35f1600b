"""The ellipsoid against PROJ."""

from __future__ import annotations

import numpy as np

from featreg.io.ellipsoid import earth_fixed, geodetic


def test_geodetic_coordinates_are_those_of_proj() -> None:
    from rasterio.warp import transform

    lonlat, height = np.array([[12.5, 48.2], [-70.0, -33.3], [0.0, 89.0]]), np.array([300.0, 10.0, 0.0])
    ecef = np.column_stack(transform("EPSG:4979", "EPSG:4978", *lonlat.T.tolist(), height.tolist()))
    np.testing.assert_allclose(earth_fixed(lonlat, height), ecef, atol=1e-6)
    np.testing.assert_allclose(geodetic(ecef), np.column_stack([lonlat, height]), atol=1e-6)
