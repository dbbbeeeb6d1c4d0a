"""Pictures and elevation data, through Pillow and GDAL."""
