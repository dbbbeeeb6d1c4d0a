"""Check for the library of ROS bags (extra `[ros]`), and storage formats of bags."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Literal, get_args

from lirs_wct.errors import SourceError

Storage = Literal["mcap", "sqlite3"]
STORAGES: tuple[Storage, ...] = get_args(Storage)
"""Storage formats of a bag's messages."""
METADATA = "metadata.yaml"
"""File of a bag's folder that `ros2 bag` reads first."""
FILES: dict[Storage, str] = {"mcap": ".mcap", "sqlite3": ".db3"}
"""Suffix of a bag's file by storage format."""


def require_rosbags(path: Path | str) -> None:
    """Check that bags can be read and written.

    Raises:
        SourceError: rosbags is not installed.
    """
    if find_spec("rosbags") is None:
        raise SourceError(f"{path}: a ROS bag needs the package rosbags: pip install 'lirs-wct[ros]'")
