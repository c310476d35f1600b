"""What the metadata of products say that their raster file does not: orbit and timing, calibration."""
