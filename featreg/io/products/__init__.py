"""What the metadata of products say that their raster file does not: geometry, calibration, phase."""
