"""Start-up refinement: the first metres on uneven ground, matched again once walls are known.

At first nothing is known to be a wall, so the filter follows the odometry and the first scans enter at
poses that are a little wrong; every map would keep that. So the first processed scans are kept, and after
some metres one new map is built from them with the slopes known by now: from the last to the first, so that
it grows from where walls are known. What the walls and the gyro disagree about in the long run is the
gyro's bias, and the next round is made without it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from lirs_wct.arrays import ByteArray, FloatArray
from lirs_wct.geometry.pose import Pose2, wrap_angle
from slam_baselines.common.se2 import in_axes_of
from slam_baselines.gmapping.copy_on_write_map import PatchMaps
from slam_baselines.gmapping.likelihood_field import Beams
from slam_baselines.gmapping.proposal import Proposer
from slam_baselines.mapping.ground_filter import GroundFilter
from slam_baselines.motion.increment import unbiased
from slam_baselines.scan.leveling import LeveledScan

FIRST = 2.0
"""Distance traveled at the first refinement, metres; the next ones come whenever it has doubled ..."""
LAST = 40.0
"""... up to this many metres."""
ROUNDS = 2
"""How often the bias is estimated each time: a round sees only the part that the prior did not pull along."""
BIAS = math.radians(0.05)
"""Standard deviation of a gyro's bias before anything is known, rad/s."""
HEADING = math.radians(0.3)
"""Standard deviation of the heading at which a scan is laid into the map, radians."""


@dataclass(frozen=True, slots=True)
class Frame:
    """A processed scan.

    Attributes:
        scan: leveled.
        step: `T_before_now` by odometry and gyro as they are.
        covariance: (3, 3) of the step.
        seconds: of the step, spent moving.
        height: of the base in the map frame, metres.
        min_slopes: (n,) of its hits, SLOPE_STEP.
    """

    scan: LeveledScan
    step: Pose2
    covariance: FloatArray
    seconds: float
    height: float
    min_slopes: ByteArray


class Bootstrap:
    """Keeps the first processed scans, and lays them into a new map when it is due.

    Attributes:
        times: how often that was done.
        bias: of the gyro, rad/s.
    """

    def __init__(self) -> None:
        self.refinements = 0
        self.bias = 0.0
        self._next = FIRST
        self._closed = False
        self._frames: list[Frame] = []

    @property
    def open(self) -> bool:
        """Whether frames are still kept."""
        return not self._closed

    def note(self, frame: Frame, distance_traveled: float) -> bool:
        """Keep a frame while it may be needed; return whether a refinement is due."""
        if max(self._next, distance_traveled) > LAST:
            self._closed = True
            self._frames.clear()
            return False
        self._frames.append(frame)
        return distance_traveled >= self._next

    def refine(self, maps: PatchMaps, proposer: Proposer, ground_filter: GroundFilter) -> list[Pose2]:
        """Draw the frames into an empty map of one particle; return their poses."""
        self.refinements += 1
        self._next *= 2
        wall_slope = ground_filter.match_wall_slope
        for _ in range(ROUNDS):
            poses = self._backwards(PatchMaps(1, maps.resolution), proposer, ground_filter)
            self._learn(poses)
        for i, (frame, pose) in enumerate(zip(self._frames, poses, strict=True)):
            min_slopes = _min_slope(frame, pose, ground_filter)
            _draw(maps, frame, pose, min_slopes, wall_slope)
            self._frames[i] = replace(frame, min_slopes=min_slopes)
        return poses

    def _backwards(self, maps: PatchMaps, proposer: Proposer, ground_filter: GroundFilter) -> list[Pose2]:
        """Match the frames from the last to the first; return where they are, the first at the origin."""
        frames, wall_slope = self._frames, ground_filter.match_wall_slope
        path = self._reckoned()
        pose, found = path[-1], [path[-1]]
        _draw(maps, frames[-1], pose, _min_slope(frames[-1], pose, ground_filter), wall_slope)
        for i in range(len(frames) - 2, -1, -1):
            step = path[i + 1].inverse() @ path[i]
            pose = pose @ step
            covariance = in_axes_of(pose.inverse(), frames[i + 1].covariance)
            pose = _matched(frames[i], pose, covariance, maps, proposer, ground_filter)
            _draw(maps, frames[i], pose, _min_slope(frames[i], pose, ground_filter), wall_slope)
            found.append(pose)
        T_new_old = found[-1].inverse()
        return [T_new_old @ pose for pose in reversed(found)]

    def _reckoned(self) -> list[Pose2]:
        """Return the poses by odometry and gyro, less the bias."""
        path = [Pose2()]
        for frame in self._frames[1:]:
            path.append(path[-1] @ unbiased(frame.step, self.bias, frame.seconds))
        return path

    def _learn(self, poses: list[Pose2]) -> None:
        """Correct the bias by the trend of what the matched headings differ from the reckoned ones."""
        t = np.cumsum([0.0, *(frame.seconds for frame in self._frames[1:])])
        off = np.array([wrap_angle(p.yaw - r.yaw) for p, r in zip(poses, self._reckoned(), strict=True)])
        t, off = t - t.mean(), off - off.mean()
        # Maximum a posteriori; the trend is of the bias that is left.
        pull = self.bias / BIAS**2
        self.bias -= float((t @ off / HEADING**2 + pull) / (t @ t / HEADING**2 + 1 / BIAS**2))


def _min_slope(frame: Frame, pose: Pose2, ground_filter: GroundFilter) -> ByteArray:
    """Return (n,) the minimum slopes of the frame's hits as known by now."""
    return ground_filter.min_slopes(frame.scan, pose, frame.height, known=frame.min_slopes)


def _draw(maps: PatchMaps, frame: Frame, pose: Pose2, min_slopes: ByteArray, wall_slope: int) -> None:
    points = frame.scan.transformed(Pose2(), frame.height)
    maps.enter(pose.as_array()[None], points, min_slopes, wall_slope)


def _matched(
    frame: Frame,
    expected: Pose2,
    covariance: FloatArray,
    maps: PatchMaps,
    proposer: Proposer,
    ground_filter: GroundFilter,
) -> Pose2:
    """Return where the frame fits into the map so far; the expected pose if nowhere."""
    drawn = partial(maps.min_slope, 0)
    slopes = ground_filter.min_slopes(frame.scan, expected, frame.height, known=frame.min_slopes, drawn=drawn)
    view, weights = maps.view(0, ground_filter.match_wall_slope), ground_filter.wall_weights(slopes)
    found = proposer.track(view, Beams(frame.scan.hits, weights), expected.as_array(), covariance)
    return expected if found is None else Pose2(*found.tolist())
