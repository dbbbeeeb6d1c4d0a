"""A raster of heights from any file: the picture formats, ASCII grids, HGT, and by GDAL all others."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from lirs_wct.errors import ConfigError, SourceError
from lirs_wct.formats.elevation.ascii_grid import read_ascii_grid
from lirs_wct.formats.elevation.hgt import read_hgt
from lirs_wct.formats.images.gdal import DRIVERS, rasterio_there, read_gdal
from lirs_wct.formats.images.geotiff import RasterInfo, height_unit, located, raster_info, tell_turn
from lirs_wct.formats.images.header import MAX_PIXELS
from lirs_wct.formats.images.picture import check_size, read_picture
from lirs_wct.formats.suffixes import RASTERS
from lirs_wct.geometry.geodesy.earth import CoordinateSystem
from lirs_wct.geometry.geodesy.georeference import Georeference, middle_of_pixels


@dataclass(frozen=True, slots=True)
class Raster:
    """Pixels that are, or become, heights; row 0 is the northernmost as far as that is known.

    Attributes:
        pixels: (rows, cols) gray or (rows, cols, 3) BGR, in the file's own type.
        info: what the file says of them.
    """

    pixels: NDArray[Any]
    info: RasterInfo = field(default_factory=RasterInfo)


def read_raster(path: Path, max_pixels: int = MAX_PIXELS) -> Raster:
    """Read the raster of a file.

    Raises:
        SourceError: the file is missing, damaged, of an unknown format, smaller than 2x2 or larger than
            `max_pixels`, or needs rasterio, which is not there.
    """
    suffix = path.suffix.lower()
    pixels: NDArray[Any]
    if suffix == ".asc":
        pixels, info = read_ascii_grid(path, max_pixels)
    elif suffix == ".hgt":
        pixels, info = read_hgt(path, max_pixels)
    elif suffix in RASTERS:
        pixels, info = _read_by_gdal(path, max_pixels)
    else:
        picture = read_picture(path, max_pixels)
        pixels = picture.pixels
        info = raster_info(path, picture.tags) if picture.tags else RasterInfo()
    if pixels.dtype.kind == "c":
        raise SourceError(f"{path}: holds complex numbers, heights must be integers or real numbers")
    if info.georeference is None:
        return Raster(pixels, info)
    georeference = _by_proj(path, info.georeference, pixels.shape[:2])
    pixels, georeference = georeference.upright(pixels)
    tell_turn(path, georeference)
    return Raster(pixels, replace(info, georeference=georeference))


def _by_proj(path: Path, found: Georeference, shape: tuple[int, ...]) -> Georeference:
    """Let GDAL, if it is there, say where a GeoTIFF lies whose system is defined by its parameters."""
    if found.system.name or not found.located or path.suffix.lower() == ".asc" or not rasterio_there():
        return found
    system = system_of(read_gdal(path, DRIVERS[".tif"], 0).crs)
    if system.form != "other":
        return found
    try:
        return Georeference.of(system, found.affine, (shape[0], shape[1]))
    except ConfigError:
        return replace(found, system=system)  # on another celestial body


def _read_by_gdal(path: Path, max_pixels: int) -> tuple[NDArray[Any], RasterInfo]:
    """Read the first band of a raster, and what GDAL says of it."""
    found = read_gdal(path, DRIVERS[path.suffix.lower()], max_pixels)
    check_size(path, found.width, found.height, max_pixels)
    assert found.pixels is not None
    info = RasterInfo(None, found.nodata, found.scale, found.offset, height_unit(path, found.unit))
    if found.transform is not None:
        affine = middle_of_pixels(found.transform)
        try:
            info = replace(info, georeference=located(path, system_of(found.crs), affine, found.pixels.shape))
        except ConfigError as error:
            raise SourceError(f"{path}: {error}") from error
    return found.pixels, info


def system_of(crs: Any) -> CoordinateSystem:
    """Return the coordinate system of rasterio's CRS; None is unknown."""
    if crs is None:
        return CoordinateSystem()
    code = crs.to_epsg()
    unit = 1.0 if crs.is_geographic else float(crs.linear_units_factor[1])
    if code is not None:
        return CoordinateSystem.of_code(code, unit)
    return CoordinateSystem(crs.to_wkt(), "geographic" if crs.is_geographic else "other", unit)
