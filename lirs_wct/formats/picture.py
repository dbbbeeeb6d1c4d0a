"""Picture files: decoding by Pillow, and encoding of 8-bit pictures."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageFile, ImageOps, UnidentifiedImageError

from lirs_wct.arrays import ByteArray
from lirs_wct.errors import OutputError, SourceError, reason_of
from lirs_wct.files import atomic_write, first_bytes
from lirs_wct.formats.limited import GdalRaster, read_gdal

MAX_PIXELS = 5000 * 5000
"""Larger pictures are refused unless the caller allows them."""
BYTES = 220
"""Memory per pixel of rough terrain, bytes, by `benchmarks/world.py --only large`."""
FORMATS = ("PNG", "PPM", "GIF", "JPEG", "BMP", "WEBP")
"""Formats of Pillow that are read; GDAL reads TIFF."""
LEGAL = "PNG, PGM/PNM, GIF, JPEG, TIFF, BMP, WebP"
TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
"""The first bytes of TIFF and BigTIFF files."""


@dataclass(frozen=True, slots=True)
class DecodedPicture:
    """A decoded picture, and its value of white; that of a PNM is its maximum.

    Pixels are (rows, cols) gray or (rows, cols, 3 or 4) BGR(A), in the file's data type.
    """

    pixels: NDArray[Any]
    full: float


def read_picture(path: Path, max_pixels: int = MAX_PIXELS, *, alpha: bool = False) -> DecodedPicture:
    """Decode the first page of a picture file; warn of all that is left out.

    With `alpha` a transparent picture keeps its fourth channel, and EXIF orientation is not applied.
    """
    full: float | None
    if first_bytes(path).startswith(TIFF) or _is_huge(path):
        raster = read_gdal(path, max_pixels)
        check_size(path, raster.width, raster.height, max_pixels)
        pixels, full = pixels_of(path, raster), raster.white
    else:
        with _open_picture(path) as picture:
            check_size(path, *picture.size, max_pixels)
            if picture.format == "PNG":
                with Image.open(path, formats=FORMATS) as again:  # a verified picture cannot be decoded
                    again.verify()  # checksums, which decoding leaves out
            if picture.format in ("JPEG", "MPO"):
                read_gdal(path, picture.width * picture.height)  # Pillow fills in missing pixels
            pages = getattr(picture, "n_frames", 1)
            pixels, full = _decode(path, picture, oriented=not alpha)
        if pages > 1:
            warnings.warn(f"{path}: has {pages} pages, the first is taken", stacklevel=3)
    return DecodedPicture(pixels if alpha else without_alpha(path, pixels), full or _white(pixels))


def _is_huge(path: Path) -> bool:
    """Whether a picture is larger than any that Pillow opens."""
    try:
        with _open_picture(path):
            return False
    except Image.DecompressionBombError:
        return True


@contextmanager
def _open_picture(path: Path) -> Iterator[ImageFile.ImageFile]:
    """Open a picture by its header; faults of decoding become one line."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with Image.open(path, formats=FORMATS) as picture:
                yield picture
    except (SourceError, Image.DecompressionBombError):
        raise
    except UnidentifiedImageError as error:
        raise SourceError(f"{path}: is damaged, or not a picture; legal: {LEGAL}") from error
    except Exception as error:  # each decoder raises different errors
        raise SourceError(f"{path}: is damaged: {reason_of(error)}") from error


def _decode(path: Path, picture: ImageFile.ImageFile, *, oriented: bool) -> tuple[NDArray[Any], float | None]:
    """Return pixels, and the value of white where the type does not tell it."""
    codec, _, offset, arguments = picture.tile[0] if picture.tile else ("", None, 0, None)
    bands, shape = len(picture.getbands()), (picture.height, picture.width)
    clear = picture.info.get("transparency")
    if picture.format == "PNG" and bands > 1 and ";16" in str(arguments):  # Pillow would keep 8 bits
        raster = read_gdal(path, picture.width * picture.height)
        assert raster.pixels is not None
        return _with_alpha(raster.pixels, clear), raster.white
    if codec not in ("ppm", "ppm_plain") or not isinstance(arguments, tuple):
        pixels = _to_array(ImageOps.exif_transpose(picture) if oriented else picture)
        return _with_alpha(pixels, clear if picture.mode.startswith("I") else None), None
    maximum = arguments[-1]
    kind = np.dtype(np.uint8 if maximum < 256 else np.uint16)
    if codec == "ppm":
        values = np.fromfile(path, kind.newbyteorder(">"), math.prod(shape) * bands, offset=offset)
        return values.astype(kind).reshape(*shape, bands)[..., ::-1].squeeze(), maximum
    scaled = 65535 if picture.mode == "I" else 255  # by Pillow, which keeps 8 bits of colors
    return np.rint(_to_array(picture) * (maximum / scaled)).astype(kind), maximum


def _with_alpha(pixels: NDArray[Any], clear: int | tuple[int, ...] | None) -> NDArray[Any]:
    """Return BGRA pixels in which one color is clear, or the same pixels without one."""
    if clear is None:
        return pixels
    colors = pixels if pixels.ndim == 3 else np.dstack([pixels] * 3)
    shown = (colors != np.flip(clear)).any(axis=2)
    return np.dstack([colors, np.where(shown, pixels.dtype.type(_white(pixels)), 0)]).astype(pixels.dtype)


def _to_array(picture: Image.Image) -> NDArray[Any]:
    """Return gray or BGR(A) pixels of a picture in any mode."""
    if picture.mode.startswith(("I", "F")):
        deep = np.asarray(picture)
        return deep if picture.mode == "F" else deep.astype(np.uint16)
    if picture.has_transparency_data:
        return np.asarray(picture.convert("RGBA"))[..., [2, 1, 0, 3]]
    if picture.mode in ("1", "L"):
        return np.asarray(picture.convert("L"))
    return np.asarray(picture.convert("RGB"))[..., ::-1]


def pixels_of(path: Path, raster: GdalRaster) -> NDArray[Any]:
    """Return the pixels of a raster; warn of pages and bands that are left out."""
    assert raster.pixels is not None
    if raster.pages > 1:
        warnings.warn(f"{path}: has {raster.pages} pages, the first is taken", stacklevel=4)
    if raster.bands > 1 and raster.pixels.ndim == 2:
        warnings.warn(f"{path}: has {raster.bands} bands, the first is taken", stacklevel=4)
    return raster.pixels


def without_alpha(path: Path, pixels: NDArray[Any]) -> NDArray[Any]:
    """Return the pixels without their alpha channel; warn of transparent ones."""
    if pixels.ndim == 2 or pixels.shape[2] < 4:
        return pixels
    clear = int((pixels[..., 3] < _white(pixels)).sum())
    if clear:
        warnings.warn(
            f"{path}: {clear} of {pixels[..., 3].size} pixels are transparent; the alpha channel is left out",
            stacklevel=4,
        )
    return np.ascontiguousarray(pixels[..., :3])


def _white(pixels: NDArray[Any]) -> float:
    return float(np.iinfo(pixels.dtype).max) if pixels.dtype.kind in "iu" else 1.0


def check_size(path: Path, w: int, h: int, max_pixels: int) -> None:
    """Check the size of a picture; raise SourceError outside the limits."""
    if w < 2 or h < 2:
        raise SourceError(f"{path}: image is {w}x{h} px, a terrain needs at least 2x2")
    if w * h > max_pixels:
        raise SourceError(
            f"{path}: image is {w}x{h} px = {w * h} pixels, at most {max_pixels} are allowed; "
            f"--option max-pixels={w * h} allows it and takes up to {BYTES * w * h / 1e9:.2g} GB of memory"
        )


def write_image(path: Path, pixels: ByteArray) -> None:
    """Write an 8-bit picture, gray or BGR; OpenCV only encodes, since its writer reports no reason."""
    try:
        done, data = cv2.imencode(path.suffix, pixels)
    except cv2.error as error:
        raise OutputError(f"{path}: cannot be encoded: {error.err or error}") from error
    if not done:
        raise OutputError(f"{path}: a {pixels.dtype} picture of shape {pixels.shape} cannot be encoded")
    with atomic_write(path) as temporary:
        temporary.write_bytes(data.data)
