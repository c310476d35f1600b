"""Files and arrays in, files out: images, windows of whole scenes, GeoTIFF.

images          a path or an array to an `Image`
readers, sicd   image files as they are
masks, scales   which samples are data, and what amplitude they stand for
raster_source   scenes by `window`, from raster_files
writers         files that appear whole or not at all
"""

from featreg.io.images import SMALLEST, ImageLike, as_image, read_image
from featreg.io.writers import write_geotiff

__all__ = ["SMALLEST", "ImageLike", "as_image", "read_image", "write_geotiff"]
