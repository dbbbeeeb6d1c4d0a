"""Where the wall-clock time of a simulation goes."""

from __future__ import annotations

from dataclasses import dataclass, field

from lirs_wct.geometry.pose import Pose3


@dataclass
class Timing:
    """Wall-clock seconds of each `advance`: in MuJoCo's step, and in all sensors."""

    physics: list[float] = field(default_factory=list)
    sensors: list[float] = field(default_factory=list)


@dataclass(frozen=True)
class Replay:
    """The recorded controls through MuJoCo's step alone, in `seconds` of wall clock."""

    seconds: float
    simulated: float
    T_world_base: Pose3
