"""Inertial readings for a log, and the laser's mount for leveling."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from lirs_validation.config import MapConfig
from lirs_validation.metrics.alignment import MAX_GAP, associated
from lirs_wct.errors import SourceError
from lirs_wct.formats.carmen.laser import read_mount
from lirs_wct.formats.drive_csv import read_imu
from lirs_wct.formats.laser_log import LaserLog
from lirs_wct.geometry import Imu


def inertial_readings(config: MapConfig, log: LaserLog) -> list[Imu | None]:
    """Return the inertial reading at each scan.

    None without a file, or without a reading within 0.02 s.

    Raises:
        SourceError: the file cannot be used, or has no reading at any scan.
    """
    readings: list[Imu | None] = [None] * len(log.stamps)
    held = log.imu if config.imu is None else read_imu(Path(config.imu))
    if not held:
        return readings
    found = sorted(held, key=lambda reading: reading.stamp)
    stamps = np.array([reading.stamp for reading in found])
    for scan, reading in zip(*associated(log.stamps, stamps), strict=True):
        readings[scan] = found[reading]
    if not any(readings):
        raise SourceError(
            f"{config.imu or config.imu_topic}: other stamps: none of its {len(found)} readings lies "
            f"within {MAX_GAP} s of one of the log's {len(log.stamps)} scans"
        )
    return readings


def with_recorded_mount(config: MapConfig, log: LaserLog) -> LaserLog:
    """Return the log with the laser mount of the file's comment.

    It includes the height and the tilt.
    """
    T_base_laser = read_mount(Path(config.log))
    if T_base_laser is None:
        return log
    return replace(log, scans=tuple(replace(scan, T_base_laser=T_base_laser) for scan in log.scans))
