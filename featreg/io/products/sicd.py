"""SICD: the part of its metadata that its projection needs, as a sensor's plain values."""

from __future__ import annotations

import copy
from importlib import import_module
from typing import Any

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
