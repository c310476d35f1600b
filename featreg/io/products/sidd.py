"""SIDD: the part of its metadata that says where its pixels lie, as a sensor's plain values."""

from __future__ import annotations

import copy
from importlib import import_module
from typing import Any


def sensor_of_sidd(tree: Any) -> dict[str, Any]:
    """Return what `featreg.geolocation.SiddSensor` takes, from the metadata of a SIDD (an lxml element tree): its
    ``Measurement``, some 5 kB, which results keep.

    Raises
    ------
    ValueError
        It lacks what the sensor needs of a grid on a plane: the antenna's path, the time at the centre of aperture.
    """
    plane = tree.find("./{*}Measurement/{*}PlaneProjection")
    for name in () if plane is None else ("ARPPoly", "PlaneProjection/{*}TimeCOAPoly"):
        if tree.find(f"./{{*}}Measurement/{{*}}{name}") is None:
            raise ValueError(f"it has no {name.rpartition('}')[2]}")
    etree: Any = import_module("lxml.etree")
    root = copy.deepcopy(tree.getroot())
    for element in list(root):
        if etree.QName(element).localname != "Measurement":
            root.remove(element)
    return {"type": "sidd", "xml": etree.tostring(root, encoding="unicode")}
