"""The kinds of source."""

from __future__ import annotations

from enum import Enum


class SourceKind(Enum):
    """How a source is read."""

    BUNDLED = "bundled world"
    FOLDER = "built folder"
    PICTURE = "picture of a terrain"
    MAP = "laser map"
    MAP_PICTURE = "picture of a laser map"
    MESH = "mesh"
    CLOUD = "point cloud"
    LOG = "log of a laser"
