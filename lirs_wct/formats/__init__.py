"""Reading and writing of file formats, and the names of their files.

A file that is missing or damaged raises a SourceError, one that cannot be written an OutputError. Parsers of
bytes raise a ValueError without the path.
"""

from typing import Literal, get_args

MESHES = (".stl", ".dae", ".obj", ".ply", ".glb")
"""Mesh files."""
CLOUDS = (".las", ".laz", ".pcd")
"""Point clouds; a .ply without faces is one, too."""
Encoding = Literal["gray", "terrain-rgb", "terrarium"]
ENCODINGS: tuple[Encoding, ...] = get_args(Encoding)
"""Encodings of heights in a picture: gray levels, or colors of map tiles."""
LOGS = (".clf", ".log")
"""CARMEN logs, which may end in .gz as well."""
BAGS = (".mcap", ".db3", ".bag")
"""Files of ROS 2 bags, and ROS 1 bags."""
MAPS = (".yaml", ".yml")
"""Metadata of ROS maps."""
Storage = Literal["mcap", "sqlite3"]
STORAGES: tuple[Storage, ...] = get_args(Storage)
"""Storage formats of a ROS 2 bag's messages."""
METADATA = "metadata.yaml"
"""File of a bag's folder that `ros2 bag` reads first."""
Clock = Literal["header", "receive"]
"""Source of a bag's stamps: the header of a message, or its reception by the recorder."""
ZSTD = ".zstd"
"""Ends the names of a ROS 2 bag's files that were compressed as a whole."""
