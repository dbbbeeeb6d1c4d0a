"""Mapping with known poses, by the map update of the mappers."""

from __future__ import annotations

from lirs_wct.geometry import Imu, LaserScan, OccupancyGrid, Pose2
from slam_baselines.mapping.map_builder import BuilderConfig, MapBuilder
from slam_baselines.scan.leveling import ScanLeveler


class KnownPoseMapper:
    """Map of scans at known poses, in the frame of the poses."""

    def __init__(self, resolution: float = 0.05, config: BuilderConfig | None = None) -> None:
        """Use `config`, or the default one at `resolution`."""
        self._builder = MapBuilder(config or BuilderConfig(map_resolution=resolution, map_multi_res_levels=1))
        self._leveler = ScanLeveler()
        self._last: Pose2 | None = None

    def update(self, scan: LaserScan, T_map_base: Pose2, imu: Imu | None) -> None:
        """Process a scan; it enters the map if the robot has moved enough."""
        level = self._leveler.level(scan, imu)
        self._builder.move_base(level, Pose2() if self._last is None else self._last.inverse() @ T_map_base)
        self._last = T_map_base
        if self._builder.due(level, T_map_base):
            self._builder.enter(level, T_map_base)

    def map(self) -> OccupancyGrid:
        """Return the map so far."""
        return self._builder.map()
