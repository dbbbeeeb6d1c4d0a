"""Suffixes by which files are told apart."""

MESHES = (".stl", ".dae", ".obj", ".ply", ".glb")
"""Mesh files."""
LOGS = (".clf", ".log")
"""CARMEN logs, which may end in .gz as well."""
MAPS = (".yaml", ".yml")
"""Metadata of ROS maps."""
