"""Map of leveled scans at given poses, for mappers and the true-pose map."""

from __future__ import annotations

import math
from dataclasses import dataclass

from lirs_wct.errors import limited
from lirs_wct.geometry import ByteArray, FloatArray, Imu, LaserScan, OccupancyGrid, Pose2
from slam_baselines.front_end import MotionFilter
from slam_baselines.ground_filter import GroundFilter, GroundFilterConfig
from slam_baselines.leveling import LeveledScan, ScanLeveler, ScanPoints, interpolate_hits
from slam_baselines.occupancy_map import NO_WALL, MapPyramid, OccupancyMap, UpdateConfig, bounding_box


@dataclass(frozen=True, kw_only=True)
class BuilderConfig(GroundFilterConfig, UpdateConfig):
    """Resolution of the map and conditions of its update; names as in hector_mapping.

    Attributes:
        map_resolution: Edge of a cell of the finest level, meters.
        map_multi_res_levels: Number of levels, each twice as coarse as the one before.
        map_update_distance_thresh: Distance to drive before the next update, meters.
        map_update_angle_thresh: Angle to turn before the next update, radians.
        map_update_tilt_thresh: Angle to tilt before the next update, radians; tilting shows other heights of
            the same things.
        sparse_distance: Distance from the scan before, a radian of turn counted as a meter, from which on a
            scan's hits are interpolated, meters.
    """

    map_resolution: float = limited(0.05, "(0, inf]", "m")
    map_multi_res_levels: int = limited(3, "[1, inf]")
    map_update_distance_thresh: float = limited(0.4, "[0, inf]")
    map_update_angle_thresh: float = limited(0.9, "[0, inf]")
    map_update_tilt_thresh: float = limited(math.radians(3.0), "[0, inf]")
    sparse_distance: float = limited(0.4, "(0, inf]", "m")


class MapBuilder:
    """Pyramid of occupancy maps, with a ground filter where the attitude is known.

    Attributes:
        ground_filter: Separation of ground and walls.
        motion_filter: Selection of the scans that enter the map.
        pyramid: Occupancy maps.
        updates: Number of updates.
        flat: Whether the ground has always been a floor; then every hit is a wall.
    """

    def __init__(self, config: BuilderConfig) -> None:
        self._config = c = config
        self.ground_filter = GroundFilter(c)
        self.motion_filter = MotionFilter(
            c.map_update_distance_thresh, c.map_update_angle_thresh, c.map_update_tilt_thresh
        )
        sizes = [c.map_resolution * 2**level for level in range(c.map_multi_res_levels)]
        self.pyramid = MapPyramid(tuple(OccupancyMap(size, c) for size in sizes))
        self.updates = 0
        self.flat = True
        self._sparse = False
        self._wall_slope = 0

    def restart(self) -> MapPyramid:
        """Clear the occupancy, keep the ground; return the former pyramid."""
        before = self.pyramid
        self.pyramid = MapPyramid(tuple(level.empty_copy() for level in before.maps))
        self._set_wall_slope(self.ground_filter.match_wall_slope)
        return before

    def move_base(self, scan: LeveledScan, step: Pose2, *, registered: bool = True) -> None:
        """Move the base by `T_before_now` and update its height (see GroundFilter.move)."""
        self._sparse = math.hypot(step.x, step.y) + abs(step.yaw) >= self._config.sparse_distance
        if scan.leveled:
            self.ground_filter.move(step, scan, registered=registered)

    def min_slopes(
        self, scan: LeveledScan, pose: Pose2, height: float | None = None, known: ByteArray | None = None
    ) -> ByteArray:
        """Return (n,) minimum slopes of the hits; arguments as of GroundFilter.min_slopes."""
        drawn = self.pyramid.maps[-1]
        return self.ground_filter.min_slopes(scan, pose, height, known=known, drawn=drawn)

    def weights(self, min_slopes: ByteArray) -> FloatArray | None:
        """Return (n,) weights of hits by their minimum slopes; None on a floor."""
        return None if self.flat else self.ground_filter.graded_weights(min_slopes, self._wall_slope)

    def match_weights(self, scan: LeveledScan, pose: Pose2) -> FloatArray | None:
        """Return the present (n,) weights of a scan's hits; None on a floor."""
        if self.flat:
            return None
        return self.ground_filter.match_weights(scan, pose, self.pyramid.maps[-1], self._wall_slope)

    def enter(self, scan: LeveledScan, pose: Pose2) -> ByteArray:
        """Update the map by a scan at `pose`; return the minimum slopes of its hits."""
        placed, min_slopes = self.ground_filter.insert(scan, pose)
        if self.ground_filter.match_wall_slope != self._wall_slope:
            self._set_wall_slope(self.ground_filter.match_wall_slope)
            for level in self.pyramid.maps:
                level.revalue(self._wall_slope)
        drawn = placed, min_slopes
        if self._sparse:
            drawn = interpolate_hits(*drawn, self._config.map_resolution)
        self._draw(*drawn)
        self.updates += 1
        self.motion_filter.note(scan, pose)
        return min_slopes

    def enter_again(self, scan: LeveledScan, pose: Pose2, height: float, min_slopes: ByteArray) -> None:
        """Update a restarted map with a scan that has entered the ground filter before."""
        self._draw(scan.transformed(pose, height), min_slopes)

    def _draw(self, scan: ScanPoints, min_slopes: ByteArray) -> None:
        box = bounding_box(scan)
        grew = [level.update(scan, min_slopes, self._wall_slope, box) for level in self.pyramid.maps]
        if any(grew):
            self.pyramid.refresh()

    def _set_wall_slope(self, wall_slope: int) -> None:
        self._wall_slope, self.flat = wall_slope, wall_slope == 0

    def map(self, *, walls: bool = True) -> OccupancyGrid:
        """Return the finest level; without `walls`, wall cells are unknown."""
        return self.pyramid.maps[0].occupancy_grid(self.ground_filter.wall_slope if walls else NO_WALL)

    @property
    def memory(self) -> int:
        """Bytes of all maps."""
        return sum(level.grid.nbytes for level in self.pyramid.maps) + self.ground_filter.grid.nbytes


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
        if self._builder.motion_filter.due(level, T_map_base):
            self._builder.enter(level, T_map_base)

    def map(self) -> OccupancyGrid:
        """Return the map so far."""
        return self._builder.map()
