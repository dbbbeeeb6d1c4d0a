"""Rasters of many kinds as rasterio writes them, and what it and PROJ read in them."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from rasterio.crs import CRS
from rasterio.enums import Resampling
from rasterio.transform import Affine
from rasterio.warp import transform

ROWS, COLS = 12, 17
HEIGHTS = 1000 + 30 * np.random.default_rng(7).random((ROWS, COLS)).cumsum(axis=0)
UTM = Affine(10, 0, 583960, 0, -10, 4507523)
MERCATOR = Affine(10, 0, -8238310, 0, -10, 4970072)
DEGREES = Affine(1 / 3600, 0, -74, 0, -1 / 3600, 60.5)
CASES: dict[str, dict[str, Any]] = {
    "mercator": {"crs": 3857, "transform": MERCATOR},
    "degrees": {"crs": 4326, "transform": DEGREES},
    "utm": {"crs": 32618, "transform": UTM},
    "utm_south": {"crs": 32718, "transform": Affine(5, 0, 300000, 0, -5, 8000000)},
    "state_plane_feet": {"crs": 2263, "transform": Affine(30, 0, 985000, 0, -30, 210000)},
    "south_up": {"crs": 32618, "transform": Affine(10, 0, 583960, 0, 10, 4507523)},
    "west_up": {"crs": 32618, "transform": Affine(0, 10, 583960, 10, 0, 4507523)},
    "turned": {"crs": 32618, "transform": UTM @ Affine.rotation(30)},
    "scale_offset": {"crs": 32618, "transform": UTM, "dtype": "int16", "scale": 0.1, "offset": 1000.0},
    "feet": {"crs": 32618, "transform": UTM, "unit": "ft"},
    "survey_feet": {"crs": 32618, "transform": UTM, "unit": "US survey foot"},
    "nodata": {"crs": 32618, "transform": UTM, "nodata": -1.0, "holes": -1.0},
    "int32": {"crs": 32618, "transform": UTM, "dtype": "int32"},
    "uint32": {"crs": 32618, "transform": UTM, "dtype": "uint32"},
    "float64": {"crs": 32618, "transform": UTM, "dtype": "float64"},
    "zstd": {"crs": 32618, "transform": UTM, "compress": "zstd", "predictor": 3},
    "lerc": {"crs": 32618, "transform": UTM, "compress": "lerc"},
    "tiled_lzw": {"crs": 32618, "transform": UTM, "compress": "lzw", "predictor": 2, "dtype": "int16",
                  "tiled": True, "blockxsize": 16, "blockysize": 16},
    "bigtiff": {"crs": 32618, "transform": UTM, "BIGTIFF": "YES"},
    "overviews": {"crs": 32618, "transform": UTM, "overviews": [2]},
    "mask": {"crs": 32618, "transform": UTM, "mask": True},
    "point": {"crs": 32618, "transform": UTM, "point": True},
    "no_system": {"transform": UTM},
}  # fmt: skip


def write_raster(path: Path) -> None:
    """Write the case of a file's name."""
    case = dict(CASES[path.stem])
    dtype, holes = case.pop("dtype", "float32"), case.pop("holes", None)
    scale, offset = case.pop("scale", 1.0), case.pop("offset", 0.0)
    unit, overviews, mask, point = (case.pop(k, None) for k in ("unit", "overviews", "mask", "point"))
    pixels = ((HEIGHTS - offset) / scale).astype(dtype)
    if holes is not None:
        pixels[2:4, 5] = holes
    crs = case.pop("crs", None)
    profile = {"driver": "GTiff", "width": COLS, "height": ROWS, "count": 1, "dtype": dtype} | case
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True, GDAL_TIFF_OVR_BLOCKSIZE=64):
        with rasterio.open(path, "w", crs=crs and CRS.from_epsg(crs), **profile) as file:
            file.write(pixels, 1)
            if scale != 1.0:
                file.scales, file.offsets = (scale,), (offset,)
            if unit:
                file.units = (unit,)
            if point:
                file.update_tags(AREA_OR_POINT="Point")
            if mask:
                file.write_mask(np.arange(COLS)[None, :] + np.zeros((ROWS, 1)) > 1)
        if overviews:
            with rasterio.open(path, "r+") as file:
                file.build_overviews(overviews, Resampling.nearest)


def read_truth(path: Path) -> dict[str, Any]:
    with rasterio.open(path) as file:
        values = file.read(1, masked=True).astype(np.float64) * file.scales[0] + file.offsets[0]
        entry: dict[str, Any] = {
            "epsg": file.crs and file.crs.to_epsg(),
            "transform": list(file.transform)[:6],
            "nodata": file.nodata,
            "unit": file.units[0],
            "heights": values.filled(np.nan),
        }
        if file.crs is not None:
            entry |= _on_the_ground(file)
    return entry


def _on_the_ground(file: Any) -> dict[str, Any]:
    """Return latitudes and longitudes of the corner pixels' middles, and meters of the middle pixel.

    Distances from the center of an azimuthal equidistant projection are true.
    """
    to, wgs84 = file.transform, CRS.from_epsg(4326)
    corners = [to @ (c + 0.5, r + 0.5) for c in (0, COLS - 1) for r in (0, ROWS - 1)]
    longitude, latitude = transform(file.crs, wgs84, *map(list, zip(*corners, strict=True)))
    u, v = COLS / 2, ROWS / 2
    around = [to @ p for p in ((u, v), (u - 0.5, v), (u + 0.5, v), (u, v - 0.5), (u, v + 0.5))]
    x, y = map(list, zip(*around, strict=True))
    lon, lat = transform(file.crs, wgs84, x[:1], y[:1])
    local = CRS.from_proj4(f"+proj=aeqd +lat_0={lat[0]!r} +lon_0={lon[0]!r} +ellps=WGS84 +units=m")
    east, north = transform(file.crs, local, x, y)
    return {
        "corners": [list(pair) for pair in zip(latitude, longitude, strict=True)],
        "pixel": [math.hypot(east[i + 1] - east[i], north[i + 1] - north[i]) for i in (1, 3)],
    }
