"""Front end of the planar mappers: the shared steps between a scan and the map.

Each scan is leveled, its pose is predicted by dead reckoning, and two monitors decide whether to use the
method's match and whether the scan may enter the map, which a builder draws. On uneven ground the start of
the map is refined.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from lirs_wct.errors import limited
from lirs_wct.geometry import (
    ByteArray,
    FloatArray,
    Imu,
    IntArray,
    LaserScan,
    OccupancyGrid,
    Pose2,
    Trajectory,
    compose_poses,
    relative_poses,
    wrap_angles,
)
from slam_baselines.dead_reckoning import DriftCovariance, PoseEstimate, moved_covariance
from slam_baselines.ground_filter import GroundFilter, GroundFilterConfig
from slam_baselines.leveling import LeveledScan, ScanLeveler, ScanPoints, interpolate_hits
from slam_baselines.monitors import MonitorConfig, Monitors
from slam_baselines.occupancy_map import NO_WALL, MapPyramid, OccupancyMap, UpdateConfig, bounding_box
from slam_baselines.registration import Match


@dataclass(frozen=True, kw_only=True)
class FrontEndConfig(GroundFilterConfig, MonitorConfig):
    """Parameters of ground filter, monitors and start-up refinement, which all methods share.

    Attributes:
        bootstrap_first: Distance traveled at the first start-up refinement, meters; the next are due at 2, 4,
            8 ... times that.
        bootstrap_last: Distance after which there is none, meters.
    """

    bootstrap_first: float = limited(4.0, "(0, inf]", "m")
    bootstrap_last: float = limited(40.0, "(0, inf]", "m")


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


@dataclass(frozen=True, slots=True)
class Keyframe:
    """A scan that entered the map.

    Attributes:
        scan: Leveled scan.
        pose: `T_map_base`.
        height: Height of the base in the map frame, meters.
        min_slopes: (n,) minimum slopes of its hits, SLOPE_STEP.
    """

    scan: LeveledScan
    pose: Pose2
    height: float
    min_slopes: ByteArray


class FrontEnd:
    """Pose of the latest scan by dead reckoning and by believed matches.

    Attributes:
        estimate: `T_map_base` and its covariance relative to the map.
        drift: Covariance of `T_map_base` with the map's own errors.
        matched: Scans with a match.
        unmatched: Scans with too few walls in view.
        path: Poses of the keyframes.
        scans: Poses of all scans relative to the keyframes.
        stamp: Time of the last scan, seconds.
    """

    def __init__(
        self, config: MonitorConfig, clear_range: float, max_range: float, resolution: float
    ) -> None:
        self.leveler = ScanLeveler(clear_range, max_range)
        self.monitors = Monitors(config)
        self.estimate = PoseEstimate(Pose2(), np.zeros((3, 3)))
        self.drift = DriftCovariance(resolution / math.sqrt(12))  # a wall lies anywhere in its cell
        self.matched = self.unmatched = 0
        self.path: list[Pose2] = []
        self.scans = KeyframeTrajectory()
        self.stamp = -math.inf

    def monitor(
        self,
        scan: LeveledScan,
        prior: PoseEstimate,
        estimate: PoseEstimate,
        match: Match | None,
        *,
        floor: bool,
    ) -> bool:
        """Take over a believed registration; return whether the scan may enter the map.

        The estimate is `prior`, that by dead reckoning, and the match None with too few walls in view.
        """
        seconds, self.stamp = scan.stamp - self.stamp, scan.stamp
        turn = math.remainder(prior.pose.yaw - self.estimate.pose.yaw, math.tau)
        score, known = (None, 1.0) if match is None else (match.score, match.known)
        if self.path:
            if scan.leveled:
                moved = prior.pose.distance(self.estimate.pose) + LEVER * abs(turn)
                self.monitors.localizability.observe(score, moved, floor=floor)
            self.matched += match is not None
            self.unmatched += match is None
        before, self.estimate = self.estimate, estimate if self.monitors.localizability.believed else prior
        dx, dy = prior.pose.x - before.pose.x, prior.pose.y - before.pose.y
        noise = prior.covariance - moved_covariance(before.covariance, dx, dy, 0.0, 0.0)
        seconds = max(seconds, 0.0) if self.path else 0.0
        self.drift.move(before.pose, prior.pose, noise, seconds, scan.ground_slope)
        if self.estimate is not prior:
            self.drift.match(self.estimate.pose, prior.covariance, self.estimate.covariance, scan.hits)
        return self.monitors.observe_fit(score, known)

    def add_keyframe(self, scan: LeveledScan, pose: Pose2) -> None:
        """Add a scan that enters the map to the path."""
        self.path.append(pose)
        self.drift.add_keyframe(pose, scan.hits)

    def replace_start(self, keyframes: Sequence[Keyframe]) -> None:
        """Correct path and estimate by the refined keyframes of the start."""
        before = self.path[-1]
        self.path[: len(keyframes)] = [keyframe.pose for keyframe in keyframes]
        T_new_old = self.path[-1] @ before.inverse()
        self.estimate = PoseEstimate(T_new_old @ before, self.estimate.covariance)

    def note(self, stamp: float) -> Pose2:
        """Add the scan to the trajectory; return `T_map_base`."""
        pose = self.estimate.pose
        self.scans.add(stamp, len(self.path) - 1, self.path[-1].inverse() @ pose if self.path else pose)
        return pose


class MotionFilter:
    """Selection of the scans that enter the map: those after enough motion."""

    def __init__(self, distance: float, angle: float, tilt: float, seconds: float = math.inf) -> None:
        """Start; limits in meters, radians of turn, radians of tilt and seconds."""
        self._limits = distance, angle, tilt, seconds
        self._pose: Pose2 | None = None
        self._slope = (0.0, 0.0)
        self._stamp = -math.inf

    def note(self, scan: LeveledScan, pose: Pose2) -> None:
        """Record a scan that enters the map."""
        self._pose, self._slope, self._stamp = pose, scan.ground_slope, scan.stamp

    def correct_pose(self, pose: Pose2) -> None:
        """Correct the pose of the last recorded scan."""
        self._pose = pose

    def due(self, scan: LeveledScan, pose: Pose2) -> bool:
        """Return whether the robot has moved, turned, tilted or waited enough since the last one."""
        last, (distance, angle, tilt, seconds) = self._pose, self._limits
        return (
            last is None
            or math.hypot(pose.x - last.x, pose.y - last.y) > distance
            or abs(math.remainder(pose.yaw - last.yaw, math.tau)) > angle
            or math.dist(scan.ground_slope, self._slope) > tilt
            or scan.stamp - self._stamp > seconds
        )


class MapBuilder:
    """Pyramid of occupancy maps, with a ground filter where the attitude is known.

    The motion filter selects the scans that enter the map.
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
        self._sparse = False
        self._wall_slope = 0

    def restart(self) -> MapPyramid:
        """Clear the occupancy, keep the ground; return the former pyramid."""
        before = self.pyramid
        self.pyramid = MapPyramid(tuple(level.empty_copy() for level in before.maps))
        self._wall_slope = self.ground_filter.match_wall_slope
        return before

    @property
    def flat(self) -> bool:
        """Whether the ground has always been a floor; then every hit is a wall."""
        return self._wall_slope == 0

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
        return None if self.flat else self.ground_filter.weights_among_walls(min_slopes, self._wall_slope)

    def match_weights(self, scan: LeveledScan, pose: Pose2) -> FloatArray | None:
        """Return the present (n,) weights of a scan's hits; None on a floor."""
        if self.flat:
            return None
        return self.ground_filter.match_weights(scan, pose, self.pyramid.maps[-1], self._wall_slope)

    def enter(self, scan: LeveledScan, pose: Pose2) -> ByteArray:
        """Update the map by a scan at `pose`; return the minimum slopes of its hits."""
        placed, min_slopes = self.ground_filter.insert(scan, pose)
        if self.ground_filter.match_wall_slope != self._wall_slope:
            self._wall_slope = self.ground_filter.match_wall_slope
            for level in self.pyramid.maps:
                level.revalue(self._wall_slope)
        sparse, resolution = self._sparse, self._config.map_resolution
        self._draw(*(interpolate_hits(placed, min_slopes, resolution) if sparse else (placed, min_slopes)))
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

    def map(self, *, walls: bool = True) -> OccupancyGrid:
        """Return the finest level; without `walls`, wall cells are unknown."""
        return self.pyramid.maps[0].occupancy_grid(self.ground_filter.wall_slope if walls else NO_WALL)

    @property
    def memory(self) -> int:
        """Bytes of all maps."""
        return sum(level.grid.nbytes for level in self.pyramid.maps) + self.ground_filter.grid.nbytes


class KnownPoseMapper:
    """Map of scans at known poses, in the frame of the poses."""

    def __init__(self, resolution: float = 0.05) -> None:
        """Start an empty map with cells of an edge `resolution`, meters."""
        self._builder = MapBuilder(BuilderConfig(map_resolution=resolution, map_multi_res_levels=1))
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


K = TypeVar("K", bound=Keyframe)


REFINED_SHARE = 0.5
"""Share of the keyframes that must fit for a refined start; on hillsides and between rocks fewer do."""


class StartUp(Generic[K]):
    """Schedule of the start-up refinements, and their keyframes.

    On uneven ground no wall is known at first. So the robot starts on odometry alone, and the first scans
    enter the map at poses with a small error that the map would keep. After some meters most walls in the
    first scans are known: a new map is built from them.

    Attributes:
        keyframes: First keyframes; empty when the last refinement is over.
        refinements: Number of refinements.
        over: Whether there will be no more refinement.
    """

    def __init__(self, config: FrontEndConfig) -> None:
        self.keyframes: list[K] = []
        self.refinements = 0
        self._last, self._next = config.bootstrap_last, config.bootstrap_first
        self._distance = 0.0
        self.over = self._next > self._last or self._next == math.inf

    def add(self, keyframe: K, distance_traveled: float) -> bool:
        """Keep a keyframe while it may be needed; return whether a refinement is due.

        Only where the attitude is known: on a floor the start needs no refinement.
        """
        if not keyframe.scan.leveled:
            return False
        if self.over or distance_traveled > self._last:
            self.close()
            return False
        self.keyframes.append(keyframe)
        self._distance = distance_traveled
        return distance_traveled >= self._next

    def replace(self, keyframes: Sequence[K]) -> None:
        """Replace the keyframes by refined ones; all refinements due so far are done."""
        self.keyframes = list(keyframes)
        self.refinements += 1
        while self._next <= self._distance:
            self._next *= 2
        self.over = self._next > self._last

    def close(self) -> None:
        """End the refinements."""
        self.keyframes.clear()
        self.over = True


LEVER = 0.5
"""Meters per radian of turn in the distance over which an error is spread."""


class KeyframeTrajectory:
    """Poses of all scans relative to their last keyframes, 36 bytes a scan."""

    def __init__(self) -> None:
        self._keyframes, self._numbers = array("i"), array("d")

    def add(self, stamp: float, keyframe: int, T_keyframe_scan: Pose2) -> None:
        """Add a scan since the keyframe of an index; -1: since the start.

        A later scan of the same stamp, seconds, replaces the earlier one.
        """
        pose = T_keyframe_scan
        self._keyframes.append(keyframe)
        self._numbers.extend((stamp, pose.x, pose.y, pose.yaw))

    def trajectory(
        self,
        keyframes: Sequence[Pose2],
        measured: Sequence[Pose2] | None = None,
        T_map_start: Pose2 | None = None,
    ) -> Trajectory:
        """Return the pose of every scan in the map frame, by stamp.

        Args:
            keyframes: `T_map_base` of the keyframes.
            measured: Poses of the keyframes by the motion from one to the next; their difference from
                `keyframes` is spread over the scans between. None: scans keep their poses relative to the
                keyframe before them, as they were matched one by one.
            T_map_start: Pose of the start frame, for scans before the first keyframe; None: the pose by
                `measured`, else the map frame.
        """
        if not self._keyframes:
            return Trajectory.from_poses([], [])
        rows = np.array(self._numbers).reshape(-1, 4)
        order = np.argsort(rows[:, 0], kind="stable")
        ordered = rows[order, 0]
        order = order[np.append(ordered[1:] != ordered[:-1], True)]  # the last of each stamp
        stamps, scans = rows[order, 0], rows[order, 1:]
        last = np.array(self._keyframes, dtype=np.int64)[order]
        if T_map_start is None:
            T_map_start = keyframes[0] @ measured[0].inverse() if measured and keyframes else Pose2()
        poses = compose_poses(T_map_start.as_array(), scans)
        at = last >= 0
        if at.any():
            final = np.array([p.as_array() for p in keyframes])
            poses[at] = compose_poses(final[last[at]], scans[at])
            if measured is not None:
                by_motion = np.array([p.as_array() for p in measured])
                poses[at] = _spread(poses[at], scans[at], last[at], final, by_motion)
        return Trajectory.from_poses(stamps, (Pose2(*pose.tolist()) for pose in poses))


def _spread(
    poses: FloatArray, scans: FloatArray, last: IntArray, final: FloatArray, measured: FloatArray
) -> FloatArray:
    """Interpolate between the poses by the previous and by the next keyframe."""
    after = np.clip(last + 1, 0, len(final) - 1)
    ahead = relative_poses(measured[after], compose_poses(measured[last], scans))
    near, far = (np.hypot(d[:, 0], d[:, 1]) + LEVER * abs(wrap_angles(d[:, 2])) for d in (scans, ahead))
    delta = compose_poses(final[after], ahead) - poses
    delta[:, 2] = wrap_angles(delta[:, 2])
    return np.asarray(poses + (near / np.maximum(near + far, 1e-12))[:, None] * delta)
