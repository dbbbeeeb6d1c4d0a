"""State of a client, as its messages tell it: command, frames, map, requests."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from lirs_envs.robots.robot import Robot, Twist
from lirs_extensions.live.graph import MAP_TYPE, START_POSE, TRANSFORMS_TYPE, TWIST, TWIST_STAMPED, typestore
from lirs_extensions.live.middleware import Received
from lirs_extensions.live.options import LiveOptions
from lirs_wct import ConfigError, OccupancyGrid, Pose2, Pose3, Trajectory
from lirs_wct.formats.rosbag import frames, messages

STOPPED_AFTER = 0.5
"""Simulated seconds after which a robot without new commands stops, as ros2_control's diff drive does."""


class Client:
    """Receiver of a client's messages.

    Damaged messages are ignored with one warning per topic.

    Attributes:
        grid: last map, in the client's map frame; None = none.
        start: pose of a requested new start in the client's map frame; None = no new pose was requested.
        reset: whether a new start was requested.
        ended: whether the user ended the drive.
        messages: number of messages received.

    Args:
        options: distribution, answers, and how often an answer is expected.
        robot: Robot with its speed limits.
        period: from scan to scan, seconds.
        T_map_start: start pose in the client's map frame; the odometry begins there.
    """

    def __init__(self, options: LiveOptions, robot: Robot, period: float, T_map_start: Pose2) -> None:
        self._store: Any = typestore(options.ros)
        self._answer, self._robot = options.answer, robot
        self._patience = max(STOPPED_AFTER, 2 * options.every * period)
        self._command, self._commanded = Twist(), -math.inf
        self._frames, self._added = frames.Frames(), 0
        self._T_map_start, self._maps = T_map_start, False
        self._T_map_odom = Pose3.from_pose2(T_map_start)
        self._warned: set[str] = set()
        self.grid: OccupancyGrid | None = None
        self.start: Pose2 | None = None
        self.reset, self.ended, self.messages = False, False, 0

    def take(self, received: Sequence[Received], time: float) -> int:
        """Take in messages; return the latest stamp that answers a scan, nanoseconds; 0 = none.

        Args:
            received: in order of arrival.
            time: present simulated time, seconds.
        """
        answered = 0
        for topic, cdr in received:
            self.messages += 1
            try:
                message = self._store.deserialize_cdr(cdr, topic.kind)
                answered = max(answered, self._take(topic.kind, message, time))
            except Exception as error:  # of any kind: the bytes are another program's
                if topic.name not in self._warned:
                    self._warned.add(topic.name)
                    warnings.warn(f"{topic.name}: a message is damaged and ignored: {error}", stacklevel=2)
        return answered

    def command(self, time: float) -> Twist:
        """Return the robot's command; it stops where the last one is too old."""
        return self._command if time - self._commanded <= self._patience else Twist()

    def estimate(self, T_odom_base: Pose2) -> Pose3:
        """Return `T_map_base` by the latest transform map -> odom; without one, the odometry."""
        return self._T_map_odom @ Pose3.from_pose2(T_odom_base)

    def drove(self, stamp: float, T_odom_base: Pose2) -> None:
        """Note the odometry at a scan, for the trajectory."""
        message = messages.transforms(stamp, messages.DRIVEN, (Pose3.from_pose2(T_odom_base),))
        self._frames.add(self._line(), self._store.deserialize_cdr(message, TRANSFORMS_TYPE), static=False)

    def trajectory(self) -> Trajectory:
        """Return `T_map_base` at the stamps of scans, of transforms interpolated as in tf2.

        Without map -> odom, return the odometry.
        """
        found = self._frames.trajectory(messages.BASE)
        return found if self._maps else found.moved(self._T_map_start)

    def _line(self) -> int:
        self._added += 1
        return self._added

    def _take(self, kind: str, message: Any, time: float) -> int:
        if kind in (TWIST, TWIST_STAMPED):
            twist = message.twist if kind == TWIST_STAMPED else message
            self._command, self._commanded = self._legal(twist), time
            stamped = kind == TWIST_STAMPED and self._answer != "tf"
            return _nanoseconds(message.header.stamp) if stamped else 0
        if kind == TRANSFORMS_TYPE:
            return self._take_frames(message)
        if kind == MAP_TYPE:
            self.grid = read_grid(message)
            return 0
        if kind == START_POSE:
            self.start = frames.pose_of(message.pose.pose.position, message.pose.pose.orientation).to_pose2()
        self.reset = True
        return 0

    def _take_frames(self, message: Any) -> int:
        answered = 0
        for t in message.transforms:
            if (t.header.frame_id.lstrip("/"), t.child_frame_id.lstrip("/")) != (messages.MAP, messages.ODOM):
                continue
            T = frames.pose_of(t.transform.translation, t.transform.rotation)
            if not frames.is_finite(T):
                raise ConfigError("map -> odom is not finite")
            self._T_map_odom, self._maps = T, True
            if self._answer != "cmd_vel":
                answered = _nanoseconds(t.header.stamp)
            self._frames.add(self._line(), type(message)([t]), static=False)
        return answered

    def _legal(self, twist: Any) -> Twist:
        """Return a finite command within the robot's limits."""
        v, omega, climb = twist.linear.x, twist.angular.z, twist.linear.z
        if not all(map(math.isfinite, (v, omega, climb))):
            raise ConfigError("the command is not finite")
        most, turn = self._robot.max_speed, self._robot.max_turn_rate
        flown = float(climb) if self._robot.flies else 0.0
        return Twist(float(np.clip(v, -most, most)), float(np.clip(omega, -turn, turn)), flown)


def read_grid(message: Any) -> OccupancyGrid:
    """Return the grid of a `nav_msgs/OccupancyGrid`: -1 unknown, 0 to 100 percent occupied.

    Raises:
        ConfigError: its size does not match its data.
    """
    info = message.info
    if info.width * info.height != len(message.data):
        raise ConfigError(f"{info.width} x {info.height} cells, but {len(message.data)} values")
    cells = np.asarray(message.data, np.int8).reshape(info.height, info.width)
    p = np.where(cells < 0, np.nan, cells / 100.0)
    origin = frames.pose_of(info.origin.position, info.origin.orientation).to_pose2()
    return OccupancyGrid.from_probability(p, float(info.resolution), origin)


def _nanoseconds(stamp: Any) -> int:
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
