"""Picture files: safe decoding, and encoding of 8-bit pictures."""

from __future__ import annotations

import mmap
import os
import re
import struct
import tempfile
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lirs_wct.arrays import ByteArray
from lirs_wct.errors import OutputError, SourceError, TooLargeError
from lirs_wct.files import atomic_write
from lirs_wct.formats.images import tiff
from lirs_wct.formats.images.gdal import DRIVERS, read_gdal
from lirs_wct.formats.images.header import MAX_PIXELS, check_complete, read_header

_AS_STORED = cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH
"""Gray stays gray, depth is kept, palettes are resolved, EXIF orientation is applied, alpha is dropped."""
_LOG_LEVEL = threading.Lock()
STDERR = 2
"""File descriptor that C libraries write to."""
_BY = re.compile(r"^lib(?:png|jpeg) (?:warning|error): ")
_LOST = re.compile(r"(?!.*extraneous bytes)(?:Corrupt JPEG data|Premature end)")
"""Notes that mean missing pixels; skipped bytes between two markers are harmless."""


@dataclass(frozen=True, slots=True)
class DecodedPicture:
    """A decoded picture with its orientation applied.

    Attributes:
        pixels: (rows, cols) gray or (rows, cols, 3 or 4) BGR(A), in the file's data type.
        tags: a TIFF's tags, else empty.
    """

    pixels: NDArray[Any]
    tags: tiff.Tags


def read_picture(path: Path, max_pixels: int = MAX_PIXELS, *, alpha: bool = False) -> DecodedPicture:
    """Decode the first page of a picture file; warn of more pages or bands.

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
    pixels, notes = _decode(
        np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED if alpha else _AS_STORED
    )
    if header.tags and (pixels is None or header.masked or not _has_declared_type(pixels, header.tags)):
        # GDAL supports masks and more compressions.
        pixels = read_gdal(path, DRIVERS[".tif"], header.width * header.height).pixels
    if pixels is None:
        said = f" ({notes[-1]})" if notes else ""
        raise SourceError(f"{path}: is damaged or uses a feature that cannot be decoded{said}")
    for note in notes:
        if _LOST.match(note):
            raise SourceError(f"{path}: is damaged: {note}")
        warnings.warn(f"{path}: its decoder notes: {note}", stacklevel=3)
    if header.pages > 1:
        warnings.warn(f"{path}: has {header.pages} pages, the first is taken", stacklevel=3)
    bands = int(header.tags[tiff.SAMPLES][0]) if tiff.SAMPLES in header.tags else 1
    if bands > 2 and pixels.ndim == 2:
        warnings.warn(f"{path}: has {bands} bands, the first is taken", stacklevel=3)
    return DecodedPicture(pixels, header.tags)


def _has_declared_type(pixels: NDArray[Any], tags: tiff.Tags) -> bool:
    """Whether pixels have the declared type of a TIFF; some OpenCV versions misread 32 bits."""
    bits, form = (
        int((tiff.floats(tags, tag) or (other,))[0]) for tag, other in ((tiff.BITS, 1), (tiff.FORMAT, 1))
    )
    if bits <= 16:
        return True
    kind = {1: "u", 2: "i", 3: "f"}.get(form)
    return kind == pixels.dtype.kind and bits == 8 * pixels.dtype.itemsize


def _map_file(path: Path) -> mmap.mmap:
    try:
        with path.open("rb") as file:
            return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    except ValueError as error:
        raise SourceError(f"{path}: is empty") from error
    except OSError as error:
        raise SourceError(f"{path}: cannot be read: {error.strerror or error}") from error


def check_size(path: Path, w: int, h: int, max_pixels: int) -> None:
    """Check the size of a picture; raise SourceError outside the limits."""
    if w < 2 or h < 2:
        raise SourceError(f"{path}: image is {w}x{h} px, a terrain needs at least 2x2")
    if w * h > max_pixels:
        size = f"{path}: image is {w}x{h} px = {w * h} pixels"
        raise TooLargeError(size, w * h, f"at most {max_pixels} are allowed")


def _decode(data: ByteArray, flags: int) -> tuple[NDArray[Any] | None, list[str]]:
    """Return the pixels (None on failure) and the distinct notes of the decoder."""
    pixels: NDArray[Any] | None = None
    with _quiet_codecs() as output:
        with suppress(cv2.error):
            pixels = cv2.imdecode(data, flags)
        output.seek(0)
        lines = output.read().decode(errors="replace").splitlines()
    notes = dict.fromkeys(_BY.sub("", line).strip() for line in lines if line.strip())
    return pixels, list(notes)


@contextmanager
def _quiet_codecs() -> Iterator[IO[bytes]]:
    """Redirect stderr of codecs to a temporary file, and yield that file.

    libjpeg and libpng write to the file descriptor; OpenCV also has a log.
    """
    log = cv2.utils.logging
    with _LOG_LEVEL, tempfile.TemporaryFile() as output:
        before = log.getLogLevel()
        log.setLogLevel(log.LOG_LEVEL_SILENT)
        kept = os.dup(STDERR)
        os.dup2(output.fileno(), STDERR)
        try:
            yield output
        finally:
            os.dup2(kept, STDERR)
            os.close(kept)
            log.setLogLevel(before)


def write_image(path: Path, pixels: ByteArray) -> None:
    """Write an 8-bit picture, gray or BGR; create missing parent folders.

    OpenCV encodes and Python writes, since `cv2.imwrite` reports no reason when it cannot write.

    Raises:
        OutputError: the file cannot be written, or OpenCV cannot encode such a picture by this suffix.
    """
    try:
        done, data = cv2.imencode(path.suffix, pixels)
    except cv2.error as error:
        raise OutputError(f"{path}: cannot be encoded: {error.err or error}") from error
    if not done:
        raise OutputError(f"{path}: a {pixels.dtype} picture of shape {pixels.shape} cannot be encoded")
    with atomic_write(path) as temporary:
        temporary.write_bytes(data.data)
