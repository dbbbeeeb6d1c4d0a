"""Picture files: safe decoding, GeoTIFF tags, GDAL."""
