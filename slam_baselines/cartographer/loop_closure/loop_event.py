"""A closed loop, for users who want to follow loop closure."""

from __future__ import annotations

from dataclasses import dataclass

from lirs_wct.geometry.pose import Pose2


@dataclass(frozen=True, slots=True)
class LoopEvent:
    """A scan that was matched to an older submap, and accepted.

    Attributes:
        stamp: of the scan, seconds.
        seen: stamp of the submap's first scan, seconds.
        before: `T_map_base` of the scan before the loop was closed.
        after: `T_map_base` of the scan according to the loop.
        score: mean occupancy at the ends of its beams there, 0 to 1.
    """

    stamp: float
    seen: float
    before: Pose2
    after: Pose2
    score: float

    @property
    def distance(self) -> float:
        """Distance by which the loop moves the scan, meters."""
        return self.before.distance(self.after)
