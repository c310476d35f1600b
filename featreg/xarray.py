"""The accessor ``.featreg`` of every DataArray, once this module is imported: ``import featreg.xarray``."""

from __future__ import annotations

from typing import Any

import xarray

from featreg.io.images import as_image
from featreg.matching import match
from featreg.products.in_memory import warp
from featreg.results.registration import Registration
from featreg.types import Image

_registered: Any = xarray.register_dataarray_accessor


@_registered("featreg")
class Accessor:
    """What featreg does with one DataArray.

    Parameters
    ----------
    array : rows, columns and at most one dimension of bands; see `featreg.io.data_arrays`
    """

    def __init__(self, array: xarray.DataArray) -> None:
        self._array = array

    def to_image(self, **keywords: Any) -> Image:
        """Return the array as `featreg.as_image` does; the same keywords."""
        return as_image(self._array, **keywords)

    def registration_to(self, reference: Any, **keywords: Any) -> Registration:
        """Register this array, the secondary, to a reference; keywords of `featreg.match`."""
        return match(reference, self._array, **keywords)

    def register_to(self, reference: Any, *, resampling: str = "lanczos", **keywords: Any) -> xarray.DataArray:
        """Return this array on the grid of a reference.

        Parameters
        ----------
        reference : whatever `featreg.match` takes; of a DataArray the result has the coordinates
        resampling : "nearest", "bilinear", "cubic" or "lanczos"
        keywords : of `featreg.match`

        Returns
        -------
        DataArray of `featreg.warp`; ``attrs["featreg_status"]`` is "ok" or "unreliable" (then a warning is logged),
        ``attrs["featreg_reason"]`` says why

        Raises
        ------
        InputError
            No model could be fitted; the text says why.
        """
        registration = self.registration_to(reference, **keywords)
        like = reference if isinstance(reference, xarray.DataArray) else None
        band = keywords.get("secondary_band", keywords.get("band"))
        made: xarray.DataArray = warp(registration, self._array, like=like, resampling=resampling, band=band)
        return made
