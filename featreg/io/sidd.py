"""SIDD: detected SAR products in NITF; GDAL reads their pixels, sarkit (the `sicd` extra) says where these lie."""

from __future__ import annotations

import logging
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from featreg.errors import InputError
from featreg.io.ellipsoid import geodetic
from featreg.io.gdal_errors import decoding
from featreg.io.gdal_reader import GdalReader
from featreg.io.products.sidd import sensor_of_sidd
from featreg.io.sarkit_metadata import BROKEN, silent
from featreg.io.sicd import GRID
from featreg.types import Geolocation

#: A kind of grid that sarkit, at least to 1.8.1, tilts: it takes the latitude in radians for degrees.
CYLINDRICAL = "Cylindrical Gridded Display"

logger = logging.getLogger("featreg.io")


class SiddReader(GdalReader):
    """A SIDD of one product image.

    Parameters
    ----------
    path : of the file

    Notes
    -----
    Without sarkit, or where its metadata make no projection, it lies where its NITF says (four corners), and the log
    says so.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(str(path.absolute()), ["NITF"], str(path))
        self.path = path

    def geolocation(self, band: int) -> Geolocation | None:
        """The SIDD's own projection as a sensor, and control points from it on its surface."""
        return self._projection or super().geolocation(band)

    @cached_property
    def _projection(self) -> Geolocation | None:
        try:
            sidd: Any = import_module("sarkit.sidd")
        except ImportError:
            logger.warning(
                "%s: is a SIDD, whose projection needs sarkit; install it with: pip install 'featreg[sicd]'. It counts "
                "as lying where its four corners do",
                self.called,
            )
            return None
        shape = self.dataset.height, self.dataset.width
        try:
            with silent():
                with decoding(self.path, "SIDD"), self.path.open("rb") as file:
                    tree = sidd.NitfReader(file).metadata.images[0].xmltree
                stated = tuple(int(n) for n in sidd.XmlHelper(tree).load("./{*}Measurement/{*}PixelFootprint"))
                if stated != shape:
                    raise ValueError(f"it describes {stated[1]} x {stated[0]} pixels")
                if sidd.get_coordinate_system_type(tree) == CYLINDRICAL:
                    raise ValueError("its grid is cylindrical")
                row, col = np.meshgrid(*(np.linspace(0, n - 1, GRID) for n in shape), indexing="ij")
                pixels = np.column_stack([row.ravel(), col.ravel()])
                ground = geodetic(sidd.pixel_to_ecef(tree, pixels))
                if not np.isfinite(ground).all():
                    raise ValueError("it does not reach the ground")
                sensor = sensor_of_sidd(tree)
        except (InputError, *BROKEN) as error:
            logger.warning(
                "%s: the metadata of the SIDD make no projection (%s); it counts as lying where its four corners do",
                self.called,
                error,
            )
            return None
        return Geolocation(crs="EPSG:4326", gcps=np.column_stack([pixels[:, ::-1], ground]), sensor=sensor)
