"""Footprints and slope limits of the robots for which start poses are searched."""

from __future__ import annotations

import math
from dataclasses import dataclass

MARGIN = 0.22
"""Free ground beyond a robot's radius at a roomy start, meters."""
TIGHT_MARGIN = 0.15
"""The same without a roomy start, meters; path planning keeps this margin."""
GENTLE = math.radians(12)
"""Steepest ground of a roomy start, radians, even if the robot can drive steeper ground."""


@dataclass(frozen=True)
class Footprint:
    """Size and slope limit of a robot.

    Attributes:
        robot: name of the robot.
        radius: radius of its enclosing circle, meters.
        max_slope: steepest ground that it drives, radians.
    """

    robot: str
    radius: float
    max_slope: float

    @property
    def limits(self) -> tuple[tuple[float, float], ...]:
        """Clearance (meters) and slope (radians) of a roomy start, then of any start."""
        return (
            (round(self.radius + MARGIN, 6), min(self.max_slope, GENTLE)),
            (round(self.radius + TIGHT_MARGIN, 6), self.max_slope),
        )


FOOTPRINTS = (
    Footprint("husky", 0.58, math.radians(25)),
    Footprint("jackal", 0.31, math.radians(30)),
    Footprint("turtlebot3_waffle", 0.26, math.radians(10)),
    Footprint("turtlebot2", 0.18, math.radians(10)),
    Footprint("turtlebot3_burger", 0.14, math.radians(10)),
)
"""Wheeled robots, the largest first, with the values of the robot catalog."""
