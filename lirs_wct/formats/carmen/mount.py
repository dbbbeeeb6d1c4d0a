"""The laser's mount in a recorded log: a comment, because the messages have room for a planar one only."""

from __future__ import annotations

import gzip
import zlib
from contextlib import suppress
from itertools import takewhile
from pathlib import Path

from lirs_wct.geometry.pose import Pose3

LABEL = "# laser on base_link, x y z roll pitch yaw:"
"""Meters and radians follow."""


def mount_comment(T_base_laser: Pose3) -> str:
    """Return the line that says where the laser is."""
    x, y, z = T_base_laser.position.tolist()
    angles = f"{T_base_laser.roll:.6f} {T_base_laser.pitch:.6f} {T_base_laser.yaw:.6f}"
    return f"{LABEL} {x:.6f} {y:.6f} {z:.6f} {angles}\n"


def read_mount(path: Path) -> Pose3 | None:
    """Return `T_base_laser` as the comments before the first message say it; None where they do not."""
    with suppress(OSError, EOFError, zlib.error, UnicodeDecodeError, ValueError):
        with path.open("rb") as raw:
            zipped = raw.read(2) == b"\x1f\x8b"
        opened = gzip.open if zipped else open
        with opened(path, "rt", encoding="ascii") as lines:
            for line in takewhile(lambda text: text.startswith("#"), lines):
                if line.startswith(LABEL):
                    x, y, z, roll, pitch, yaw = map(float, line.removeprefix(LABEL).split())
                    return Pose3.from_rpy(x, y, z, roll, pitch, yaw)
    return None
