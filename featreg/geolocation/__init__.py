"""Where images lie on the ground: sensors, heights, the transfer between two images, their overlap, RPC bias.

Sensor
├── SicdSensor            the image projections of a SICD
├── SiddSensor            the image grid of a SIDD
├── RangeDopplerSensor    state vectors of an orbit and the times of the pixels
├── RpcSensor             rational polynomial coefficients
├── GeotransformSensor    affine grid in a map projection
├── GcpSensor             ground control points
└── CorrectedSensor       any of them with a measured bias

Everything is frozen, picklable, safe to share between threads, float64, and holds no open file.
"""

from featreg.geolocation.corrected import CorrectedSensor
from featreg.geolocation.elevation_model import DemHeights, heights_from_dict
from featreg.geolocation.gcps import GcpSensor
from featreg.geolocation.geotransform import GeotransformSensor
from featreg.geolocation.heights import ConstantHeight, Heights
from featreg.geolocation.overlap import Overlap, find_overlap
from featreg.geolocation.range_doppler import RangeDopplerSensor
from featreg.geolocation.rpc import RpcSensor
from featreg.geolocation.rpc_bias import RpcBias
from featreg.geolocation.sensor import Sensor
from featreg.geolocation.sensors import ground_level, sensor_from_dict, sensor_of
from featreg.geolocation.sicd import SicdSensor
from featreg.geolocation.sidd import SiddSensor
from featreg.geolocation.transfer import Transfer

__all__ = [
    "ConstantHeight",
    "CorrectedSensor",
    "DemHeights",
    "GcpSensor",
    "GeotransformSensor",
    "Heights",
    "Overlap",
    "RangeDopplerSensor",
    "RpcBias",
    "RpcSensor",
    "Sensor",
    "SicdSensor",
    "SiddSensor",
    "Transfer",
    "find_overlap",
    "ground_level",
    "heights_from_dict",
    "sensor_from_dict",
    "sensor_of",
]
