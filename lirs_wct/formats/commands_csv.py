"""Commands of a drive as CSV.

The start pose comes first, then time, speed and turn rate per line. Numbers are not rounded.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lirs_wct.arrays import FloatArray
from lirs_wct.errors import SourceError
from lirs_wct.files import atomic_write
from lirs_wct.geometry.pose import Pose2

HEADER = "time,v,omega"
"""Time of the command since the start, seconds; m/s; rad/s."""
START = "# start"
"""Begins the line with the start pose: x, y, yaw in the world frame, meters and radians."""


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
    lines = [f"{START} {' '.join(map(repr, commands.start.as_array().tolist()))}", HEADER]
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
    legal = first.startswith(START) and header == HEADER and rows.ndim == 2 and rows.shape[1] == 3
    if not legal or len(start) != 3 or not (np.isfinite(rows).all() and np.isfinite(start).all()):
        raise SourceError(
            f"{path}: the commands of a drive are a line '{START} X Y YAW', a line '{HEADER}' and "
            "three finite numbers a line"
        )
    return Commands(Pose2(*start), rows)
