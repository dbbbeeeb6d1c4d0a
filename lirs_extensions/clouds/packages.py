"""Systems in their authors' packages: GenZ-ICP, RKO-LIO, and an odometry of small_gicp.

Lee et al., "GenZ-ICP: Generalizable and Degeneracy-Robust LiDAR Odometry Using an Adaptive Weighting" (RA-L
2025), which extends KISS-ICP. Malladi et al., "A Robust Approach for LiDAR-Inertial Odometry Without
Sensor-Specific Modeling" (RA-L 2026). Koide, "small_gicp: Efficient and Parallel Algorithms for Point Cloud
Registration" (JOSS 2024).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from lirs_wct.errors import Checked, limited
from lirs_wct.geometry import FloatArray, Imu, ImuReadings, PointCloud, Pose3, Trajectory
from slam_baselines.kiss_icp import CloudOdometry, pose_of, sweep_times
from slam_baselines.mapper import MapperStats, Stopwatch

SLACK = 1e-3
"""Seconds by which a sweep may end after the last inertial reading."""


class TimedSystem(ABC):
    """System behind a `TimedOdometry`, which may take inertial readings."""

    inertial = False

    def add_readings(self, readings: ImuReadings) -> None:
        """Take in inertial readings; nothing by default."""
        return

    @abstractmethod
    def register(self, cloud: PointCloud) -> Sequence[tuple[float, FloatArray]]:
        """Register a sweep with points; return new poses `T_world_base` (4, 4) and their times."""


class TimedOdometry:
    """A `CloudMapper` of a system whose poses lie at times of their own.

    A system with inertial readings gets a sweep when the readings reach the sweep's end. Poses at the stamps
    are interpolated; the present one is extrapolated at constant velocity.

    The map frame is the first base pose. An inertial system first measures gravity while the robot stands
    still: there, the first pose that differs from the initial one counts.
    """

    reads_clouds = True
    lost = False

    def __init__(self, system: TimedSystem) -> None:
        self._system, self.reads_inertial = system, system.inertial
        self._waiting: deque[PointCloud] = deque()
        self._stamps: list[float] = []
        self._times: list[float] = []
        self._poses: list[Pose3] = []
        self._empty, self._reached = 0, -np.inf
        self._watch = Stopwatch()

    def update(self, cloud: PointCloud, imu: Imu | None, readings: ImuReadings | None = None) -> Pose3:
        """Register all complete sweeps; return `T_map_base` at the stamp."""
        started = self._watch.start()
        self._stamps.append(cloud.stamp)
        self._waiting.append(cloud)
        if readings is not None and len(readings):
            self._system.add_readings(readings)
            self._reached = float(readings.stamps[-1])
        while self._waiting:
            waiting = self._waiting[0]
            end = waiting.stamp + (float(waiting.time.max()) if len(waiting) else 0.0)
            if self.reads_inertial and end > self._reached + SLACK:
                break
            self._register(self._waiting.popleft())
        pose = self._at(self._stamps[-1:])[0]
        self._watch.stop(started)
        return pose

    def trajectory(self) -> Trajectory:
        """Return the poses at the stamps of all sweeps."""
        return Trajectory.from_poses(self._stamps, self._at(self._stamps))

    @property
    def stats(self) -> MapperStats:
        """Sweeps and times."""
        received, waiting = len(self._stamps), len(self._waiting)
        reasons = {"empty": self._empty, "after the last reading": waiting}
        skipped = {reason: count for reason, count in reasons.items() if count}
        used = received - self._empty - waiting
        return self._watch.add_to(MapperStats(received=received, used=used, skipped=skipped))

    def _register(self, cloud: PointCloud) -> None:
        if not len(cloud):
            self._empty += 1
            return
        for time, matrix in self._system.register(cloud):
            pose = pose_of(matrix)
            # A repeated pose means that the system skipped the sweep, or does not run yet.
            if not self._poses or pose != self._poses[-1]:
                self._times.append(time)
                self._poses.append(pose)

    def _at(self, stamps: Sequence[float]) -> list[Pose3]:
        """Return `T_map_base` at some stamps; the identity before the map frame's time."""
        first = 1 if self.reads_inertial else 0
        times, poses = self._times[first:], self._poses[first:]
        if len(poses) < 2:
            return [Pose3()] * len(stamps)
        T_map_world = poses_at(times, poses, [max(times[0], self._stamps[0])])[0].inverse()
        found = poses_at(times, poses, [max(stamp, times[0]) for stamp in stamps])
        return [T_map_world @ pose for pose in found]


def poses_at(times: Sequence[float], poses: Sequence[Pose3], stamps: Sequence[float]) -> list[Pose3]:
    """Return poses at stamps, interpolated between two or more, or extrapolated from the nearest two."""
    t = np.asarray(times)
    after = np.clip(np.searchsorted(t, stamps), 1, len(t) - 1)
    share = (np.asarray(stamps) - t[after - 1]) / (t[after] - t[after - 1])
    found = []
    for k, s in zip(after.tolist(), share.tolist(), strict=True):
        a, b = poses[k - 1], poses[k]
        qa, qb = a.quaternion, b.quaternion
        q = (1 - s) * qa + s * (qb if qa @ qb > 0 else -qb)
        found.append(Pose3.from_arrays((1 - s) * a.position + s * b.position, q))
    return found


def deskew(points: FloatArray, times: FloatArray, motion: FloatArray) -> FloatArray:
    """Return points (n, 3) as seen in the middle of the sweep, meters.

    The motion (4, 4), from the stamp to the sweep's end, is constant: rotation by Rodrigues' formula,
    translation linear. Seen from the middle, an error of the motion hardly moves the cloud; seen from the
    start, it would come back as the next motion's error. Without times (n,) since the stamp, the points are
    unchanged.
    """
    if not len(times):
        return points
    share = (times / times.max() - 0.5)[:, None]
    w, *v = pose_of(motion).quaternion
    sine = np.linalg.norm(v)
    axis = np.asarray(v) / max(sine, 1e-12)
    angle = 2 * np.arctan2(sine, w) * share
    along = (points @ axis)[:, None] * axis
    turned = along + (points - along) * np.cos(angle) + np.cross(axis, points) * np.sin(angle)
    seen: FloatArray = turned + share * motion[:3, 3]
    return seen


def matrix_of(pose: Pose3) -> FloatArray:
    """Return the homogeneous matrix (4, 4) of a pose, meters."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = pose.rotation, pose.position
    return matrix


@dataclass(frozen=True, kw_only=True)
class GenzIcpConfig(Checked, of="genz-icp"):
    """Configurable parameters of GenZ-ICP; the defaults are the authors'.

    Its native code sums in another order each time: two runs of the same clouds differ by millimeters.

    Attributes:
        max_range: points beyond are left out, meters.
        min_range: points nearer are left out, meters.
        voxel_size: edge of the map's voxels at the start, meters; the method adapts it.
    """

    max_range: float = limited(100.0, "(0, inf)", "m")
    min_range: float = limited(0.3, "[0, inf]", "m")
    voxel_size: float = limited(0.3, "(0, inf)", "m")


def make_genz_icp(config: GenzIcpConfig) -> CloudOdometry:
    """Return GenZ-ICP as a mapper; like the authors' program, it ignores times in a sweep."""
    from genz_icp.config import GenZConfig
    from genz_icp.genz_icp import GenZICP

    settings = GenZConfig()
    settings.data.max_range, settings.data.min_range = config.max_range, config.min_range
    settings.mapping.voxel_size = config.voxel_size
    odometry = GenZICP(settings)

    def register(points: FloatArray, times: FloatArray) -> FloatArray:
        odometry.register_frame(points, np.empty(0))
        pose: FloatArray = odometry.last_pose.copy()
        return pose

    return CloudOdometry(register)


BEGIN = 1.0
"""Seconds that are added to all stamps: RKO-LIO takes the time 0 for "not yet"."""


@dataclass(frozen=True, kw_only=True)
class RkoLioConfig(Checked, of="rko-lio"):
    """Configurable parameters of RKO-LIO; the defaults are the authors'.

    Attributes:
        max_range: points beyond are left out, meters.
        min_range: points nearer are left out, meters.
        voxel_size: edge of the map's voxels, meters.
        double_downsample: whether the scan is thinned twice, which the authors advise against for lidars
            with few rings.
        initialization_phase: whether gravity and biases come from the time between the first two sweeps, in
            which the robot must stand still; the authors' default is no.
        max_num_threads: Threads of the registration; 1 = as every other mapper here, 0 = all.
    """

    max_range: float = limited(100.0, "(0, inf)", "m")
    min_range: float = limited(1.0, "[0, inf]")
    voxel_size: float = limited(1.0, "(0, inf)", "m")
    double_downsample: bool = True
    initialization_phase: bool = True
    max_num_threads: int = limited(1, "[0, inf]")


class RkoLio(TimedSystem):
    """RKO-LIO as a `TimedSystem`; the inertial unit's frame is the base's."""

    inertial = True

    def __init__(self, config: RkoLioConfig) -> None:
        from rko_lio.config import LIOConfig
        from rko_lio.lio import LIO

        self._lio = LIO(LIOConfig(**asdict(config)))

    def add_readings(self, readings: ImuReadings) -> None:
        """Add inertial readings one by one."""
        stamps = nanoseconds(readings.stamps).tolist()
        rows = zip(readings.linear_acceleration, readings.angular_velocity, stamps, strict=True)
        for acceleration, rates, stamp in rows:
            self._lio.add_imu_measurement(acceleration, rates, stamp)

    def register(self, cloud: PointCloud) -> list[tuple[float, FloatArray]]:
        """Register a sweep; return the pose of its end."""
        times = cloud.stamp + cloud.time.astype(np.float64)
        self._lio.register_scan(cloud.xyz, nanoseconds(times), matrix_of(cloud.T_base_laser))
        return [(float(times.max()), self._lio.pose())]


def nanoseconds(stamps: FloatArray) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
    """Return stamps (n,) in seconds as RKO-LIO's times."""
    return np.rint((stamps + BEGIN) * 1e9).astype(np.int64)


def make_rko_lio(config: RkoLioConfig) -> TimedOdometry:
    """Return RKO-LIO as a mapper."""
    return TimedOdometry(RkoLio(config))


VOXEL_LIFETIME = 10**6
"""Sweeps for which a voxel is kept that no sweep meets: the robot comes back."""


@dataclass(frozen=True, kw_only=True)
class SmallGicpConfig(Checked, of="small-gicp"):
    """Configurable parameters of the odometry; the defaults follow the package's odometry benchmark.

    Attributes:
        max_range: points beyond are left out, meters.
        min_range: points nearer are left out, meters.
        voxel_size: edge of the voxels of map and scan, meters.
        max_distance: largest distance between a point and its voxel, meters.
        neighbors: number of points that give the covariance of a point.
        threads: Threads of the registration; 1 = as every other mapper here.
    """

    max_range: float = limited(100.0, "(0, inf)", "m")
    min_range: float = limited(0.3, "[0, inf]", "m")
    voxel_size: float = limited(0.25, "(0, inf)", "m")
    max_distance: float = limited(1.0, "(0, inf)", "m")
    neighbors: int = limited(10, "[5, inf]")
    threads: int = limited(1, "[1, inf]")


class SmallGicp(TimedSystem):
    """Odometry of small_gicp's registration as a `TimedSystem`.

    VGICP registers each sweep against a map of Gaussian voxels (Koide et al., "Voxelized GICP for Fast and
    Accurate 3D Point Cloud Registration", ICRA 2021). Constant velocity predicts its pose and takes the
    robot's motion out of a rolling sweep.
    """

    def __init__(self, config: SmallGicpConfig) -> None:
        import small_gicp

        self._gicp, self._config = small_gicp, config
        self._map = small_gicp.GaussianVoxelMap(config.voxel_size)
        self._map.set_lru(horizon=VOXEL_LIFETIME)
        self._pose, self._motion = np.eye(4), np.eye(4)
        self._mount: FloatArray | None = None

    def register(self, cloud: PointCloud) -> list[tuple[float, FloatArray]]:
        """Register a sweep; return the pose of its middle."""
        config, gicp = self._config, self._gicp
        times = sweep_times(cloud)
        ranges = np.linalg.norm(cloud.xyz, axis=1)
        kept = (ranges >= config.min_range) & (ranges <= config.max_range)
        points = deskew(cloud.xyz.astype(np.float64), times, self._motion)[kept]
        scan, _ = gicp.preprocess_points(points, config.voxel_size, config.neighbors, config.threads)
        if self._mount is None:
            self._mount = self._pose = matrix_of(cloud.T_base_laser)
        else:
            options = {"max_correspondence_distance": config.max_distance, "num_threads": config.threads}
            found = gicp.align(self._map, scan, self._pose @ self._motion, **options).T_target_source
            self._pose, self._motion = found, np.linalg.inv(self._pose) @ found
        self._map.insert(scan, self._pose)
        middle = cloud.stamp + (0.5 * float(times.max()) if len(times) else 0.0)
        return [(middle, self._pose @ np.linalg.inv(self._mount))]


def make_small_gicp(config: SmallGicpConfig) -> TimedOdometry:
    """Return the odometry as a mapper."""
    return TimedOdometry(SmallGicp(config))
