"""How large the robots are that start poses are looked for."""

from __future__ import annotations

import math
from dataclasses import dataclass

MARGIN = 0.22
"""Meters of free ground beyond a robot's radius that a roomy start has."""
TIGHT_MARGIN = 0.15
"""The same where there is no roomy one: what a plan keeps."""
GENTLE = math.radians(12)
"""Steepest ground of a roomy start, radians, where the robot drives steeper ones."""


@dataclass(frozen=True)
class Footprint:
    """What a robot needs of the ground.

    Attributes:
        robot: its name.
        radius: of the circle that holds it, meters.
        max_slope: steepest ground that it drives, radians.
    """

    robot: str
    radius: float
    max_slope: float

    @property
    def limits(self) -> tuple[tuple[float, float], ...]:
        """Clearance (meters) and slope (radians) of a roomy start, then of any."""
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
"""Robots on wheels, the largest first; the figures are those of the robots' catalog."""
