"""Where the wall-clock time of a simulation goes."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field

from lirs_wct.geometry.pose import Pose3


@dataclass
class Timing:
    """Wall-clock seconds of each `advance`: in MuJoCo's step, and in all sensors."""

    physics: array[float] = field(default_factory=lambda: array("d"))
    sensors: array[float] = field(default_factory=lambda: array("d"))


@dataclass(frozen=True)
class PhysicsReplay:
    """The recorded controls through MuJoCo's step alone.

    Attributes:
        seconds: wall-clock time.
        simulated: simulated time, seconds.
        T_world_base: last pose.
    """

    seconds: float
    simulated: float
    T_world_base: Pose3

    @property
    def rtf(self) -> float:
        """Simulated seconds over wall-clock seconds."""
        return self.simulated / self.seconds
