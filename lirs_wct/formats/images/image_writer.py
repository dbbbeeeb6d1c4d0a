"""Pictures to files, by the suffix; a disk that is full says so."""

from __future__ import annotations

from pathlib import Path

import cv2

from lirs_wct.arrays import ByteArray
from lirs_wct.errors import OutputError
from lirs_wct.files import atomic_write


def write_image(path: Path, pixels: ByteArray) -> None:
    """Write an 8-bit picture, gray or BGR; missing parent folders are made.

    OpenCV encodes and Python writes: `cv2.imwrite` returns False where it cannot write, and raises nothing.

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
