"""Inertial readings as gzipped CSV, one reading per line."""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from lirs_wct.errors import SourceError
from lirs_wct.files import atomic_write
from lirs_wct.geometry.scan import Imu

HEADER = "stamp,roll,pitch,rate_x,rate_y,rate_z,acceleration_x,acceleration_y,acceleration_z"
"""Seconds; radians, REP 103; rad/s; m/s^2 with +9.81 on z at rest; all of base_link."""
COLUMNS = len(HEADER.split(","))


def write_imu(path: Path, readings: Iterable[Imu]) -> None:
    """Write readings; the same data give the same bytes.

    Raises:
        OutputError: the file cannot be written.
    """
    rows = np.fromiter((reading.row for reading in readings), np.dtype((np.float64, COLUMNS)))
    with (
        atomic_write(path) as temporary,
        temporary.open("wb") as raw,
        gzip.GzipFile("", "wb", 1, raw, mtime=0) as zipped,
    ):
        np.savetxt(zipped, rows, fmt="%.9g", delimiter=",", header=HEADER, comments="")


def read_imu(path: Path) -> tuple[Imu, ...]:
    """Read readings.

    Raises:
        SourceError: missing, damaged, or not as many numbers a line as the header has names.
    """
    try:
        lines = gzip.decompress(path.read_bytes()).decode().splitlines()
        rows = [[float(word) for word in line.split(",")] for line in lines[1:]]
    except OSError as error:
        raise SourceError(f"{path}: cannot be read: {error.strerror or error}") from error
    except (EOFError, zlib.error, ValueError) as error:
        raise SourceError(f"{path}: not inertial readings: {error}") from error
    if lines[:1] != [HEADER] or any(len(row) != COLUMNS for row in rows):
        raise SourceError(f"{path}: inertial readings have {COLUMNS} numbers a line ({HEADER})")
    wrong = next((k for k, row in enumerate(rows, start=2) if not np.isfinite(row).all()), None)
    if wrong is not None:
        raise SourceError(f"{path}: line {wrong}: inertial readings must be finite numbers")
    return tuple(Imu.from_row(*row) for row in rows)
