"""Names of file formats: suffixes, encodings, and parts of bags."""

from pathlib import Path
from typing import Literal, get_args

MESHES = (".stl", ".dae", ".obj", ".ply", ".glb")
"""Mesh files."""
CLOUDS = (".las", ".laz", ".pcd")
"""Point clouds; a .ply without faces is one, too."""
Encoding = Literal["gray", "terrain-rgb", "terrarium"]
ENCODINGS: tuple[Encoding, ...] = ("gray", "terrain-rgb", "terrarium")
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
BAG_FILES: dict[Storage, str] = {"mcap": ".mcap", "sqlite3": ".db3"}
"""Suffix of a bag's file by storage format."""
METADATA = "metadata.yaml"
"""File of a bag's folder that `ros2 bag` reads first."""
Clock = Literal["header", "receive"]
CLOCKS: tuple[Clock, ...] = get_args(Clock)
"""Sources of a bag's stamps: the header of a message, or its reception by the recorder."""
ZSTD = ".zstd"
"""Ends the names of a ROS 2 bag's files that were compressed as a whole."""

UNREAD = {
    ".gltf": ("a glTF scene in several files", "save it as .glb"),
    ".fbx .blend .3ds .skp .x3d .wrl .off .3mf .usd .usda .usdc .usdz": (
        "a scene of another 3D program",
        "export it as .glb, .dae, .obj, .ply or .stl, by Blender for example",
    ),
    ".step .stp .iges .igs .ifc .dxf .dwg": ("a CAD model", "export it as .stl, by FreeCAD for example"),
    ".e57 .pts .ptx": ("a point cloud", "convert it to .las, .ply or .pcd, by CloudCompare for example"),
    ".bt .ot": ("an OctoMap", "octree2pointcloud IN OUT.pcd makes a point cloud of it"),
    ".world .sdf .urdf .xacro": ("a description in XML", "give the mesh or the heightmap that it names"),
    ".svg .pdf .heic": ("a drawing", "export it as .png"),
    ".npy .npz .mat": ("an array", "save it as .tif or .png"),
    ".zip .7z .rar .tar .tgz": ("an archive", "unpack it"),
}
"""Kinds of files that are not read, by suffixes, and the way to one that is."""


def way_to_read(path: Path) -> str | None:
    """Return the kind of an unread file and a way to convert it; else None."""
    known = (text for suffixes, text in UNREAD.items() if path.suffix.lower() in suffixes.split())
    return next((f"is {kind}, which is not read: {way}" for kind, way in known), None)


def is_bag_file(path: Path) -> bool:
    """Return whether a file is, by its name, a ROS bag or part of one."""
    return path.name.lower().removesuffix(ZSTD).endswith(BAGS)
