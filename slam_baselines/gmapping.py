"""GMapping's way: a Rao-Blackwellized particle filter whose proposal has seen the newest scan.

Grisetti, Stachniss, Burgard 2007, "Improved Techniques for Grid Mapping with Rao-Blackwellized Particle
Filters", written from the paper: every particle is a path with the map that follows from it; algorithm 1
is GmappingMapper._process.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lirs_wct.errors import ConfigError
from lirs_wct.grid import OccupancyGrid
from lirs_wct.pose import Pose2
from lirs_wct.scan import Imu, LaserScan
from lirs_wct.trajectory import Trajectory
from slam_baselines.levelling import LevelledScan, ScanLeveller
from slam_baselines.lineage import Lineage
from slam_baselines.mapper import MapperStats, Stopwatch
from slam_baselines.odometry import DeadReckoning, Estimate, MotionConfig
from slam_baselines.particle_filter import effective_number, normalised, systematic_resample
from slam_baselines.patch_map import PatchMaps
from slam_baselines.proposal import Proposal, ProposalConfig, Proposer
from slam_baselines.relief import Relief, ReliefConfig
from slam_baselines.retrace import Frame, Retrace

Array = NDArray[np.float64]
NO_STEP = Estimate(Pose2(), np.zeros((3, 3)))


@dataclass(frozen=True, kw_only=True)
class GmappingConfig(ProposalConfig):
    """Parameters of gmapping where they exist.

    Attributes:
        particles: how many paths are followed.
        seed: of the random numbers.
        linearUpdate: metres to drive before the next scan is processed.
        angularUpdate: radians to turn before the next scan is processed.
        resampleThreshold: particles are drawn anew when N_eff falls below this share of them.
        srr: error of the odometry in translation after one metre, metres.
        srt: ... in translation after one radian, metres.
        str: ... in rotation after one metre, radians.
        stt: ... in rotation after one radian, radians.
        ogain: likelihoods are taken to the power 1 / (ogain * particles), so that single scans with
            their correlated beams do not decide alone.
        delta: edge of a map's cell, metres.
        maxUrange: hits farther away are not used, but free up to here, metres. Without it, beams without
            return say nothing.
        lost_score: share of the beams on known cells that must end at a wall, else a scan does not enter
            the maps ...
        lost_after: ... and after so many processed scans in a row the mapper is lost ...
        known_share: ... where at least so many of its beams end on known cells.
        relief: how ground is told from walls.

    Raises:
        ConfigError: a value that is not legal.
    """

    particles: int = 30
    seed: int = 0
    linearUpdate: float = 1.0  # noqa: N815  the original's names
    angularUpdate: float = 0.5  # noqa: N815
    resampleThreshold: float = 0.5  # noqa: N815
    srr: float = 0.05
    srt: float = 0.05
    str: float = 0.05
    stt: float = 0.1
    ogain: float = 0.5
    delta: float = 0.05
    maxUrange: float = math.inf  # noqa: N815
    lost_score: float = 0.3
    lost_after: int = 3
    known_share: float = 0.3
    relief: ReliefConfig = field(default_factory=ReliefConfig)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("particles", "srr", "srt", "str", "stt", "ogain", "delta", "maxUrange", "lost_after"):
            if not getattr(self, name) > 0:
                raise ConfigError(f"{name} must be above 0, got {getattr(self, name)}")
        if min(self.linearUpdate, self.angularUpdate) < 0:
            raise ConfigError("linearUpdate and angularUpdate must not be negative")
        if not 0 <= self.resampleThreshold <= 1:
            raise ConfigError(f"resampleThreshold must be within [0, 1], got {self.resampleThreshold}")

    @property
    def motion(self) -> MotionConfig:
        """The odometry's errors for dead reckoning."""
        return MotionConfig(
            translation_per_metre=self.srr,
            translation_per_radian=self.srt,
            rotation_per_metre=self.str,
            rotation_per_radian=self.stt,
        )


class GmappingMapper:
    """A filter over whole paths; a loop closes when the particles that fit survive."""

    def __init__(self, config: GmappingConfig | None = None) -> None:
        self.config = c = config or GmappingConfig()
        self._rng = np.random.default_rng(c.seed)
        self._leveller = ScanLeveller(c.maxUrange if math.isfinite(c.maxUrange) else 0.0, c.maxUrange)
        self._reckoning = DeadReckoning(c.motion)
        self._proposer = Proposer(c)
        self._relief = Relief(c.relief)
        self._maps = PatchMaps(c.particles, c.delta)
        self._lineage = Lineage()
        self._retrace = Retrace()
        self._reckoned = NO_STEP
        self._poses = np.zeros((c.particles, 3))
        self._parents = np.arange(c.particles)
        self._log_weights, self._totals = np.zeros(c.particles), np.zeros(c.particles)
        self._step, self._way, self._turn = NO_STEP, 0.0, 0.0
        self._reckoned = NO_STEP
        self._settled = False
        self._best = self._received = self._resamplings = self._lost_scans = self._poor_in_a_row = 0
        self._stopwatch = Stopwatch()

    def update(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        """Follow the odometry; where the robot has moved enough, process the scan. Return `T_map_base`.

        Raises:
            ConfigError: there is no odometry.
        """
        if odometry is None:
            raise ConfigError(
                f"gmapping needs odometry with every scan, the one at {scan.stamp} s has none; "
                "hector maps without"
            )
        started = self._stopwatch.start()
        self._received += 1
        level = self._leveller.level(scan, imu)
        self._follow(level, odometry, imu)
        if self._lineage.generations:
            self._track(level)
        if self._due:
            self._process(level)
        self._lineage.add_scan(scan.stamp, self._step.pose)
        self._lost_scans += self.lost
        self._stopwatch.stop(started)
        return self._pose

    def map(self) -> OccupancyGrid:
        """Return the map of the best particle."""
        return self._maps.occupancy_grid(self._best, self._relief.bound)

    def trajectory(self) -> Trajectory:
        """Return the pose of every scan on the path of the best particle."""
        return self._lineage.trajectory(int(self._parents[self._best]))

    @property
    def lost(self) -> bool:
        """Whether so many scans in a row fit nowhere that the pose is not to be believed."""
        return self._poor_in_a_row >= self.config.lost_after

    @property
    def stats(self) -> MapperStats:
        """What was done so far."""
        processed = self._lineage.generations
        return MapperStats(
            received=self._received,
            used=processed,
            skipped={"not moved": self._received - processed},
            lost=self._lost_scans,
            memory=self._maps.nbytes + self._relief.grid.nbytes,
            counts={
                "particles": self.config.particles,
                "resamplings": self._resamplings,
                "searches": self._proposer.searches,
                "patches": self._maps.in_use,
            },
            **self._stopwatch.summary(),
        )

    @property
    def _pose(self) -> Pose2:
        return Pose2(*self._poses[self._best].tolist()) @ self._step.pose

    @property
    def _due(self) -> bool:
        c = self.config
        return self._lineage.generations == 0 or self._way >= c.linearUpdate or self._turn >= c.angularUpdate

    def _follow(self, scan: LevelledScan, odometry: Pose2, imu: Imu | None) -> None:
        """Carry the step since the last processed scan on by odometry."""
        before, here = self._step, self._pose
        sure = Estimate(before.pose, np.zeros((3, 3)))
        self._step = self._reckoning.predict(sure, odometry, imu, scan.stamp)
        # Dead reckoning alone, beside the step that is corrected on the way.
        self._reckoned = Estimate(
            self._reckoned.pose @ before.pose.inverse() @ self._step.pose,
            self._reckoned.covariance + self._step.covariance,
        )
        self._new = self._step.covariance
        delta = before.pose.inverse() @ self._step.pose
        self._way += math.hypot(delta.x, delta.y)
        self._turn += abs(delta.yaw)
        if scan.levelled:
            self._relief.move(here.inverse() @ self._pose, scan)

    def _track(self, scan: LevelledScan) -> None:
        """Correct the step by matching the scan to the best particle's map."""
        bound = self._relief.match_bound
        view, expected = self._maps.view(self._best, bound), self._pose.as_array()
        found = self._proposer.track(view, scan.hits, self._weights(scan, bound), expected, self._new)
        if found is not None:
            best = Pose2(*self._poses[self._best].tolist())
            self._step = Estimate(best.inverse() @ Pose2(*found.tolist()), self._new)

    def _process(self, scan: LevelledScan) -> None:
        """Algorithm 1 of the paper, from line 3 on, for all particles."""
        if self._lineage.generations:
            proposal = self._propose(scan)
            gain = 1 / (self.config.ogain * self.config.particles)
            self._poses = proposal.poses
            self._log_weights += gain * proposal.log_eta
            self._totals += gain * proposal.log_eta
            self._best = int(np.argmax(self._totals))
            self._note_fit(proposal)
        self._lineage.add_generation(self._poses, self._parents, self._step.pose)
        self._parents = np.arange(len(self._poses))
        reckoned = self._reckoned
        self._step, self._reckoned, self._way, self._turn = NO_STEP, NO_STEP, 0.0, 0.0
        if self._poor_in_a_row == 0:
            self._enter(scan, reckoned)
        weights = normalised(self._log_weights)
        if effective_number(weights) < self.config.resampleThreshold * len(weights):
            self._descend(systematic_resample(weights, self._rng))

    def _propose(self, scan: LevelledScan) -> Proposal:
        """Draw the particles' new poses."""
        expected = np.array([(Pose2(*pose) @ self._step.pose).as_array() for pose in self._poses.tolist()])
        c, s, o = np.cos(self._poses[:, 2]), np.sin(self._poses[:, 2]), np.zeros(len(self._poses))
        R = np.stack((c, -s, o, s, c, o, o, o, o + 1), axis=-1).reshape(-1, 3, 3)
        covariances = R @ self._reckoned.covariance @ R.transpose(0, 2, 1)
        bound = self._relief.match_bound
        weights = self._weights(scan, bound)
        return self._proposer.propose(
            self._maps, scan.hits, weights, bound, expected, covariances, self._best, self._rng
        )

    def _weights(self, scan: LevelledScan, bound: int) -> Array:
        """Return (n,) 1 for hits on what is known to be a wall, 0 for those that may be ground."""
        if bound == 0:
            return np.ones(len(scan.hits))
        origin, hits, _ = scan.placed(self._pose, self._relief.height)
        proven = self._relief.steepness(origin, hits, self._pose)
        proven = np.maximum(proven, self._maps.steepness(self._best, hits))
        return (proven >= bound).astype(np.float64)

    def _enter(self, scan: LevelledScan, reckoned: Estimate) -> None:
        """Draw the scan; on uneven ground, go over the first metres again when it is time."""
        steep = self._draw(scan)
        if not scan.levelled:
            return
        frame = Frame(scan, reckoned.pose, reckoned.covariance, self._relief.height, steep)
        if self._retrace.note(frame, self._relief.travelled) and self._relief.match_bound > 0:
            self._go_over()

    def _go_over(self) -> None:
        """Replace all paths and maps of the first metres by one that was traced with better knowledge."""
        maps = PatchMaps(1, self.config.delta)
        path = np.array([pose.as_array() for pose in self._retrace.trace(maps, self._proposer, self._relief)])
        self._lineage.rewrite(path)
        n = self.config.particles
        self._parents, self._best = np.zeros(n, np.int64), 0
        maps.descend(self._parents)
        self._maps, self._poses = maps, np.tile(path[-1], (n, 1))
        self._log_weights, self._totals = np.zeros(n), np.zeros(n)

    def _draw(self, scan: LevelledScan) -> NDArray[np.uint8]:
        """Enter the scan into every particle's map, and into the relief from where the best one is.

        Return what is proven of its hits.
        """
        lift = np.array((0.0, 0.0, self._relief.height))
        if scan.levelled:
            steep = self._relief.observe(*scan.placed(self._pose, self._relief.height), self._pose)
        else:
            steep = self._relief.unproven(len(scan.hits))
        bound = self._relief.match_bound
        self._maps.enter(self._poses, scan.origin + lift, scan.hits + lift, scan.free + lift, steep, bound)
        return steep

    def _descend(self, parents: NDArray[np.int64]) -> None:
        """Replace the particles by copies of those that live on."""
        self._resamplings += 1
        self._maps.descend(parents)
        self._poses, self._parents, self._totals = (
            self._poses[parents],
            self._parents[parents],
            self._totals[parents],
        )
        self._log_weights[:] = 0
        self._best = int(np.argmax(self._totals))

    def _note_fit(self, proposal: Proposal) -> None:
        """Count the scans in a row that do not fit the best particle's map."""
        known = proposal.known[self._best] > self.config.known_share
        poor = known and proposal.met[self._best] < self.config.lost_score
        # Before the first good match nothing is known that a scan could contradict.
        self._settled |= known and not poor
        self._poor_in_a_row = self._poor_in_a_row + 1 if poor and self._settled else 0
