"""Files that compiled libraries read: in a process with limits of time and memory."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from threading import Timer
from time import monotonic
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lirs_wct.errors import SourceError
from lirs_wct.files import first_bytes

SECONDS, SECONDS_PER_BYTE, WAIT = 5.0, 4e-6, 4
"""Limit of CPU seconds in all threads: a constant, and per byte. The wall time may be WAIT times that."""
MEMORY, MEMORY_PER_BYTE = 512 << 20, 200
"""Memory limit of a file in bytes; a LAZ file unpacks to some ten times its size, seldom to fifty times."""
PIXEL_BYTES = 20
"""Memory per pixel, bytes: two 64-bit numbers and a mask."""
THREADS = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "RAYON_NUM_THREADS": "4"}
"""Each thread's stack counts as memory."""
PROGRAM = Path(__file__).with_name("reader_process.py")


def read_limited(
    kind: Literal["raster", "las", "pcd"], path: Path, max_pixels: int = 0
) -> tuple[dict[str, Any], list[NDArray[Any]]]:
    """Return what the process reads: values by name, and arrays.

    The size of the file scales the limits. A raster of more than `max_pixels` is described without them.
    """
    size = path.stat().st_size
    seconds = round(SECONDS + SECONDS_PER_BYTE * size)
    memory = MEMORY + MEMORY_PER_BYTE * size + PIXEL_BYTES * max_pixels
    process = subprocess.Popen(
        [sys.executable, str(PROGRAM), kind]
        + [str(value) for value in (path.resolve(), max_pixels, memory, seconds)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env={**os.environ, **THREADS, "PYTHONSAFEPATH": "1", "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    timer, began = Timer(WAIT * seconds, process.kill), monotonic()
    timer.start()
    try:
        answer = _receive(process)
    finally:
        timer.cancel()
        process.kill()
    if answer is None:
        code = process.returncode
        ending = f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
        late = monotonic() - began >= WAIT * seconds or ending.endswith("SIGXCPU")
        reason = f"takes more than {seconds} s" if late else ending
        raise SourceError(f"{path}: cannot be read: its reader {reason}")
    values, arrays = answer
    if "error" in values:
        raise SourceError(f"{path}: {values['error'].replace(str(path.resolve()), path.name)}")
    return values, arrays


def _receive(process: subprocess.Popen[bytes]) -> tuple[dict[str, Any], list[NDArray[Any]]] | None:
    """Return the answer of a process; None where it ended without one."""
    assert process.stdout is not None
    arrays: list[NDArray[Any]] = []
    with process, process.stdout as pipe:
        line = pipe.readline()
        if not line.endswith(b"\n"):
            return None
        values: dict[str, Any] = json.loads(line)
        for kind, shape in values.pop("arrays"):
            array: NDArray[Any] = np.empty(shape, kind)
            if pipe.readinto(array.reshape(-1).view(np.uint8).data) != array.nbytes:  # type: ignore[attr-defined]
                return None
            arrays.append(array)
    return values, arrays


REFERRING = b"<VRTDataset"
"""Mark of a VRT, which only refers to other files."""
NEEDS_GDAL = "is neither PNG, PGM/PNM, GIF, JPEG, BMP, WebP nor an ESRI ASCII grid; TIFF and other elevation \
models need the package rasterio: pip install 'lirs-wct[dem]'"


@dataclass(frozen=True)
class GdalRaster:
    """Pixels of a raster and its metadata from GDAL.

    Attributes:
        bands: Number of bands without alpha.
        scale: height = scale value + offset.
        transform: Affine of the pixels' corners in rasterio's order.
        pixels: (rows, cols) First band, NaN where a mask hides it, or (rows, cols, 3 or 4) BGR(A) of colors;
            None if there are too many pixels.
    """

    width: int
    height: int
    bands: int
    white: float
    pages: int
    nodata: float | None
    scale: float
    offset: float
    unit: str
    transform: tuple[float, float, float, float, float, float] | None
    wkt: str
    pixels: NDArray[Any] | None


def read_gdal(path: Path, max_pixels: int) -> GdalRaster:
    """Read a raster; one of more than `max_pixels` is described without its pixels."""
    if REFERRING in first_bytes(path, 1024):
        raise SourceError(f"{path}: is a VRT, which refers to other files: gdal_translate makes a TIFF of it")
    if find_spec("rasterio") is None:
        raise SourceError(f"{path}: {NEEDS_GDAL}")
    values, arrays = read_limited("raster", path, max_pixels)
    values["transform"] = values["transform"] and tuple(values["transform"])
    return GdalRaster(**values, pixels=arrays[0] if arrays else None)
