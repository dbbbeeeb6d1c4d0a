"""A laser log of any file format: scans in file order, odometry, inertial readings."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from lirs_wct.arrays import BoolArray, FloatArray
from lirs_wct.geometry import Imu, ImuReadings, LaserScan, PointCloud, Pose2, Trajectory


@dataclass(frozen=True)
class LineStamps:
    """Stamps of every used line, in file order.

    Attributes:
        logged: (n,) seconds, as in the file.
        repaired: (n,) seconds, rising; equal to `logged` where no repair was needed.
        scans: (n,) whether a line holds a scan.
    """

    logged: FloatArray
    repaired: FloatArray
    scans: BoolArray

    @property
    def back(self) -> int:
        """Count of steps between lines at which the stamp decreases."""
        return int((np.diff(self.logged) < 0).sum())

    @property
    def repeated(self) -> int:
        """Count of steps between lines at which the stamp repeats."""
        return int((np.diff(self.logged) == 0).sum())

    @property
    def moved(self) -> int:
        """Count of lines with a repaired stamp."""
        return int((self.repaired != self.logged).sum())

    @property
    def furthest(self) -> float:
        """Largest change of a stamp by the repair, seconds."""
        return float(np.abs(self.repaired - self.logged).max(initial=0.0))

    def repaired_at(self, stamps: FloatArray) -> FloatArray:
        """Return (m,) repaired stamps: each moves like the nearest line, scans preferred."""
        order = np.lexsort((~self.scans, self.logged))
        logged, shift = self.logged[order], (self.repaired - self.logged)[order]
        after = np.clip(np.searchsorted(logged, stamps), 0, len(logged) - 1)
        before = np.maximum(after - 1, 0)
        nearest = np.where(stamps - logged[before] < logged[after] - stamps, before, after)
        moved: FloatArray = stamps + shift[nearest]
        return moved

    def summary(self) -> str:
        """Return one line about faults of the stamps and their repair."""
        steps = f"{len(self.logged) - 1:,}"
        return (
            f"stamps go back at {self.back:,} of {steps} steps and repeat at {self.repeated:,}: "
            f"the order of the file is kept, {self.moved:,} stamps moved by up to {self.furthest:.2f} s"
        )


@dataclass(frozen=True, eq=False)
class LogTopic:
    """Messages of one topic, or of one name in a CARMEN log.

    Attributes:
        name: Name of the topic.
        frames: Frames of its messages; of poses "parent -> child".
        stamps: (n,) Stamps in the order of the log, seconds.
        received: (n,) Times of reception, seconds; empty where unknown.
    """

    name: str
    frames: tuple[str, ...]
    stamps: FloatArray
    received: FloatArray


@dataclass(frozen=True)
class LaserLog:
    """A laser log in file order.

    Attributes:
        scans: planar scans in file order; their stamps increase strictly.
        odometry: `T_odom_base` of each scan, as many as scans; all None where the log holds no odometry.
        track: every pose that the log's odometry gives, of messages with and without a scan; may be empty.
        lines: stamps of the lines as logged and as repaired; scans and track have the repaired ones.
        skipped: count of skipped lines by reason.
        late: lines whose logged stamp is before that of an earlier line.
        repaired: count of repairs by kind.
        laser: message name of the scans.
        left_out: scans of the file that could not be used and are not in `scans`.
        clouds: point clouds in place of scans, read one by one; None of a log of planar scans.
        imu: inertial readings with attitude that the log itself holds; a CARMEN log holds none.
        inertial: all of its inertial readings, with or without attitude, by stamp; None = none.
        topics: Topics of the scans, of the odometry, and of the inertial readings, as far as they exist.
    """

    scans: tuple[LaserScan, ...]
    odometry: tuple[Pose2 | None, ...]
    track: Trajectory
    lines: LineStamps
    skipped: Mapping[str, int] = field(default_factory=dict)
    late: int = 0
    repaired: Mapping[str, int] = field(default_factory=dict)
    laser: str = "FLASER"
    left_out: int = 0
    clouds: Iterable[PointCloud] | None = None
    imu: tuple[Imu, ...] = ()
    inertial: ImuReadings | None = None
    topics: tuple[LogTopic, ...] = ()

    @property
    def stamps(self) -> FloatArray:
        """(n,) stamps of the scans or clouds, seconds."""
        return self.lines.repaired[self.lines.scans]
