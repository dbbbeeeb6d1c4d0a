"""Values as ROS 2 messages in CDR; frames and units by REP 103 and 105.

The messages of a robot always have the same strings and lengths. Only numbers differ, which are written into
a template. That takes a tenth of the time of a general serializer.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from lirs_wct.geometry import (
    FREE,
    OCCUPIED,
    POINT,
    Imu,
    ImuReadings,
    LaserScan,
    OccupancyGrid,
    PointCloud,
    Pose2,
    Pose3,
)

ENCAPSULATION = b"\x00\x01\x00\x00"
"""First bytes of a message: CDR, little-endian. Alignment counts from the byte after them."""


class Layout:
    """The fixed layout of a message.

    Args:
        parts: Kinds of values as in `struct`, such as "iI" or "dddd"; strings that never change, as bytes;
            kind and number of values that stay 0.
    """

    def __init__(self, *parts: str | bytes | tuple[str, int]) -> None:
        self._template = bytearray()
        self._runs: list[tuple[struct.Struct, int, int]] = []
        for part in parts:
            if isinstance(part, bytes):
                self._pad(4)
                self._template += struct.pack("<I", len(part) + 1) + part + b"\0"
            elif isinstance(part, tuple):
                size = struct.calcsize(part[0])
                self._pad(size)
                self._template += bytes(size * part[1])
            else:
                begin, form = len(self._template), "<"
                for kind in part:
                    before, size = len(self._template), struct.calcsize(kind)
                    self._pad(size)
                    form += "x" * (len(self._template) - before) + kind
                    self._template += bytes(size)
                self._runs.append((struct.Struct(form), len(ENCAPSULATION) + begin, len(part)))
        self._template[:0] = ENCAPSULATION

    def pack(self, *values: float) -> bytearray:
        """Return the message with these values, in the order of the parts."""
        message, at = self._template.copy(), 0
        for run, offset, count in self._runs:
            run.pack_into(message, offset, *values[at : at + count])
            at += count
        return message

    def _pad(self, size: int) -> None:
        self._template += bytes(-len(self._template) % size)


MAP, ODOM, BASE, LASER = "map", "odom", "base_link", "laser"
"""Frames by REP 105."""
UNKNOWN = 1e6
"""Variance of what no sensor measures, m^2 or rad^2."""
Edges = tuple[tuple[str, str], ...]
"""Parent and child frame of each transform of a message."""

MOUNTED, DRIVEN, MAPPED = ((BASE, LASER),), ((ODOM, BASE),), ((ODOM, BASE), (MAP, ODOM))
"""Parents and children of the transforms: the sensor's mount, the odometry, and the map."""
Message = tuple[str, float, bytearray]
"""Topic, stamp in seconds, and CDR of a message."""

TIME, POSE = "iI", "ddddddd"
DIAGONAL: tuple[str | tuple[str, int], ...] = ("d", ("d", 3), "d", ("d", 3), "d")
"""Covariance of three independent values."""
DIAGONAL_6: tuple[str | tuple[str, int], ...] = ("d", *(part for _ in range(5) for part in (("d", 6), "d")))
"""Covariance of six independent values: x, y, z, roll, pitch, yaw."""
NO_ATTITUDE = (0.0, 0.0, 0.0, 1.0, -1.0)
"""Quaternion and first covariance of a message without attitude, as `sensor_msgs/Imu` defines it."""
_CLOCK = Layout(TIME)
_POSE = Layout(TIME, MAP.encode(), POSE)
_ODOMETRY = Layout(TIME, ODOM.encode(), BASE.encode(), POSE, *DIAGONAL_6, "dddddd", *DIAGONAL_6)
_IMU = Layout(TIME, BASE.encode(), "dddd", *DIAGONAL, "ddd", *DIAGONAL, "ddd", *DIAGONAL)
_IMU_RAW = Layout(TIME, BASE.encode(), "ddddd", ("d", 8), "ddd", *DIAGONAL, "ddd", *DIAGONAL)
_SCAN = Layout(TIME, LASER.encode(), "fffffff", "I")
_MAP = Layout(TIME, MAP.encode(), TIME, "fII", POSE, "I")
_NO_INTENSITIES = bytes(4)
_POINT_TYPES = {np.dtype("<u2"): 4, np.dtype("<f4"): 7}
_POINTS = Layout(
    TIME,
    LASER.encode(),
    "III",
    *(part for name in POINT.names or () for part in (name.encode(), "IBI")),
    "BIII",
)
_POINT_FIELDS = [
    value for field in (POINT.fields or {}).values() for value in (field[1], _POINT_TYPES[field[0]], 1)
]


@dataclass(frozen=True, kw_only=True)
class SensorErrors:
    """Standard deviations of a robot's sensors, for the covariances of a bag; 0 = unknown.

    Attributes:
        scale: Scale of distances by wheels, correlated over `scale_length`.
        scale_length: Correlation length of the scale, meters.
        rate: White noise of each rate in each update, rad/s.
        rate_bias: Constant error of each rate, rad/s.
        update: Time from update to update, seconds.
        attitude: Roll and pitch, radians.
        acceleration: Each acceleration, m/s^2.
    """

    scale: float = 0.0
    scale_length: float = 1.0
    rate: float = 0.0
    rate_bias: float = 0.0
    update: float = 0.0
    attitude: float = 0.0
    acceleration: float = 0.0

    def pose_variances(self, distance: float, seconds: float) -> tuple[float, ...]:
        """Return variances of x, y, z, roll, pitch, yaw of odometry after a straight drive, m^2 and rad^2.

        Distances have a first-order Gauss-Markov scale error, yaws white noise and a bias.
        """
        length = self.scale_length
        correlated = distance - length * (1 - math.exp(-distance / length))
        along = 2 * self.scale**2 * length * correlated
        yaw = self.rate**2 * self.update * seconds + (self.rate_bias * seconds) ** 2
        across = yaw * distance**2 / 3
        return max(along, across), max(along, across), UNKNOWN, UNKNOWN, UNKNOWN, yaw

    def velocity_variances(self, velocity: tuple[float, float, float]) -> tuple[float, ...]:
        """Return variances of a velocity (forward, leftward, m/s, and yaw rate, rad/s), as of a pose."""
        vx, vy, _ = velocity
        rate = self.rate**2 + self.rate_bias**2
        return (self.scale * vx) ** 2, (self.scale * vy) ** 2, UNKNOWN, UNKNOWN, UNKNOWN, rate


NO_ERRORS = SensorErrors()


def nanoseconds(stamp: float) -> int:
    """Convert seconds to nanoseconds, at least 1: tf2 reads 0 as the latest time."""
    return max(1, round(stamp * 1e9))


def laser_scan(scan: LaserScan, period: float) -> bytearray:
    """Return `sensor_msgs/LaserScan`; the period from scan to scan is in seconds."""
    n = len(scan.ranges)
    angles = scan.angle_min, scan.angle_min + scan.angle_increment * (n - 1), scan.angle_increment
    limits = scan.range_min, scan.range_max
    message = _SCAN.pack(*_time(scan.stamp), *angles, scan.time_increment, period, *limits, n)
    return message + scan.ranges.astype("<f4", copy=False).tobytes() + _NO_INTENSITIES


def point_cloud(cloud: PointCloud) -> bytearray:
    """Return `sensor_msgs/PointCloud2` in the laser's frame; an organized cloud has a row per ring."""
    organized = cloud.column is not None
    points = cloud.organized() if organized else cloud.records()[None]
    (rows, columns), step = points.shape, POINT.itemsize
    fields = (len(_POINT_FIELDS) // 3, *_POINT_FIELDS)
    sizes = step, columns * step, points.size * step
    message = _POINTS.pack(*_time(cloud.stamp), rows, columns, *fields, 0, *sizes)
    is_dense = rows * columns == len(cloud)
    return message + points.tobytes() + bytes([is_dense])


def imu(reading: Imu, stamp: float, errors: SensorErrors = NO_ERRORS) -> bytearray:
    """Return `sensor_msgs/Imu` in base_link; the yaw is 0 with the variance of an unknown yaw."""
    rate = errors.rate**2 + errors.rate_bias**2
    q = Pose3.from_rpy(0.0, 0.0, 0.0, reading.roll, reading.pitch, 0.0)
    return _IMU.pack(
        *_time(stamp),
        *(q.qx, q.qy, q.qz, q.qw),
        *(errors.attitude**2, errors.attitude**2, UNKNOWN),
        *reading.angular_velocity,
        *(rate, rate, rate),
        *reading.linear_acceleration,
        *3 * (errors.acceleration**2,),
    )


def imu_raw(readings: ImuReadings) -> Iterator[Message]:
    """Yield `sensor_msgs/Imu` in base_link, without attitude, of each reading."""
    of_rates, of_force = (3 * (sigma**2,) for sigma in (readings.rate_sigma, readings.acceleration_sigma))
    columns = readings.stamps, readings.angular_velocity, readings.linear_acceleration
    for stamp, rates, force in zip(*(column.tolist() for column in columns), strict=True):
        message = _IMU_RAW.pack(*_time(stamp), *NO_ATTITUDE, *rates, *of_rates, *force, *of_force)
        yield "/imu/data_raw", stamp, message


def transforms(stamp: float, edges: Edges, poses: tuple[Pose3, ...]) -> bytearray:
    """Return `tf2_msgs/TFMessage` with `T_parent_child` of each edge."""
    time = _time(stamp)
    values: list[float] = [len(edges)]
    for T in poses:
        values += (*time, *_pose(T))
    return _transforms_layout(edges).pack(*values)


def occupancy_grid(stamp: float, grid: OccupancyGrid) -> bytearray:
    """Return `nav_msgs/OccupancyGrid`: 100 occupied, 0 free, -1 unknown, by map_saver's thresholds."""
    p = grid.probability
    cells = np.full(p.shape, -1, np.int8)
    cells[p < FREE], cells[p > OCCUPIED] = 0, 100
    rows, cols = grid.shape
    time, origin = _time(stamp), _pose(Pose3.from_pose2(grid.origin))
    return _MAP.pack(*time, *time, grid.resolution, cols, rows, *origin, cells.size) + cells.tobytes()


def body_velocity(before: Pose2, after: Pose2, seconds: float) -> tuple[float, float, float]:
    """Return the mean velocity between two poses, in the midway axes: m/s, m/s, rad/s."""
    step = before.inverse() @ after
    c, s = math.cos(step.yaw / 2), math.sin(step.yaw / 2)
    return (c * step.x + s * step.y) / seconds, (c * step.y - s * step.x) / seconds, step.yaw / seconds


@cache
def _transforms_layout(edges: Edges) -> Layout:
    parts: list[str | bytes] = ["I"]
    for parent, child in edges:
        parts += [TIME, parent.encode(), child.encode(), POSE]
    return Layout(*parts)


def _time(stamp: float) -> tuple[int, int]:
    return divmod(nanoseconds(stamp), 1_000_000_000)


def _pose(T: Pose3) -> tuple[float, ...]:
    """Return position and quaternion in ROS's order xyzw."""
    return T.x, T.y, T.z, T.qx, T.qy, T.qz, T.qw


@dataclass(frozen=True, kw_only=True, slots=True)
class BagTick:
    """The sensor data of one scan, as messages hold them.

    Attributes:
        odometry: `T_odom_base`.
        truth: `T_map_base`, from the simulator; the map frame is the first base pose in the plane.
        estimate: `T_map_base`, a mapper's pose estimate; None = no transform from map to odom.
        cloud: Cloud of a lidar with rings in its place; None for a planar lidar.
        inertial: Readings near 200 Hz since the previous scan.
        odometry_track: Stamps and `T_odom_base` since the previous scan.
    """

    scan: LaserScan
    odometry: Pose2
    imu: Imu
    truth: Pose3
    estimate: Pose2 | None = None
    cloud: PointCloud | None = None
    inertial: ImuReadings | None = None
    odometry_track: Sequence[tuple[float, Pose2]] = ()


class TickMessages:
    """The messages of consecutive scans of a drive."""

    def __init__(self, period: float, errors: SensorErrors = NO_ERRORS) -> None:
        self._period, self._errors = period, errors
        self._driven, self._seconds, self._begun = 0.0, 0.0, False
        self._odometry: tuple[float, Pose2] | None = None

    def of(self, tick: BagTick) -> Iterator[Message]:
        """Yield the messages of the next scan; transforms precede measurements."""
        scan, t = tick.scan, tick.scan.stamp
        if not self._begun:
            yield "/tf_static", t, transforms(t, MOUNTED, (scan.T_base_laser,))
            self._begun = True
        if tick.inertial is not None:
            yield from imu_raw(tick.inertial)
        for stamp, T_odom_base in tick.odometry_track:
            frames = transforms(stamp, DRIVEN, (Pose3.from_pose2(T_odom_base),))
            yield from self._driven_to(stamp, T_odom_base, frames)
        driven = Pose3.from_pose2(tick.odometry)
        if tick.estimate is None:
            frames = transforms(t, DRIVEN, (driven,))
        else:
            T_map_odom = Pose3.from_pose2(tick.estimate @ tick.odometry.inverse())
            frames = transforms(t, MAPPED, (driven, T_map_odom))
        yield from self._driven_to(t, tick.odometry, frames)
        yield "/imu", t, imu(tick.imu, t, self._errors)
        yield "/scan", t, laser_scan(scan, self._period)
        if tick.cloud is not None:
            yield "/points", tick.cloud.stamp, point_cloud(tick.cloud)
        yield "/ground_truth", t, _POSE.pack(*_time(t), *_pose(tick.truth))

    def _driven_to(self, stamp: float, T_odom_base: Pose2, frames: bytearray) -> Iterator[Message]:
        """Yield clock, transforms and odometry, with the velocity since the previous odometry; 0 at first."""
        velocity, errors = (0.0, 0.0, 0.0), self._errors
        if self._odometry is not None:
            seconds = stamp - self._odometry[0]
            velocity = body_velocity(self._odometry[1], T_odom_base, seconds)
            self._driven += seconds * math.hypot(velocity[0], velocity[1])
            self._seconds += seconds
        pose, (vx, vy, omega) = _pose(Pose3.from_pose2(T_odom_base)), velocity
        variances = errors.pose_variances(self._driven, self._seconds), errors.velocity_variances(velocity)
        self._odometry = stamp, T_odom_base
        yield "/clock", stamp, _CLOCK.pack(*_time(stamp))
        yield "/tf", stamp, frames
        twist = vx, vy, 0.0, 0.0, 0.0, omega
        yield "/odom", stamp, _ODOMETRY.pack(*_time(stamp), *pose, *variances[0], *twist, *variances[1])


@dataclass(frozen=True, kw_only=True)
class BagDrive:
    """The content of a bag: at least one scan, and the mapper's map in the map frame."""

    ticks: Sequence[BagTick]
    grid: OccupancyGrid | None = None
    errors: SensorErrors = NO_ERRORS

    @property
    def period(self) -> float:
        """Median time from scan to scan, seconds; 0 for a single scan."""
        steps = np.diff([tick.scan.stamp for tick in self.ticks])
        return float(np.median(steps)) if len(steps) else 0.0
