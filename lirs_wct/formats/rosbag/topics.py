"""Topics of a bag: those that are written, and the choice of those that are read."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from lirs_wct.errors import SourceError

TOPICS = {
    "/clock": "rosgraph_msgs/msg/Clock",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/odom": "nav_msgs/msg/Odometry",
    "/imu": "sensor_msgs/msg/Imu",
    "/imu/data_raw": "sensor_msgs/msg/Imu",
    "/scan": "sensor_msgs/msg/LaserScan",
    "/points": "sensor_msgs/msg/PointCloud2",
    "/ground_truth": "geometry_msgs/msg/PoseStamped",
    "/map": "nav_msgs/msg/OccupancyGrid",
}
"""Topics and their types; a bag has only topics with messages."""
MAP_TOPIC = "/map"
LATCHED = ("/tf_static", MAP_TOPIC)
"""Topics whose last message also reaches late subscribers."""

MULTI_ECHO = "sensor_msgs/msg/MultiEchoLaserScan"
SCAN, ODOMETRY, IMU = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry", "sensor_msgs/msg/Imu"
"""Types of the messages that are read as a log."""
CLOUD = "sensor_msgs/msg/PointCloud2"
PATH = "nav_msgs/msg/Path"
POSES = (ODOMETRY, "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped", PATH)
"""Types of the messages that hold poses."""
ANY = "any"
"""Stands for the only topic of its type, if there is one."""
NAMES = {False: "laser scans", True: "point clouds"}
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
"""Types of the messages that hold transforms; the second is of old ROS 1."""


@dataclass(frozen=True)
class Topics:
    """Names of topics from the user.

    Attributes:
        scan: Topic of laser scans; None = the only one.
        odometry: Topic of odometry; None = the only one, else /tf.
        imu: Topic of inertial readings; None = they are not read, ANY = the only one.
        clouds: Whether point clouds are read instead of laser scans.
        others: Names of the mappers for the other kind of data, for messages.
    """

    scan: str | None = None
    odometry: str | None = None
    imu: str | None = None
    clouds: bool = False
    others: str = ""

    def choose(self, path: Path, kinds: Mapping[str, str]) -> tuple[str, str | None, str | None]:
        """Return the topics of scans, odometry (None = /tf) and inertial readings (None = none)."""
        odometry = of_kinds(kinds, (ODOMETRY,))
        planar = of_kinds(kinds, (SCAN,)) or of_kinds(kinds, (MULTI_ECHO,))
        clouds = of_kinds(kinds, (CLOUD,))
        scans, others = (clouds, planar) if self.clouds else (planar, clouds)
        if self.scan is None and not scans:
            wanted, held = NAMES[self.clouds], NAMES[not self.clouds]
            fitting = f"; --mapper {self.others} read its {held}" if others and self.others else ""
            raise SourceError(f"{path}: holds no topic of {wanted}{fitting}; {list_topics(kinds)}")
        if self.scan is None and len(scans) > 1:
            raise SourceError(f"{path}: --scan-topic must say which; {list_topics(kinds)}")
        legal = (CLOUD,) if self.clouds else (SCAN, MULTI_ECHO)
        scan = require_topic(path, "--scan-topic", self.scan or scans[0], legal, kinds)
        if len(odometry) > 1:  # of several robots, that of the scans
            odometry = [name for name in odometry if _namespace(name) == _namespace(scan) != "/"]
        inertial = of_kinds(kinds, (IMU,))
        imu = self.imu if self.imu != ANY else inertial[0] if len(inertial) == 1 else None
        given = self.odometry or (odometry[0] if len(odometry) == 1 else None)
        return (
            scan,
            None if given is None else require_topic(path, "--odom-topic", given, (ODOMETRY,), kinds),
            None if imu is None else require_topic(path, "--imu-topic", imu, (IMU,), kinds),
        )


def of_robot(scan: str, topics: Sequence[str]) -> list[str]:
    """Return the topics in the namespaces around the scans'; all if there are none."""
    around = [name for name in topics if _namespace(scan).startswith(_namespace(name))]
    return around or list(topics)


def _namespace(topic: str) -> str:
    return f"/{topic.lstrip('/')}".rpartition("/")[0] + "/"


def of_kinds(kinds: Mapping[str, str], wanted: Collection[str]) -> list[str]:
    """Return the topics of some types."""
    return [name for name, kind in kinds.items() if kind in wanted]


def require_topic(path: Path, flag: str, name: str, wanted: Collection[str], kinds: Mapping[str, str]) -> str:
    """Return the name of an existing topic of one of the types."""
    if kinds.get(name) not in wanted:
        types = " or ".join(wanted)
        raise SourceError(f"{path}: {flag} {name}: no topic of {types} has that name; {list_topics(kinds)}")
    return name


def list_topics(kinds: Mapping[str, str]) -> str:
    """Return the list of a bag's topics for messages."""
    topics = ", ".join(f"{name} ({kind})" for name, kind in sorted(kinds.items()))
    return f"there are: {topics}" if topics else "it holds no message"
