"""Values as ROS 2 messages: fields, frames and units as the message definitions have them (REP 103, 105)."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_typestore

from lirs_wct.arrays import FloatArray
from lirs_wct.geometry.grid import FREE, OCCUPIED, OccupancyGrid
from lirs_wct.geometry.pose import Pose2, Pose3
from lirs_wct.geometry.scan import Imu, LaserScan

MAP, ODOM, BASE, LASER = "map", "odom", "base_link", "laser"
"""Frames by REP 105."""
YAW_UNKNOWN = 1e6
"""Variance of a yaw that no sensor measures, rad^2."""
Message = Any
"""A message; rosbags makes the classes when it runs."""


def nanoseconds(stamp: float) -> int:
    """Return a stamp in seconds as ROS holds it."""
    return round(stamp * 1e9)


class Messages:
    """Maker of messages of ROS 2 Jazzy."""

    def __init__(self) -> None:
        self.store = get_typestore(Stores.ROS2_JAZZY)

    def encoded(self, message: Message) -> memoryview:
        """Return a message in CDR."""
        return memoryview(self.store.serialize_cdr(message, message.__msgtype__))

    def clock(self, stamp: float) -> Message:
        """Return `rosgraph_msgs/Clock`."""
        return self._make("rosgraph_msgs/Clock", clock=self._time(stamp))

    def scan(self, scan: LaserScan, period: float) -> Message:
        """Return `sensor_msgs/LaserScan`.

        Args:
            scan: of the lidar.
            period: from scan to scan, seconds.
        """
        return self._make(
            "sensor_msgs/LaserScan",
            header=self._header(scan.stamp, LASER),
            angle_min=scan.angle_min,
            angle_max=scan.angle_min + scan.angle_increment * (len(scan.ranges) - 1),
            angle_increment=scan.angle_increment,
            time_increment=scan.time_increment,
            scan_time=period,
            range_min=scan.range_min,
            range_max=scan.range_max,
            ranges=scan.ranges,
            intensities=np.empty(0, np.float32),
        )

    def imu(self, reading: Imu) -> Message:
        """Return `sensor_msgs/Imu` in base_link; the yaw is 0 with a variance that says "unknown"."""
        covariance = np.zeros(9)
        covariance[8] = YAW_UNKNOWN
        attitude = Pose3.from_rpy(0.0, 0.0, 0.0, reading.roll, reading.pitch, 0.0)
        return self._make(
            "sensor_msgs/Imu",
            header=self._header(reading.stamp, BASE),
            orientation=self._quaternion(attitude),
            orientation_covariance=covariance,
            angular_velocity=self._vector(*reading.angular_velocity),
            angular_velocity_covariance=np.zeros(9),
            linear_acceleration=self._vector(*reading.linear_acceleration),
            linear_acceleration_covariance=np.zeros(9),
        )

    def odometry(self, stamp: float, T_odom_base: Pose2, velocity: FloatArray) -> Message:
        """Return `nav_msgs/Odometry`.

        Args:
            stamp: seconds.
            T_odom_base: pose.
            velocity: (3,) forward, leftward, m/s, and yaw rate, rad/s, of the base.
        """
        vx, vy, omega = velocity.tolist()
        twist = self._make(
            "geometry_msgs/Twist", linear=self._vector(vx, vy, 0.0), angular=self._vector(0.0, 0.0, omega)
        )
        pose = self._make(
            "geometry_msgs/PoseWithCovariance",
            pose=self._pose(Pose3.from_pose2(T_odom_base)),
            covariance=np.zeros(36),
        )
        return self._make(
            "nav_msgs/Odometry",
            header=self._header(stamp, ODOM),
            child_frame_id=BASE,
            pose=pose,
            twist=self._make("geometry_msgs/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
        )

    def pose(self, stamp: float, T_map_base: Pose3) -> Message:
        """Return `geometry_msgs/PoseStamped` in the map frame."""
        return self._make(
            "geometry_msgs/PoseStamped", header=self._header(stamp, MAP), pose=self._pose(T_map_base)
        )

    def transforms(self, stamp: float, edges: dict[tuple[str, str], Pose3]) -> Message:
        """Return `tf2_msgs/TFMessage` of `T_parent_child` by the names of parent and child."""
        return self._make(
            "tf2_msgs/TFMessage",
            transforms=[
                self._make(
                    "geometry_msgs/TransformStamped",
                    header=self._header(stamp, parent),
                    child_frame_id=child,
                    transform=self._make(
                        "geometry_msgs/Transform",
                        translation=self._vector(T.x, T.y, T.z),
                        rotation=self._quaternion(T),
                    ),
                )
                for (parent, child), T in edges.items()
            ],
        )

    def map(self, stamp: float, grid: OccupancyGrid) -> Message:
        """Return `nav_msgs/OccupancyGrid`: 100 occupied, 0 free, -1 unknown, by map_saver's thresholds."""
        p = grid.probability
        cells = np.full(p.shape, -1, np.int8)
        cells[p < FREE], cells[p > OCCUPIED] = 0, 100
        rows, cols = grid.shape
        info = self._make(
            "nav_msgs/MapMetaData",
            map_load_time=self._time(stamp),
            resolution=grid.resolution,
            width=cols,
            height=rows,
            origin=self._pose(Pose3.from_pose2(grid.origin)),
        )
        return self._make(
            "nav_msgs/OccupancyGrid", header=self._header(stamp, MAP), info=info, data=cells.ravel()
        )

    def _make(self, name: str, **fields: Any) -> Message:
        return self._classes[name.replace("/", "/msg/")](**fields)

    @cached_property
    def _classes(self) -> dict[str, Any]:
        return dict(self.store.types)

    def _time(self, stamp: float) -> Message:
        seconds, rest = divmod(nanoseconds(stamp), 1_000_000_000)
        return self._make("builtin_interfaces/Time", sec=seconds, nanosec=rest)

    def _header(self, stamp: float, frame: str) -> Message:
        return self._make("std_msgs/Header", stamp=self._time(stamp), frame_id=frame)

    def _vector(self, x: float, y: float, z: float) -> Message:
        return self._make("geometry_msgs/Vector3", x=x, y=y, z=z)

    def _quaternion(self, pose: Pose3) -> Message:
        return self._make("geometry_msgs/Quaternion", x=pose.qx, y=pose.qy, z=pose.qz, w=pose.qw)

    def _pose(self, pose: Pose3) -> Message:
        point = self._make("geometry_msgs/Point", x=pose.x, y=pose.y, z=pose.z)
        return self._make("geometry_msgs/Pose", position=point, orientation=self._quaternion(pose))


def body_velocity(before: Pose2, after: Pose2, seconds: float) -> FloatArray:
    """Return (3,) the mean velocity between two poses, in the axes half-way: m/s, m/s, rad/s."""
    step = before.inverse() @ after
    c, s = math.cos(step.yaw / 2), math.sin(step.yaw / 2)
    return np.array((c * step.x + s * step.y, c * step.y - s * step.x, step.yaw)) / seconds
