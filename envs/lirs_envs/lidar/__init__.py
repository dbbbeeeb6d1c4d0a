"""The lidar, a laser range finder (LRF): presets, beam patterns, noise, ray casting.

`TerrainLidar` is the lidar for MuJoCo models from elsewhere. It is imported on first use.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lirs_envs.lidar.terrain_lidar import TerrainLidar

__all__ = ["TerrainLidar"]


def __getattr__(name: str) -> Any:
    if name != "TerrainLidar":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    # The command line lists presets, which need neither MuJoCo nor kernels.
    return import_module(f"{__name__}.terrain_lidar").TerrainLidar
