"""Which topics of a bag hold what."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from lirs_wct.errors import SourceError

SCAN, ODOMETRY, IMU = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry", "sensor_msgs/msg/Imu"
"""Types of the messages that are read."""


@dataclass(frozen=True)
class Topics:
    """Names as the user says them.

    Attributes:
        scan: None = the only topic of laser scans.
        odometry: None = the only topic of odometry, else /tf.
        imu: None = inertial readings are left alone.
    """

    scan: str | None = None
    odometry: str | None = None
    imu: str | None = None

    def found(self, path: Path, kinds: Mapping[str, str]) -> tuple[str, str | None, str | None]:
        """Return the topics of scans, odometry (None = /tf) and inertial readings (None = none).

        Args:
            path: of the bag.
            kinds: type of each topic in it.

        Raises:
            SourceError: one is not there, or is of another type, or several could be meant.
        """
        scans, odometry = _of(kinds, SCAN), _of(kinds, ODOMETRY)
        if self.scan is None and len(scans) != 1:
            raise SourceError(f"{path}: --scan-topic must say which; {_listed(kinds)}")
        scan = _checked(path, "--scan-topic", self.scan or scans[0], SCAN, kinds)
        given = self.odometry or (odometry[0] if len(odometry) == 1 else None)
        return (
            scan,
            None if given is None else _checked(path, "--odom-topic", given, ODOMETRY, kinds),
            None if self.imu is None else _checked(path, "--imu-topic", self.imu, IMU, kinds),
        )


def _of(kinds: Mapping[str, str], kind: str) -> list[str]:
    return [name for name, held in kinds.items() if held == kind]


def _checked(path: Path, flag: str, name: str, kind: str, kinds: Mapping[str, str]) -> str:
    if kinds.get(name) != kind:
        raise SourceError(f"{path}: {flag} {name}: no topic of {kind} has that name; {_listed(kinds)}")
    return name


def _listed(kinds: Mapping[str, str]) -> str:
    listed = ", ".join(f"{name} ({kind})" for name, kind in sorted(kinds.items()))
    return f"there are: {listed}" if listed else "it holds no message"
