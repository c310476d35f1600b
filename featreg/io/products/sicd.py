"""SICD: what its metadata state of its projection, as a sensor's plain values, and of its calibration."""

from __future__ import annotations

import copy
from functools import partial
from importlib import import_module
from typing import Any

import numpy as np
from numpy.polynomial.polynomial import polygrid2d

from featreg.errors import InputError
from featreg.io.calibration import Calibration
from featreg.io.window import Window
from featreg.types import FloatArray

#: Elements of a SICD that say where its pixels lie.
NEEDED = {
    "CollectionInfo": ("CollectType",),
    "ImageData": ("NumRows", "NumCols", "FirstRow", "FirstCol", "SCPPixel"),
    "GeoData": ("SCP",),
    "Grid": ("Type", "TimeCOAPoly", "Row", "Col"),
    "Position": (),
    "RadarCollection": ("RcvChannels",),
    "ImageFormation": ("RcvChanProc", "ImageFormAlgo"),
    "SCPCOA": (),
    "ErrorStatistics": (),
    "RgAzComp": (),
    "PFA": (),
    "RMA": (),
}


#: Polynomial of the scale factor by which the squared modulus of a sample becomes each quantity.
SCALE_FACTORS = {"sigma0": "SigmaZeroSFPoly", "beta0": "BetaZeroSFPoly", "gamma0": "GammaZeroSFPoly"}


def sensor_of_sicd(tree: Any) -> dict[str, Any]:
    """Return what `featreg.geolocation.SicdSensor` takes, from the metadata of a SICD (an lxml element tree).

    A part of 10 to 20 kB of what are up to megabytes with tables of antennas and weights: results keep it.
    """
    etree: Any = import_module("lxml.etree")
    root = copy.deepcopy(tree.getroot())
    for element in list(root):
        name = etree.QName(element).localname
        kept = NEEDED.get(name)
        if kept is None:
            root.remove(element)
            continue
        for part in list(element):
            if kept and etree.QName(part).localname not in kept:
                element.remove(part)
    for weights in root.iterfind("{*}Grid/*/{*}WgtFunct"):
        weights.getparent().remove(weights)
    return {"type": "sicd", "xml": etree.tostring(root, encoding="unicode")}


def calibration_of_sicd(sicd: Any, tree: Any, called: str) -> Calibration | None:
    """Return the calibration that the ``Radiometric`` part of a SICD's metadata states; None where there is none.

    Parameters
    ----------
    sicd : the module sarkit.sicd
    tree : the metadata, an lxml element tree
    called : what the file is called in messages

    Raises
    ------
    InputError
        They are broken.

    Notes
    -----
    The squared modulus of a sample times the polynomial of metres from the scene centre point's pixel is the quantity,
    as the standard's volume 1 defines the scale factors.
    """
    helper = sicd.XmlHelper(tree)
    try:
        found = {q: helper.load(f"{{*}}Radiometric/{{*}}{name}") for q, name in SCALE_FACTORS.items()}
        known = {q: np.asarray(table, np.float64) for q, table in found.items() if table is not None}
        if not known:
            return None
        spacing, first, centre = (
            np.array([float(helper.load(name)) for name in names])
            for names in (
                ("{*}Grid/{*}Row/{*}SS", "{*}Grid/{*}Col/{*}SS"),
                ("{*}ImageData/{*}FirstRow", "{*}ImageData/{*}FirstCol"),
                ("{*}ImageData/{*}SCPPixel/{*}Row", "{*}ImageData/{*}SCPPixel/{*}Col"),
            )
        )
    except (TypeError, ValueError, AttributeError, LookupError) as error:
        raise InputError(f"{called}: its Radiometric is broken ({type(error).__name__}: {error})") from error
    factors = {q: partial(_root_of_scale, table, spacing, first - centre, called) for q, table in known.items()}
    return Calibration(factors, "its Radiometric has no other polynomial")


def _root_of_scale(
    table: FloatArray, spacing: FloatArray, origin: FloatArray, called: str, window: Window
) -> FloatArray:
    """(H, W) by which samples are multiplied: the root of a scale factor."""
    rows = (window.y + np.arange(window.height) + origin[0]) * spacing[0]
    cols = (window.x + np.arange(window.width) + origin[1]) * spacing[1]
    power = polygrid2d(rows, cols, table)
    if not (power > 0).all():
        raise InputError(f"{called}: its scale factor is not above 0 everywhere, so its Radiometric is broken")
    return np.asarray(np.sqrt(power))
