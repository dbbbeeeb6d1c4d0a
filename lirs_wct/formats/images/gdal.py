"""Rasters that only GDAL reads, through rasterio."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from lirs_wct.errors import SourceError
from lirs_wct.formats.limited import run_limited
from lirs_wct.formats.references import referenced_file

DRIVERS = {
    ".tif": ("GTiff",),
    ".tiff": ("GTiff",),
    ".asc": ("AAIGrid",),
    ".hgt": ("SRTMHGT",),
    ".dt0": ("DTED",),
    ".dt1": ("DTED",),
    ".dt2": ("DTED",),
    ".img": ("HFA", "ENVI"),
    ".vrt": ("VRT",),
    ".bil": ("EHdr", "ENVI"),
    ".flt": ("EHdr",),
    ".dem": ("USGSDEM", "EHdr"),
    ".adf": ("AIG",),
    ".nc": ("netCDF",),
    ".jp2": ("JP2OpenJPEG",),
    ".png": ("PNG",),
    ".jpg": ("JPEG",),
}
"""Drivers by suffix; the sources of a VRT may use all of them."""
PIXEL_BYTES = 20
"""Memory per pixel, bytes: two 64-bit numbers and a mask."""


@dataclass(frozen=True)
class GdalRaster:
    """The first band of a raster and its metadata from GDAL.

    Attributes:
        width: columns of pixels.
        height: rows of pixels.
        pixels: (rows, cols), NaN where masked without a nodata value; None if there are too many pixels.
        nodata: value of pixels without a height, or None.
        scale: factor of the pixels.
        offset: added to the scaled pixels.
        unit: name of the heights' unit, or empty.
        transform: of the pixels' corners, the six numbers in rasterio's order; None where it is not known.
        wkt: coordinate system as WKT; empty where it is not known.
    """

    width: int
    height: int
    pixels: NDArray[Any] | None
    nodata: float | None
    scale: float
    offset: float
    unit: str
    transform: tuple[float, float, float, float, float, float] | None
    wkt: str


def read_gdal(path: Path, drivers: tuple[str, ...], max_pixels: int) -> GdalRaster:
    """Read a raster in a process restricted to its drivers and its folder.

    Args:
        path: file.
        drivers: names of the allowed drivers.
        max_pixels: a larger raster is described without its pixels.

    Raises:
        SourceError: GDAL cannot read the file, or the file refers to another folder.
    """
    import rasterio  # imported here to keep the start of other commands fast

    if not path.is_file():
        raise SourceError(f"{path}: no such file")
    real = path.resolve()
    try:
        files = followed_files(real)
    except SourceError as error:
        raise SourceError(str(error).replace(str(real), str(path), 1)) from error
    known = set(drivers) | (set().union(*DRIVERS.values()) if "VRT" in drivers else set())
    with rasterio.Env() as library:
        # Drivers can be excluded only at the library's start; some would access a network.
        skipped = ",".join(set(library.drivers()) - known)
    return run_limited(
        path,
        _read,
        path,
        drivers,
        max_pixels,
        size=sum(file.stat().st_size for file in files - {real}),
        memory=PIXEL_BYTES * max_pixels,
        environment={
            "GDAL_SKIP": skipped,
            "CPL_VSIL_CURL_ALLOWED_FILENAME": "none",
            "GDAL_VRT_ENABLE_PYTHON": "NO",
            "GDAL_CACHEMAX": "64",
            "PROJ_NETWORK": "OFF",
        },
    )


def _read(path: Path, drivers: tuple[str, ...], max_pixels: int) -> GdalRaster:
    import rasterio
    from rasterio.errors import RasterioError

    real = path.resolve()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            # With several drivers, the environment restricts the library to them.
            dataset = rasterio.open(real, driver=drivers[0] if len(drivers) == 1 else None)
        with dataset:
            for name in dataset.files:
                # A grid of ArcInfo is a folder, which has tables beside it.
                referenced_file(real.parent if "AIG" in drivers else real, str(Path(name).absolute()))
            small = dataset.width * dataset.height <= max_pixels
            return GdalRaster(
                dataset.width,
                dataset.height,
                _band(dataset) if small else None,
                dataset.nodata,
                dataset.scales[0],
                dataset.offsets[0],
                dataset.units[0] or "",
                None if dataset.transform.is_identity else tuple(dataset.transform)[:6],
                dataset.crs.to_wkt() if dataset.crs else "",
            )
    except RasterioError as error:
        raise SourceError(f"{path}: cannot be read by GDAL: {str(error).splitlines()[0]}") from error


def _band(dataset: Any) -> NDArray[Any]:
    """Return the first band; masked pixels are NaN unless a nodata value marks them."""
    band: NDArray[Any] = dataset.read(1)
    if "per_dataset" in {flag.name for flag in dataset.mask_flag_enums[0]}:
        missing = dataset.read_masks(1) == 0
        if missing.any():
            band = np.where(missing, np.nan, band.astype(np.float64))
    return band


SIDECARS = (".aux.xml", ".ovr", ".msk")
_NAMING = ("file", "dataset", "path", "dem", "url")
"""Parts of names of elements, attributes and options whose values are files."""
_FOLLOWED = ("overviews", "geolocation")
"""Domains of metadata whose values GDAL opens."""
_HEAD = 1 << 16


def followed_files(path: Path) -> set[Path]:
    """Return the files that GDAL may read with a raster, including the raster.

    Raises:
        SourceError: a file names one that is not in its folder, or is a damaged VRT.
    """
    found, unseen = {path}, [path]
    while unseen:
        at = unseen.pop()
        sidecars = (at.name + suffix for suffix in SIDECARS)
        for name in (*_references(at), *(name for name in sidecars if at.with_name(name).exists())):
            each = referenced_file(at, name)
            if each not in found and each.is_file():
                found.add(each)
                unseen.append(each)
    return found


def _references(path: Path) -> Iterator[str]:
    """Yield the file names in a VRT or a sidecar's XML.

    The content counts, not the suffix: GDAL treats any source that begins like a VRT as a VRT.
    """
    with path.open("rb") as file:
        head = file.read(_HEAD)
    if not (vrt := b"<vrtdataset" in head.lower()) and not path.name.lower().endswith(".aux.xml"):
        return
    text = path.read_bytes()
    if b"<!DOCTYPE" in text or b"<!ENTITY" in text:
        raise SourceError(f"{path}: has a document type, which no VRT needs")
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, LookupError, RecursionError) as error:
        raise SourceError(f"{path}: is damaged XML: {error}") from error
    for element in root.iter():
        yield from _followed_metadata(element)
        for name, value in _named_values(element) if vrt else ():
            if any(word in name.lower() for word in _NAMING) and value.strip():
                yield value.strip()
                # GDAL resolves such a name in the working directory.
                if (element.get("relativeToVRT") or "0").strip() != "1":
                    yield str(Path.cwd() / value.strip())


def _named_values(element: ElementTree.Element) -> Iterator[tuple[str, str]]:
    """Yield the names and values of an element and its attributes, like GDAL."""
    tag = element.tag.rpartition("}")[2]
    if tag.lower() != "mdi":
        option = element.get("name") or element.get("key") or ""
        yield f"{tag} {option}", element.text or ""
        yield from element.attrib.items()


def _followed_metadata(element: ElementTree.Element) -> Iterator[str]:
    if (element.get("domain") or "").lower() in _FOLLOWED:
        yield from (
            entry.text.strip().removeprefix(":::BASE:::")
            for entry in element
            if "file" in (entry.get("key") or "").lower() or "dataset" in (entry.get("key") or "").lower()
            if entry.text
        )
