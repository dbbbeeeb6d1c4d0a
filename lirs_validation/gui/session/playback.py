"""Playback of a drive, finished or in progress: its state at each scan."""

from __future__ import annotations

import math
import zlib
from array import array
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lirs_validation.gui.session.construction import Facts
from lirs_validation.metrics.alignment import rigid_alignment, rms
from lirs_wct import LaserScan, OccupancyGrid, Pose2, Pose3, World
from lirs_wct.arrays import Float32Array, FloatArray

LOG_ODDS = np.array((np.nan, 5.0, -5.0), np.float32)
"""Log-odds of unknown (0), occupied (1) and free cells (-1)."""
ROW = 5
"""Numbers of a scan in the paths: true x, y, z and estimated x, y."""


@dataclass(frozen=True)
class MapSnapshot:
    """Compressed map at one moment of a drive, which may have thousands.

    Attributes:
        time: Seconds since the start.
        shape: Rows and columns.
        resolution: Edge of a cell, meters.
        origin: Pose of the cells in the world frame.
        packed: Compressed cells: occupied, free or unknown.
    """

    time: float
    shape: tuple[int, int]
    resolution: float
    origin: Pose2
    packed: bytes

    @staticmethod
    def of(grid: OccupancyGrid, time: float) -> MapSnapshot:
        """Compress a map in the world frame."""
        cells = grid.occupied.astype(np.int8) - grid.free
        return MapSnapshot(time, grid.shape, grid.resolution, grid.origin, zlib.compress(cells.tobytes(), 1))

    @property
    def grid(self) -> OccupancyGrid:
        """Map in the world frame."""
        cells = np.frombuffer(zlib.decompress(self.packed), np.int8).reshape(self.shape)
        return OccupancyGrid(LOG_ODDS[cells], self.resolution, self.origin)


@dataclass(frozen=True)
class Moment:
    """State of a drive at one scan.

    Attributes:
        time: seconds since the start.
        T_world_base: true pose.
        lidar: (3,) position of the lidar, world frame, meters.
        scan: (n, 3) points that the scan hit, world frame, meters.
        truth: (k, 3) true positions until then, world frame, meters.
        estimate: (k, 2) estimated positions until then, world frame.
        map: the latest one; None before the first.
        facts: figures until then.
        verdict: verdict on the drive so far, after its heading.
    """

    time: float
    T_world_base: Pose3
    lidar: FloatArray
    scan: Float32Array
    truth: FloatArray
    estimate: FloatArray
    map: MapSnapshot | None
    facts: Facts
    verdict: str

    @property
    def errors(self) -> FloatArray:
        """(k,) distances between true and estimated positions, meters."""
        distances: FloatArray = np.linalg.norm(self.truth[:, :2] - self.estimate, axis=1)
        return distances


class Playback:
    """A drive that a page shows scan by scan, finished or in progress.

    Attributes:
        robot: Name of the robot.
        world: World of the drive; None if it is no longer known.
        seconds: Simulated time of the whole drive.
        maps: Snapshots of the map, in the order of their time.
        marks: Seconds and names of events, such as a closed loop, a lost place, a failure.
        rtf: Real-time factor of each simulated second.
        status: State of the drive in words.
        verdict: Verdict on the drive so far, after its heading.
        results: Figures of the whole run; empty while it is driven.
        note: Reason for a missing world; empty without one.
    """

    def __init__(self, robot: str, world: World | None, seconds: float) -> None:
        self.robot, self.world, self.seconds = robot, world, seconds
        self.maps: list[MapSnapshot] = []
        self.marks: list[tuple[float, str]] = []
        self.rtf: list[float] = []
        self.status = self.verdict = self.note = ""
        self.results: Facts = ()
        self._scans: list[LaserScan] = []
        self._poses: list[Pose3] = []
        self._paths = array("d")
        self._curve: list[tuple[float, float, float]] = []

    @property
    def over(self) -> bool:
        """Whether the drive has ended."""
        return True

    def drive_on(self, until: float, time_limit: float) -> None:
        """Continue a drive in progress; a finished run has all its scans.

        Args:
            until: Reading of `time.monotonic` at which the method returns.
            time_limit: Simulated time at which the drive pauses, seconds.
        """

    def add(self, scan: LaserScan, T_world_base: Pose3, estimate: Sequence[float]) -> None:
        """Append a scan with its true pose and its estimated x and y, world frame."""
        self._scans.append(scan)
        self._poses.append(T_world_base)
        self._paths.extend((T_world_base.x, T_world_base.y, T_world_base.z, *estimate))

    @property
    def scans(self) -> int:
        """Number of scans so far."""
        return len(self._scans)

    @property
    def time(self) -> float:
        """Stamp of the last scan, seconds since the start."""
        return self._scans[-1].stamp

    def last_scan(self, time: float) -> int:
        """Return the last scan until a time, seconds since the start."""
        return max(0, bisect_right(self._scans, time + 1e-6, key=lambda scan: scan.stamp) - 1)

    def paths_until(self, scan: int) -> tuple[FloatArray, FloatArray]:
        """Return (k, 3) true and (k, 2) estimated positions until a scan, world frame, meters."""
        paths = np.array(self._paths[: ROW * (scan + 1)]).reshape(-1, ROW)
        return paths[:, :3], paths[:, 3:]

    def rtf_at(self, time: float) -> float:
        """Return the real-time factor of the second that ends at a time; NaN if unknown."""
        return self.rtf[min(int(time - 1e-6), len(self.rtf) - 1)] if self.rtf else math.nan

    def curve(self) -> FloatArray:
        """Return (n, 3) time, ATE until then in meters, and RTF, once a second."""
        for second in range(len(self._curve) + 1, int(self.time + 1e-6) + 1):
            truth, estimate = self.paths_until(self.last_scan(second))
            self._curve.append((second, ate(truth, estimate), self.rtf_at(second)))
        return np.array(self._curve).reshape(-1, 3)

    def moment(self, scan: int) -> Moment:
        """Return the drive at a scan, 0 = before the first motion."""
        reading, T_world_base = self._scans[scan], self._poses[scan]
        truth, estimate = self.paths_until(scan)
        T_world_laser, time = T_world_base @ reading.T_base_laser, reading.stamp
        return Moment(
            time=time,
            T_world_base=T_world_base,
            lidar=T_world_laser.position,
            scan=T_world_laser.apply(reading.points).astype(np.float32),
            truth=truth,
            estimate=estimate,
            map=next((found for found in reversed(self.maps) if found.time <= time + 1e-6), None),
            facts=(
                ("time", f"{time:.1f} of {self.seconds:g} s ({100 * time / self.seconds:.0f} %)"),
                ("RTF", f"{self.rtf_at(time):.1f}" if self.rtf else "-"),
                ("ATE", f"{ate(truth, estimate):.3f} m"),
                ("status", self.status),
                *self.results,
            ),
            verdict=self.verdict,
        )


def ate(truth: FloatArray, estimate: FloatArray) -> float:
    """Return the absolute trajectory error of positions in the plane, meters."""
    aligned = rigid_alignment(estimate, truth[:, :2]).apply(estimate)
    return rms(np.linalg.norm(aligned - truth[:, :2], axis=1))
