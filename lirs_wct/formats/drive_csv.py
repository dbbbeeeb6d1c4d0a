"""CSV files of a drive: velocity commands, and gzipped inertial readings.

Commands begin with the start pose; their numbers are not rounded.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lirs_wct.arrays import FloatArray
from lirs_wct.errors import SourceError
from lirs_wct.files import atomic_write, read_gzipped, write_gzipped
from lirs_wct.geometry import Imu, Pose2

COMMANDS_HEADER = "time,v,omega"
"""Time of the command since the start, seconds; m/s; rad/s."""
START = "# start"
"""Begins the line with the start pose: x, y, yaw in the world frame, meters and radians."""
IMU_HEADER = "stamp,roll,pitch,rate_x,rate_y,rate_z,acceleration_x,acceleration_y,acceleration_z"
"""Seconds; radians, REP 103; rad/s; m/s^2 with +9.81 on z at rest; all of base_link."""
IMU_COLUMNS = len(IMU_HEADER.split(","))


@dataclass(frozen=True)
class Commands:
    """The velocity commands of a drive.

    Attributes:
        start: start pose of the robot, world frame.
        rows: (n, 3) time in seconds, speed in m/s, turn rate in rad/s.
    """

    start: Pose2
    rows: FloatArray


def write_commands(path: Path, commands: Commands) -> None:
    """Write commands; numbers read back exactly.

    Raises:
        OutputError: the file cannot be written.
    """
    lines = [f"{START} {' '.join(map(repr, commands.start.as_array().tolist()))}", COMMANDS_HEADER]
    lines += [",".join(map(repr, row)) for row in commands.rows.tolist()]
    with atomic_write(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")


def read_commands(path: Path) -> Commands:
    """Read commands.

    Raises:
        SourceError: missing or damaged, or not three finite numbers per line.
    """
    try:
        first, header, *lines = path.read_text(encoding="utf-8").splitlines()
        start = [float(word) for word in first.removeprefix(START).split()]
        rows = np.array([[float(word) for word in line.split(",")] for line in lines], dtype=np.float64)
    except OSError as error:
        raise SourceError(f"{path}: cannot be read: {error.strerror or error}") from error
    except ValueError as error:
        raise SourceError(f"{path}: not the commands of a drive: {error}") from error
    legal = first.startswith(START) and header == COMMANDS_HEADER and rows.ndim == 2 and rows.shape[1] == 3
    if not legal or len(start) != 3 or not (np.isfinite(rows).all() and np.isfinite(start).all()):
        raise SourceError(
            f"{path}: the commands of a drive are a line '{START} X Y YAW', a line '{COMMANDS_HEADER}' and "
            "three finite numbers a line"
        )
    return Commands(Pose2(*start), rows)


def write_imu(path: Path, readings: Iterable[Imu]) -> None:
    """Write inertial readings, gzipped; the same data give the same bytes.

    Raises:
        OutputError: the file cannot be written.
    """
    rows = np.fromiter((reading.row for reading in readings), np.dtype((np.float64, IMU_COLUMNS)))
    with write_gzipped(path) as zipped:
        np.savetxt(zipped, rows, fmt="%.9g", delimiter=",", header=IMU_HEADER, comments="")


def read_imu(path: Path) -> tuple[Imu, ...]:
    """Read inertial readings, gzipped or not.

    Raises:
        SourceError: missing, damaged, or not as many numbers a line as the header has names.
    """
    data = read_gzipped(path)
    try:
        lines = data.decode().splitlines()
        rows = [[float(word) for word in line.split(",")] for line in lines[1:]]
    except ValueError as error:
        raise SourceError(f"{path}: not inertial readings: {error}") from error
    if lines[:1] != [IMU_HEADER] or any(len(row) != IMU_COLUMNS for row in rows):
        raise SourceError(f"{path}: inertial readings have {IMU_COLUMNS} numbers a line ({IMU_HEADER})")
    wrong = next((k for k, row in enumerate(rows, start=2) if not np.isfinite(row).all()), None)
    if wrong is not None:
        raise SourceError(f"{path}: line {wrong}: inertial readings must be finite numbers")
    return tuple(Imu.from_row(*row) for row in rows)
