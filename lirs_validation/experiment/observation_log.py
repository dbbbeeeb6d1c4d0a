"""What the sensors said over a drive: the numbers in memory, the ranges in a file once they are many."""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Sequence
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from typing import overload

import numpy as np

from lirs_envs.sensing.sensors import Observation
from lirs_wct.arrays import Float32Array, FloatArray
from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.rows import Rows
from lirs_wct.geometry.scan import Imu, LaserScan
from lirs_wct.spool import ArraySpool

LIDAR = attrgetter("angle_min", "angle_increment", "range_min", "range_max", "time_increment", "T_base_laser")
"""What all scans of a lidar share."""


class ObservationLog(Sequence[Observation]):
    """A growing sequence of observations of one robot, less their clouds; what comes out is a copy.

    Attributes:
        odometry: of the observations.
        imu: of the observations.

    Args:
        folder: of the file of ranges; None = the system's folder for temporary files.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self._first: LaserScan | None = None
        self._lidar: tuple[object, ...] = ()
        self._ranges = ArraySpool[np.float32](folder)
        self._stamps = array("d")
        self.odometry = Rows.of(Pose2)
        self.imu = Rows(Imu.from_row, attrgetter("row"), 9)

    def append(self, observation: Observation) -> None:
        """Add an observation of the same lidar.

        Raises:
            ValueError: the lidar is another one.
            OutputError: the file of ranges cannot be written.
        """
        scan = observation.scan
        if self._first is None:
            self._first, self._lidar = replace(scan, ranges=scan.ranges[:0]), LIDAR(scan)
        if LIDAR(scan) != self._lidar:
            raise ValueError(f"a drive has one lidar: {self._lidar}, got {LIDAR(scan)}")
        self._ranges.append(scan.ranges)
        self._stamps.append(scan.stamp)
        self.odometry.append(observation.odometry)
        self.imu.append(observation.imu)

    @property
    def stamps(self) -> FloatArray:
        """(n,) stamps of the scans, seconds."""
        return np.array(self._stamps)

    def __len__(self) -> int:
        return len(self._stamps)

    @overload
    def __getitem__(self, index: int) -> Observation: ...
    @overload
    def __getitem__(self, index: slice) -> list[Observation]: ...
    def __getitem__(self, index: int | slice) -> Observation | list[Observation]:
        if isinstance(index, slice):
            return [self[k] for k in range(len(self))[index]]
        scan = self._scan(self._ranges[index], self._stamps[index])
        return Observation(scan, self.odometry[index], self.imu[index])

    def __iter__(self) -> Iterator[Observation]:
        columns = self._ranges, self._stamps, self.odometry, self.imu
        for ranges, stamp, odometry, imu in zip(*columns, strict=True):
            yield Observation(self._scan(ranges, stamp), odometry, imu)

    def _scan(self, ranges: Float32Array, stamp: float) -> LaserScan:
        assert self._first is not None
        return replace(self._first, ranges=ranges, stamp=stamp)
