"""The library that ROS bags need, which only the extra `[ros]` installs, and how bags may be stored."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Literal, get_args

from lirs_wct.errors import SourceError

Storage = Literal["mcap", "sqlite3"]
STORAGES: tuple[Storage, ...] = get_args(Storage)
"""How the messages of a bag are stored."""
METADATA = "metadata.yaml"
"""What `ros2 bag` reads first in a bag's folder."""
FILES: dict[Storage, str] = {"mcap": ".mcap", "sqlite3": ".db3"}
"""Suffix of a bag's file."""


def require_rosbags(path: Path | str) -> None:
    """Check that bags can be read and written.

    Raises:
        SourceError: rosbags is not installed.
    """
    if find_spec("rosbags") is None:
        raise SourceError(f"{path}: a ROS bag needs the package rosbags: pip install 'lirs-wct[ros]'")
