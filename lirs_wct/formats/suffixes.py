"""Suffixes and encodings by which a file's format is named."""

from pathlib import Path
from typing import Literal

MESHES = (".stl", ".dae", ".obj", ".ply", ".glb")
"""Mesh files."""
CLOUDS = (".las", ".laz", ".pcd")
"""Point clouds; a .ply without faces is one, too."""
RASTERS = (
    ".asc",
    ".hgt",
    ".dt0",
    ".dt1",
    ".dt2",
    ".img",
    ".bil",
    ".flt",
    ".dem",
    ".adf",
    ".nc",
    ".jp2",
    ".xyz",
)
"""Elevation data besides GeoTIFF, by their usual suffixes; the content decides."""
Encoding = Literal["gray", "terrain-rgb", "terrarium"]
ENCODINGS: tuple[Encoding, ...] = ("gray", "terrain-rgb", "terrarium")
"""Encodings of heights in a picture: gray levels, or colors of map tiles."""
LOGS = (".clf", ".log")
"""CARMEN logs, which may end in .gz as well."""
BAGS = (".mcap", ".db3", ".bag")
"""Files of ROS 2 bags, and ROS 1 bags."""
MAPS = (".yaml", ".yml")
"""Metadata of ROS maps."""
ZSTD = ".zstd"
"""Ends the names of a ROS 2 bag's files that were compressed as a whole."""


def is_bag_file(path: Path) -> bool:
    """Return whether a file is, by its name, a ROS bag or part of one."""
    return path.name.lower().removesuffix(ZSTD).endswith(BAGS)
