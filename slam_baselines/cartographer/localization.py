"""Pure localisation: where the robot is in a map that is given and stays as it is.

Hess et al. 2016 with the map in the place of the submaps: branch and bound over the whole map finds the
robot, then each scan is matched from where dead reckoning puts it. A place that looks like another one is
not believed; the search is made again when the robot has moved on.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from lirs_wct.arrays import FloatArray
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.scan import Imu, LaserScan
from lirs_wct.geometry.trajectory import Trajectory
from slam_baselines.cartographer.config import LocalisationConfig
from slam_baselines.cartographer.constraints.builder import voxel_filter
from slam_baselines.cartographer.known_map import KnownMap
from slam_baselines.common.stopwatch import Stopwatch
from slam_baselines.mapper import MapperStats
from slam_baselines.matching.branch_and_bound import Exclusion, Window, branch_and_bound
from slam_baselines.matching.gauss_newton import Match, Prior, ScanMatcher
from slam_baselines.matching.registration import Registration, RegistrationConfig
from slam_baselines.matching.tracking import TrackingMonitor
from slam_baselines.motion.dead_reckoning import DeadReckoning, MotionConfig, PoseEstimate
from slam_baselines.scan.leveling import LeveledScan, ScanLeveler


@dataclass
class _Counts:
    received: int = 0
    matched: int = 0
    lost: int = 0
    searches: int = 0
    ambiguous: int = 0


@dataclass
class _Track:
    """Poses of all scans; those before the first fix are in a frame of their own until it comes."""

    scans: dict[float, Pose2] = field(default_factory=dict)

    def anchor(self, T_map_before: Pose2) -> None:
        self.scans = {stamp: T_map_before @ pose for stamp, pose in self.scans.items()}


class Localiser:
    """A mapper that maps nothing: it says where the robot is in a known map.

    Its map frame is that of the known map, not the first base pose.
    """

    def __init__(
        self,
        known: KnownMap,
        start: Pose2 | None,
        config: LocalisationConfig,
        registration: RegistrationConfig,
        motion: MotionConfig,
        leveler: ScanLeveler,
    ) -> None:
        """Begin at `start` (`T_map_base`); None: anywhere in the map."""
        self.config = config
        self._known = known
        self._registration, self._refiner = Registration(registration), ScanMatcher(registration.match)
        self._reckoning = DeadReckoning(motion)
        self._leveler = leveler
        metres, radians = config.start
        self._loose = np.diag((metres**2, metres**2, radians**2))
        self._located = self._anchored = start is not None
        self._estimate = PoseEstimate(start or Pose2(), self._loose)
        self._tracking = TrackingMonitor(config.tracking, map_given=True)
        self._searched: tuple[float, float] | None = None
        self._distance_traveled = 0.0
        self._track, self._counts, self._stopwatch = _Track(), _Counts(), Stopwatch()

    def update(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        """Match the scan to the map, or search for it where the place is unknown; return `T_map_base`.

        While `lost`, the answer is dead reckoning from the last place known, at first from the map's origin.
        """
        started, counts = self._stopwatch.start(), self._counts
        counts.received += 1
        level = self._leveler.level(scan, imu)
        before = self._estimate.pose
        self._estimate = self._reckoning.predict(self._estimate, odometry, imu, scan.stamp)
        if not self._located and self._search_due(scan.stamp):
            self._search(level)
        if self._located:
            self._fit(level, before)
        self._distance_traveled += before.distance(self._estimate.pose)
        self._track.scans[scan.stamp] = self._estimate.pose
        counts.lost += self.lost
        self._stopwatch.stop(started)
        return self._estimate.pose

    def map(self) -> OccupancyGrid:
        """Return the known map as it was given."""
        return self._known.grid

    def trajectory(self) -> Trajectory:
        """Return the pose of every scan; those before the first fix are led back from it by odometry."""
        stamps = sorted(self._track.scans)
        return Trajectory.from_poses(stamps, [self._track.scans[t] for t in stamps])

    @property
    def lost(self) -> bool:
        """Whether the robot's place in the map is unknown."""
        return not self._located

    @property
    def stats(self) -> MapperStats:
        """What was done so far."""
        c = self._counts
        return MapperStats(
            received=c.received,
            used=c.matched,
            skipped={"not matched": c.received - c.matched},
            lost=c.lost,
            memory=self._known.nbytes,
            counts={
                "global_searches": c.searches,
                "global_searches_ambiguous": c.ambiguous,
                "searches": self._registration.searches,
            },
            **self._stopwatch.summary(),
        )

    def _fit(self, scan: LeveledScan, before: Pose2) -> None:
        self._estimate, match = self._registration.register(
            self._known.pyramid, scan.hits, None, self._estimate, before
        )
        self._counts.matched += match is not None
        if match is not None:
            self._tracking.observe(match.score, match.known)
        else:
            self._tracking.observe(None)
        self._located = not self._tracking.lost

    def _search_due(self, stamp: float) -> bool:
        """Whether there is something new to search with since the last search."""
        c, last = self.config, self._searched
        return last is None or self._distance_traveled - last[0] >= c.every or stamp - last[1] >= c.seconds

    def _search(self, scan: LeveledScan) -> None:
        """Search the whole map; take over the place found if it is the only one."""
        c, known = self.config, self._known
        sparse = voxel_filter(scan.hits, known.bounds.resolution, c.beams)
        if len(sparse) < c.min_beams:
            return
        self._counts.searches += 1
        self._searched = self._distance_traveled, scan.stamp
        start, window = np.array((*known.centre, 0.0)), Window(known.reach, math.pi)
        found = branch_and_bound(known.bounds, sparse, start, window, c.min_score, c.bounded)
        if found.score < 0:
            return
        least = c.rival * found.score
        other = branch_and_bound(
            known.bounds, sparse, start, window, least, c.bounded, Exclusion(found.pose, c.apart)
        )
        best, second = self._refined(scan, found.pose), None
        if other.score >= 0:
            best, second = sorted((best, self._refined(scan, other.pose)), key=lambda match: -match.score)
        if not (found.complete and other.complete) or (second and second.score >= c.rival * best.score):
            self._counts.ambiguous += 1
            return
        self._locate(Pose2(*best.pose.tolist()))

    def _refined(self, scan: LeveledScan, pose: FloatArray) -> Match:
        """Return where the scan fits on the finest level near a pose of the search."""
        return self._refiner.match(self._known.pyramid, scan.hits, None, Prior(pose, self._loose), levels=3)

    def _locate(self, pose: Pose2) -> None:
        if not self._anchored:
            self._track.anchor(pose @ self._estimate.pose.inverse())
            self._anchored = True
        self._estimate, self._located = PoseEstimate(pose, self._loose), True
        self._tracking = TrackingMonitor(self.config.tracking, map_given=True)
