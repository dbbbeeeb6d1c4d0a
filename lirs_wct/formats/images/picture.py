"""Decoding a picture file into an array, safely: size checked first, damage refused, the codecs quiet."""

from __future__ import annotations

import mmap
import struct
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lirs_wct.arrays import ByteArray
from lirs_wct.errors import SourceError
from lirs_wct.formats.images import tiff
from lirs_wct.formats.images.gdal import EXTRA, opened, rasterio_there, read_band
from lirs_wct.formats.images.header import MAX_PIXELS, PictureHeader, check_complete, read_header

_AS_STORED = cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH
"""Gray stays gray, depth is kept, palettes are resolved, EXIF orientation is applied, alpha is dropped."""
_LOG_LEVEL = threading.Lock()


@dataclass(frozen=True, slots=True)
class Picture:
    """A decoded picture, orientation applied.

    Attributes:
        pixels: (rows, cols) gray or (rows, cols, 3 or 4) BGR(A), in the file's own type.
        tags: a TIFF's tags, else empty.
    """

    pixels: NDArray[Any]
    tags: tiff.Tags


def read_picture(path: Path, max_pixels: int = MAX_PIXELS, *, alpha: bool = False) -> Picture:
    """Decode the first page of a picture file; warns when there are more pages or bands.

    With `alpha` a transparent picture keeps its fourth channel, and EXIF orientation is not applied.

    Raises:
        SourceError: the file is missing, damaged, not a picture, smaller than 2x2 or larger than
            `max_pixels`.
    """
    data = _map_file(path)
    try:
        header = read_header(data)
        check_size(path, header.width, header.height, max_pixels)
        check_complete(data)
    except struct.error as error:
        raise SourceError(f"{path}: is truncated: the file ends inside its header") from error
    except ValueError as error:
        raise SourceError(f"{path}: {error}") from error
    pixels = _decode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED if alpha else _AS_STORED)
    if header.tags and (pixels is None or header.masked or not _typed(pixels, header.tags)):
        pixels = _by_gdal(path, pixels, header)
    if pixels is None:
        raise SourceError(f"{path}: is damaged or uses a feature that cannot be decoded")
    if header.pages > 1:
        warnings.warn(f"{path}: has {header.pages} pages, the first is taken", stacklevel=3)
    bands = int(header.tags[tiff.SAMPLES][0]) if tiff.SAMPLES in header.tags else 1
    if bands > 2 and pixels.ndim == 2:
        warnings.warn(f"{path}: has {bands} bands, the first is taken", stacklevel=3)
    return Picture(pixels, header.tags)


def _typed(pixels: NDArray[Any], tags: tiff.Tags) -> bool:
    """Whether pixels have the type that a TIFF says; some versions of OpenCV take 32 bits for others."""
    bits, form = (
        int((tiff.floats(tags, tag) or (other,))[0]) for tag, other in ((tiff.BITS, 1), (tiff.FORMAT, 1))
    )
    if bits <= 16:
        return True
    kind = {1: "u", 2: "i", 3: "f"}.get(form)
    return kind == pixels.dtype.kind and bits == 8 * pixels.dtype.itemsize


def _by_gdal(path: Path, pixels: NDArray[Any] | None, header: PictureHeader) -> NDArray[Any] | None:
    """Return the first band of a TIFF as GDAL reads it, which knows masks and more compressions.

    Raises:
        SourceError: rasterio is not there and the file holds what only it reads.
    """
    if rasterio_there():
        with opened(path) as dataset:
            return read_band(dataset)
    if header.masked and pixels is not None:
        warnings.warn(f"{path}: its mask is not read, {EXTRA} reads it", stacklevel=4)
        return pixels
    code = int((tiff.floats(header.tags, tiff.COMPRESSION) or (1,))[0])
    if code in tiff.COMPRESSIONS:
        raise SourceError(
            f"{path}: is compressed by {tiff.COMPRESSIONS[code]}, which needs rasterio: {EXTRA}"
        )
    raise SourceError(f"{path}: is damaged or uses a feature that OpenCV does not decode; GDAL may: {EXTRA}")


def _map_file(path: Path) -> mmap.mmap:
    try:
        with path.open("rb") as file:
            return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    except ValueError as error:
        raise SourceError(f"{path}: is empty") from error
    except OSError as error:
        raise SourceError(f"{path}: cannot be read: {error.strerror or error}") from error


def check_size(path: Path, w: int, h: int, max_pixels: int) -> None:
    """Raise SourceError unless a picture of w x h pixels is neither too small nor too large."""
    if w < 2 or h < 2:
        raise SourceError(f"{path}: image is {w}x{h} px, a terrain needs at least 2x2")
    if w * h > max_pixels:
        raise SourceError(f"{path}: image is {w}x{h} px = {w * h} pixels, at most {max_pixels} are allowed "
                          "(--max-pixels)")  # fmt: skip


def _decode(data: ByteArray, flags: int) -> NDArray[Any] | None:
    with _quiet_codecs():
        try:
            pixels: NDArray[Any] | None = cv2.imdecode(data, flags)
        except cv2.error:
            return None
    return pixels


@contextmanager
def _quiet_codecs() -> Iterator[None]:
    """Keep OpenCV's log off stderr: unknown TIFF tags and broken files are reported by us, once."""
    log = cv2.utils.logging
    with _LOG_LEVEL:
        before = log.getLogLevel()
        log.setLogLevel(log.LOG_LEVEL_SILENT)
        try:
            yield
        finally:
            log.setLogLevel(before)
