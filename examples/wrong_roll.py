"""A mapper with the wrong sign of the roll, which a floor does not show; `falsify` finds terrain that does.

lirs-wct validate examples/data/office.yaml --mapper examples.wrong_roll:WrongRoll --seconds 60
lirs-wct falsify --mapper examples.wrong_roll:WrongRoll --reference hector --limits examples/only_ground.yaml
"""

from __future__ import annotations

from dataclasses import replace

from lirs_wct import Imu, LaserScan, Pose2
from slam_baselines.hector import HectorMapper


class WrongRoll(HectorMapper):
    """HectorSLAM's method with the sign of the roll wrong."""

    def update(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        """Map a scan with the robot's roll mirrored."""
        return super().update(scan, odometry, imu and replace(imu, roll=-imu.roll))
