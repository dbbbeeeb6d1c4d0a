"""The clouds of a drive that are kept for its elevation map."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from lirs_wct.arrays import BoolArray
from lirs_wct.geometry.cloud import PointCloud

MOST = 240
"""Clouds that are kept at a time, some 100 MB of them; beyond, every second one is dropped."""


@dataclass
class CloudSample:
    """Clouds spread evenly over a drive, however long it is: one a second, on longer drives fewer.

    Attributes:
        clouds: that are kept, without the points on walkers.
        scans: number of the scan that each belongs to.
        period: seconds from one to the next.
    """

    clouds: list[PointCloud] = field(default_factory=list)
    scans: list[int] = field(default_factory=list)
    period: float = 1.0

    def offer(self, scan: int, cloud: PointCloud, walkers: BoolArray | None = None) -> None:
        """Keep a cloud if it is due.

        Args:
            scan: its number; each larger than the last.
            cloud: of that scan.
            walkers: (n,) which of its points lie on a walker.
        """
        if self.clouds and cloud.stamp < self.clouds[-1].stamp + self.period - 1e-9:
            return
        self.clouds.append(cloud if walkers is None else without(cloud, walkers))
        self.scans.append(scan)
        if len(self.clouds) > MOST:
            self.clouds, self.scans, self.period = self.clouds[::2], self.scans[::2], 2 * self.period


def without(cloud: PointCloud, points: BoolArray) -> PointCloud:
    """Return a cloud without some of its points, (n,)."""
    kept = ~points
    return replace(cloud, xyz=cloud.xyz[kept], ring=cloud.ring[kept], time=cloud.time[kept])
