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
        wrap_angle,
    )
    from lirs_wct.geometry.mesh import TriangleMesh
    from lirs_wct.sources.build import build_world
    from lirs_wct.sources.source import BuildOptions
    from lirs_wct.world import World

_HOMES = {
    "BoolArray": "arrays",
    "ByteArray": "arrays",
    "Float32Array": "arrays",
    "FloatArray": "arrays",
    "Int32Array": "arrays",
    "IntArray": "arrays",
    "BuildOptions": "sources.source",
    "ConfigError": "errors",
    "HeightField": "geometry.grid",
    "Imu": "geometry.scan",
    "ImuReadings": "geometry.scan",
    "LaserScan": "geometry.scan",
    "MapperError": "errors",
    "OccupancyGrid": "geometry.grid",
    "OutputError": "errors",
    "PointCloud": "geometry.scan",
    "Pose2": "geometry.pose",
    "Pose3": "geometry.pose",
    "SimulationError": "errors",
    "SourceError": "errors",
    "Trajectory": "geometry.pose",
    "TriangleMesh": "geometry.mesh",
    "WallGrid": "geometry.grid",
    "WctError": "errors",
    "World": "world",
    "build_world": "sources.build",
    "unknown_name": "errors",
    "wrap_angle": "geometry.pose",
    "write_package": "export.package",
}

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
    "SimulationError",
    "SourceError",
    "Trajectory",
    "TriangleMesh",
    "WallGrid",
    "WctError",
    "World",
    "build_world",
    "unknown_name",
    "wrap_angle",
    "write_package",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
