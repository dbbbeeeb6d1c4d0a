"""Readers of rasters and point clouds: the program of a process with limits.

Its answer on stdout is a line of JSON, then the arrays that it announces.
"""

from __future__ import annotations

import io
import json
import os
import re
import sys
import warnings
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lirs_wct.errors import reason_of

Answer = tuple[dict[str, Any], list[NDArray[Any]]]
DRIVERS = (
    "GTiff",
    "HFA",
    "netCDF",
    "JP2OpenJPEG",
    "DTED",
    "SRTMHGT",
    "AIG",
    "USGSDEM",
    "ENVI",
    "EHdr",
    "PNG",
    "JPEG",
    "BMP",
    "GIF",
    "WEBP",
    "PNM",
    "AAIGrid",
    "XYZ",
)
"""Drivers of GDAL that are tried on a file, in this order. None follows references to other files."""
FOLLOWERS = "VRT DERIVED GTI WMS WMTS WCS TMS DAAS EEDA EEDAI PLMOSAIC HTTP STACIT STACTA NGW OGCAPI Zarr"
"""Drivers that a sidecar could name, and that open other files or a network."""
UNREAD = "is neither a picture nor elevation data that is read; legal: PNG, PGM/PNM, GIF, JPEG, TIFF, BMP, \
WebP, ESRI ASCII grid, and the rasters of GDAL"
UNKNOWN_FORMAT = "not recognized as being in a supported file format"
CODECS = re.compile(r"libjpeg: |TIFF\w+[:(][ )]*")
"""Names of codecs and their functions in messages of GDAL."""
NOISE = (7, 18)
"""Classes of the ASPRS LAS specification 1.4, table 17."""
GROUND = 2


def read_raster(path: str, max_pixels: int) -> Answer:
    """Return a raster's metadata, and its pixels unless there are too many."""
    os.environ |= {
        "GDAL_SKIP": FOLLOWERS,
        "CPL_VSIL_CURL_ALLOWED_FILENAME": "none",
        "GDAL_CACHEMAX": "64",
        "GDAL_ERROR_ON_LIBJPEG_WARNING": "YES",
        "PROJ_NETWORK": "OFF",
    }
    with _open_raster(path) as dataset:
        if dataset.count == 0:
            names = ", ".join(name.rsplit(":", 1)[-1] for name in dataset.subdatasets) or "none"
            raise ValueError(f"holds several rasters ({names}), one is needed: gdal_translate cuts it out")
        # The driver of PNM leaves its transform unset.
        unplaced = dataset.transform.is_identity or dataset.driver == "PNM"
        if unplaced and dataset.gcps[0]:
            raise ValueError("is placed by ground control points: gdalwarp gives it a regular grid")
        small = dataset.width * dataset.height <= max_pixels
        return {
            "width": dataset.width,
            "height": dataset.height,
            "bands": sum(kind.name != "alpha" for kind in dataset.colorinterp),
            "white": _white(dataset),
            "pages": max(1, len(dataset.subdatasets)),
            "nodata": dataset.nodata,
            "scale": dataset.scales[0],
            "offset": dataset.offsets[0],
            "unit": dataset.units[0] or "",
            "transform": None if unplaced else tuple(dataset.transform)[:6],
            "wkt": dataset.crs.to_wkt() if dataset.crs else "",
        }, [_pixels(dataset)] if small else []


def _open_raster(path: str) -> Any:
    """Open a raster by the first driver that knows its content."""
    import rasterio

    reasons = []
    for driver in DRIVERS:
        try:
            return rasterio.open(path, driver=driver)
        except (rasterio.errors.RasterioError, SystemError) as error:
            reason = str(error.__cause__ or error).splitlines()[0]
            reasons += [] if UNKNOWN_FORMAT in reason or "No such driver" in reason else [reason]
    raise ValueError(f"cannot be read by GDAL: {reasons[0]}" if reasons else UNREAD)


def _pixels(dataset: Any) -> NDArray[Any]:
    """Return colors as (rows, cols, 3 or 4) BGR(A), else the first band."""
    kinds = [kind.name for kind in dataset.colorinterp]
    if kinds[:1] == ["palette"]:
        table = dataset.colormap(1)
        colors = np.array([table.get(k, (0, 0, 0, 255)) for k in range(max(table) + 1)], np.uint8)
        picture: NDArray[Any] = colors[dataset.read(1)][..., [2, 1, 0, 3]]
        return picture if (colors[:, 3] < 255).any() else picture[..., :3]
    if kinds[:3] == ["red", "green", "blue"]:
        order = [3, 2, 1, *([4] if kinds[3:4] == ["alpha"] else [])]
        return np.ascontiguousarray(np.moveaxis(dataset.read(order), 0, 2))
    band: NDArray[Any] = dataset.read(1)
    if kinds == ["gray", "alpha"] and band.dtype.kind == "u" and dataset.transform.is_identity:
        return np.dstack([band] * 3 + [dataset.read(2)])  # a picture, not heights
    if dataset.tags(ns="IMAGE_STRUCTURE").get("MINISWHITE") == "YES" and band.dtype.kind == "u":
        band = (_white(dataset) - band).astype(band.dtype)
    if "alpha" in kinds:
        shown = dataset.read(kinds.index("alpha") + 1)
    elif {flag.name for flag in dataset.mask_flag_enums[0]} == {"per_dataset"}:
        shown = dataset.read_masks(1)
    else:
        return band
    return band if shown.all() else np.where(shown, band.astype(np.float64), np.nan)


def _white(dataset: Any) -> float:
    """Return the value of white in the pixels; 1 for real numbers."""
    if dataset.colorinterp[0].name == "palette":
        return 255.0
    if not dataset.dtypes[0].startswith(("uint", "int")):
        return 1.0
    bits = dataset.tags(1, ns="IMAGE_STRUCTURE").get("NBITS")
    return 2.0 ** int(bits) - 1 if bits else float(np.iinfo(dataset.dtypes[0]).max)


def read_las(path: str, _: int) -> Answer:
    """Return the points (n, 3) of a LAS file, which of them are ground, and their system."""
    import laspy

    las = laspy.read(path)
    if len(las.points) != las.header.point_count:
        raise ValueError(f"is cut off: {las.header.point_count} points announced, {len(las.points)} there")
    kind = np.asarray(las.classification)
    kept = ~np.isin(kind, NOISE)
    xyz = np.stack((las.x, las.y, las.z), axis=1).astype(np.float64)
    wkt, keys = "", dict[int, int]()
    for record in (*las.header.vlrs, *(las.header.evlrs or ())):
        if record.record_id == 2112 and getattr(record, "string", None):
            wkt, keys = record.string, {}
            break
        if record.record_id == 34735:
            crs = record.parse_crs()
            wkt = "" if crs is None else crs.to_wkt()
            keys = {key.id: key.value_offset for key in record.geo_keys}
    return {"wkt": wkt, "keys": keys}, [xyz[kept], (kind == GROUND)[kept]]


def read_pcd(path: str, _: int) -> Answer:
    """Return the points (n, 3) of a PCD file."""
    from pypcd4 import PointCloud

    with open(path, "rb") as file:  # noqa: PTH123  few imports
        data = file.read()
    if b"\nCOUNT" not in data[:4096]:  # the format has a default, the library has none
        types = re.search(rb"(?m)^TYPE( +\w)+", data) or [b""]
        data = data.replace(types[0], types[0] + b"\nCOUNT" + b" 1" * len(types[0].split()[1:]), 1)
    loaded = PointCloud.from_fileobj(io.BytesIO(data))
    announced, there = loaded.metadata.points, loaded.pc_data.size
    if announced != there:
        raise ValueError(f"is cut off: {announced} points announced, {there} there")
    missing = [axis for axis in "xyz" if axis not in loaded.fields]
    if missing:
        raise ValueError(
            f"points need x, y and z; missing: {', '.join(missing)}; got: {', '.join(loaded.fields)}"
        )
    return {}, [np.asarray(loaded.numpy(("x", "y", "z")), np.float64).reshape(-1, 3)]


READERS: dict[str, Callable[[str, int], Answer]] = {"raster": read_raster, "las": read_las, "pcd": read_pcd}


def main(kind: str, path: str, max_pixels: str, memory: str, seconds: str) -> None:
    """Answer with a file's content, or with the text of an error."""
    with os.fdopen(os.dup(1), "wb") as out:
        # Output that a library prints must not mix with the answer.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        _limit(int(memory), int(seconds))
        values: dict[str, Any] = {}
        arrays: list[NDArray[Any]] = []
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                values, arrays = READERS[kind](path, int(max_pixels))
        except MemoryError:
            values = {"error": f"needs more than {int(memory) >> 20} MiB of memory"}
        except BaseException as error:  # a reader in Rust panics with an exception that is none of Python's
            values = {"error": CODECS.sub("", reason_of(error.__cause__ or error))}
        arrays = [np.ascontiguousarray(array) for array in arrays]
        values["arrays"] = [(array.dtype.str, array.shape) for array in arrays]
        out.write(json.dumps(values).encode() + b"\n")
        for array in arrays:
            out.write(array.data)


def _limit(memory: int, seconds: int) -> None:
    if sys.platform == "win32":
        return  # only the time limit of the caller applies
    import resource

    # Not the address space: allocators and threads reserve much that they never use.
    limits = {resource.RLIMIT_DATA: memory, resource.RLIMIT_CPU: seconds, resource.RLIMIT_CORE: 0}
    for kind, most in limits.items():
        with suppress(ValueError):  # the hard limit is lower
            resource.setrlimit(kind, (most, resource.getrlimit(kind)[1]))


if __name__ == "__main__":
    main(*sys.argv[1:])
