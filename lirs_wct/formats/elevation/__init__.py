"""Elevation data: GeoTIFF, ESRI ASCII grid, SRTM's HGT, encoded tiles, and by GDAL whatever else it reads."""
