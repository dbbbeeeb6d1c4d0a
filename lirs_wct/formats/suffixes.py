"""Suffixes by which a file's format is recognized."""

MESHES = (".stl", ".dae", ".obj", ".ply", ".glb")
"""Mesh files."""
LOGS = (".clf", ".log")
"""CARMEN logs, which may end in .gz as well."""
BAGS = (".mcap", ".db3", ".bag")
"""Files of ROS 2 bags, and ROS 1 bags."""
MAPS = (".yaml", ".yml")
"""Metadata of ROS maps."""
