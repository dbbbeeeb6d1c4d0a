"""LIRS-WCT: build a World from a picture or a laser map.

The names below are imported on first use, so that a value type does not load every format's library.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lirs_wct.arrays import BoolArray, ByteArray, Float32Array, FloatArray, Int32Array, IntArray
    from lirs_wct.errors import (
        ConfigError,
        MapperError,
        OutputError,
        SimulationError,
        SourceError,
        WctError,
        require_known,
        unknown_name,
    )
    from lirs_wct.export.package import write_package
    from lirs_wct.geometry import (
        HeightField,
        Imu,
        ImuReadings,
        LaserScan,
        OccupancyGrid,
        PointCloud,
        Pose2,
        Pose3,
        Trajectory,
        WallGrid,
        covariance_fault,
        in_axes_of,
        wrap_angle,
    )
    from lirs_wct.geometry.mesh import TriangleMesh
    from lirs_wct.progress import Progress, no_progress
    from lirs_wct.sources.build import build_world
    from lirs_wct.sources.source import BuildOptions
    from lirs_wct.world import World

_NAMES = {
    "arrays": "BoolArray ByteArray Float32Array FloatArray Int32Array IntArray",
    "errors": "ConfigError MapperError OutputError SimulationError SourceError WctError "
    "require_known unknown_name",
    "export.package": "write_package",
    "geometry.grid": "HeightField OccupancyGrid WallGrid",
    "geometry.mesh": "TriangleMesh",
    "geometry.pose": "Pose2 Pose3 Trajectory covariance_fault in_axes_of wrap_angle",
    "geometry.scan": "Imu ImuReadings LaserScan PointCloud",
    "progress": "Progress no_progress",
    "sources.build": "build_world",
    "sources.source": "BuildOptions",
    "world": "World",
}
_HOMES = {name: module for module, names in _NAMES.items() for name in names.split()}

__all__ = [
    "BoolArray",
    "BuildOptions",
    "ByteArray",
    "ConfigError",
    "Float32Array",
    "FloatArray",
    "HeightField",
    "Imu",
    "ImuReadings",
    "Int32Array",
    "IntArray",
    "LaserScan",
    "MapperError",
    "OccupancyGrid",
    "OutputError",
    "PointCloud",
    "Pose2",
    "Pose3",
    "Progress",
    "SimulationError",
    "SourceError",
    "Trajectory",
    "TriangleMesh",
    "WallGrid",
    "WctError",
    "World",
    "build_world",
    "covariance_fault",
    "in_axes_of",
    "no_progress",
    "require_known",
    "unknown_name",
    "wrap_angle",
    "write_package",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
