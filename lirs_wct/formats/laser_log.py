"""A laser log, whatever file it was read from: scans in the order of the file, odometry, readings."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from lirs_wct.arrays import BoolArray, FloatArray
from lirs_wct.geometry.cloud import PointCloud
from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.scan import Imu, LaserScan
from lirs_wct.geometry.trajectory import Trajectory


@dataclass(frozen=True)
class LineStamps:
    """Stamps of every line that is used, in the order of the file.

    Attributes:
        logged: (n,) seconds, as the lines have them.
        repaired: (n,) seconds, rising; the same where nothing had to be repaired.
        scans: (n,) whether a line holds a scan.
    """

    logged: FloatArray
    repaired: FloatArray
    scans: BoolArray

    @property
    def back(self) -> int:
        """Steps from line to line in which the stamps go back."""
        return int((np.diff(self.logged) < 0).sum())

    @property
    def repeated(self) -> int:
        """Steps from line to line in which they stand still."""
        return int((np.diff(self.logged) == 0).sum())

    @property
    def moved(self) -> int:
        """Lines whose stamp was repaired."""
        return int((self.repaired != self.logged).sum())

    @property
    def furthest(self) -> float:
        """By how much at most, seconds."""
        return float(np.abs(self.repaired - self.logged).max(initial=0.0))

    def repaired_at(self, stamps: FloatArray) -> FloatArray:
        """Return (m,) logged stamps as repaired: each moves as the line nearest to it; scans come first."""
        order = np.lexsort((~self.scans, self.logged))
        logged, shift = self.logged[order], (self.repaired - self.logged)[order]
        after = np.clip(np.searchsorted(logged, stamps), 0, len(logged) - 1)
        before = np.maximum(after - 1, 0)
        nearest = np.where(stamps - logged[before] < logged[after] - stamps, before, after)
        moved: FloatArray = stamps + shift[nearest]
        return moved

    def summary(self) -> str:
        """Return what was wrong and what was done about it, one line."""
        steps = f"{len(self.logged) - 1:,}"
        return (
            f"stamps go back at {self.back:,} of {steps} steps and repeat at {self.repeated:,}: "
            f"the order of the file is kept, {self.moved:,} stamps moved by up to {self.furthest:.2f} s"
        )


@dataclass(frozen=True)
class LaserLog:
    """A log as read, in the order of the file.

    Attributes:
        scans: in the order of the file; their stamps increase strictly.
        odometry: `T_odom_base` of each scan, as many as scans; all None where the log holds no odometry.
        track: every pose that the log's odometry gives, of messages with and without a scan; may be empty.
        lines: stamps of the lines as logged and as repaired; scans and track have the repaired ones.
        skipped: how many lines were left out, by reason.
        late: lines whose logged stamp is before that of an earlier line.
        repaired: how often something was put right, by what.
        laser: name of the messages that the scans are from.
        left_out: scans of the file that could not be used and are not in `scans`.
        clouds: point clouds in place of scans, read one by one; None of a log of planar scans.
        imu: inertial readings that the log itself holds; a CARMEN log holds none.
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

    @property
    def stamps(self) -> FloatArray:
        """(n,) seconds, of the scans or clouds."""
        return self.lines.repaired[self.lines.scans]
