"""The first metres on uneven ground, gone over again once walls can be told from ground.

At first nothing is known to be a wall, so the filter follows the odometry and the first scans enter at
poses that are a little wrong; every map would keep that. So the first processed scans are kept, and after
some metres one new map is built from them, each matched against those before it with what is proven by now.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lirs_wct.pose import Pose2
from slam_baselines.levelling import LevelledScan
from slam_baselines.patch_map import PatchMaps
from slam_baselines.proposal import Proposer
from slam_baselines.relief import Relief

Array = NDArray[np.float64]

FIRST = 2.0
"""Metres after which to go over the way for the first time; then whenever the way has doubled ..."""
LAST = 40.0
"""... up to this many metres."""


@dataclass(frozen=True, slots=True)
class Frame:
    """A processed scan.

    Attributes:
        scan: levelled.
        step: `T_before_now` by dead reckoning.
        covariance: (3, 3) of the step.
        height: of the base in the map frame, metres.
        steep: (n,) what was proven of its hits.
    """

    scan: LevelledScan
    step: Pose2
    covariance: Array
    height: float
    steep: NDArray[np.uint8]


class Retrace:
    """Keeps the first processed scans, and lays them into a new map when it is due.

    Attributes:
        times: how often that was done.
    """

    def __init__(self) -> None:
        self.times = 0
        self._next = FIRST
        self._closed = False
        self._frames: list[Frame] = []

    @property
    def open(self) -> bool:
        """Whether frames are still kept."""
        return not self._closed

    def note(self, frame: Frame, travelled: float) -> bool:
        """Keep a frame while it may be needed; return whether it is time to go over the way."""
        if max(self._next, travelled) > LAST:
            self._closed = True
            self._frames.clear()
            return False
        self._frames.append(frame)
        return travelled >= self._next

    def trace(self, maps: PatchMaps, proposer: Proposer, relief: Relief) -> list[Pose2]:
        """Draw the frames into an empty map of one particle; return their poses."""
        self.times += 1
        self._next *= 2
        bound, pose, poses = relief.match_bound, Pose2(), []
        for i, frame in enumerate(self._frames):
            pose = pose @ frame.step if i else pose
            origin, hits, _ = frame.scan.placed(pose, frame.height)
            steep = np.maximum(frame.steep, relief.steepness(origin, hits, pose))
            if i:
                pose = self._matched(frame, pose, steep, maps, proposer, bound)
            lift = np.array((0.0, 0.0, frame.height))
            scan = frame.scan
            maps.enter(
                pose.as_array()[None], scan.origin + lift, scan.hits + lift, scan.free + lift, steep, bound
            )
            poses.append(pose)
            self._frames[i] = replace(frame, steep=steep)
        return poses

    @staticmethod
    def _matched(
        frame: Frame,
        expected: Pose2,
        steep: NDArray[np.uint8],
        maps: PatchMaps,
        proposer: Proposer,
        bound: int,
    ) -> Pose2:
        """Return where the frame fits into the map so far; the expected pose if nowhere."""
        _, hits, _ = frame.scan.placed(expected, frame.height)
        weights = (np.maximum(steep, maps.steepness(0, hits)) >= bound).astype(np.float64)
        found = proposer.track(
            maps.view(0, bound), frame.scan.hits, weights, expected.as_array(), frame.covariance
        )
        return expected if found is None else Pose2(*found.tolist())
