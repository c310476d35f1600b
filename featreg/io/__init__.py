"""Files and arrays in, files out: images, windows of whole scenes, GeoTIFF.

images          a path or an array to an `Image`
opening         whatever a name stands for (source_names) to a `reader`, by content; which of its bands: bands
gdal_drivers    the formats left to GDAL (gdal_reader, vrt, gdal_confined, gdal_errors); others: array_files, hdf5
                (variable, gridded, gridded_places), sicd, sidd
product_folders products that are folders or archives
products        what their metadata state of geometry; rpc_file beside images, calibration, ellipsoid
masks, scales   which samples are data, and what amplitude they stand for
raster_source   scenes by `window`, from raster_files
writers         files that appear whole or not at all
"""

from featreg.io.images import SMALLEST, ImageLike, as_image, read_image
from featreg.io.writers import write_geotiff

__all__ = ["SMALLEST", "ImageLike", "as_image", "read_image", "write_geotiff"]
