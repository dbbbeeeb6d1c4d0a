"""What is told about a loop that was closed."""

from __future__ import annotations

from dataclasses import dataclass

from lirs_wct.geometry.pose import Pose2


@dataclass(frozen=True, slots=True)
class LoopEvent:
    """A scan that was found again in an older piece of the map, and believed.

    Attributes:
        stamp: of the scan, seconds.
        seen: when that piece of the map was begun, seconds.
        before: `T_map_base` where the map had the scan when the loop was believed.
        after: `T_map_base` where the loop puts it.
        score: mean occupancy at the ends of its beams there, 0 to 1.
    """

    stamp: float
    seen: float
    before: Pose2
    after: Pose2
    score: float

    @property
    def distance(self) -> float:
        """How far the loop moves the scan, metres."""
        return self.before.distance(self.after)
