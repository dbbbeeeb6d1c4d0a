"""Suffixes by which a file's format is recognized."""

from pathlib import Path

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
    ".vrt",
    ".bil",
    ".flt",
    ".dem",
    ".adf",
    ".nc",
    ".jp2",
)
"""Elevation data beside GeoTIFF; all but the first two by GDAL."""
LOGS = (".clf", ".log")
"""CARMEN logs, which may end in .gz as well."""
BAGS = (".mcap", ".db3", ".bag")
"""Files of ROS 2 bags, and ROS 1 bags."""
MAPS = (".yaml", ".yml")
"""Metadata of ROS maps."""
ZSTD = ".zstd"
"""Ends the names of a ROS 2 bag's files that were compressed as a whole."""


def is_bag_file(path: Path) -> bool:
    """Return whether a file's name is that of a ROS bag, or of a part of one."""
    return path.name.lower().removesuffix(ZSTD).endswith(BAGS)
