"""Storage formats of ROS bags."""

from __future__ import annotations

from typing import Literal, get_args

Storage = Literal["mcap", "sqlite3"]
STORAGES: tuple[Storage, ...] = get_args(Storage)
"""Storage formats of a bag's messages."""
METADATA = "metadata.yaml"
"""File of a bag's folder that `ros2 bag` reads first."""
FILES: dict[Storage, str] = {"mcap": ".mcap", "sqlite3": ".db3"}
"""Suffix of a bag's file by storage format."""
