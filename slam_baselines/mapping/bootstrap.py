"""Start-up refinement: renewed registration of the first keyframes on uneven ground.

On uneven ground no wall is known at first. So the robot starts on odometry alone, and the first scans enter
the map at poses with a small error that the map would keep. After some meters most walls in the first scans
are
known: a new map is built from them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np

from lirs_wct.checks import Checked, limited
from slam_baselines.mapping.keyframe import Keyframe
from slam_baselines.motion.dead_reckoning import PoseEstimate

K = TypeVar("K", bound=Keyframe[Any])
Register = Callable[[K, "K | None", PoseEstimate], PoseEstimate]
"""A method's registration of a keyframe in the new map, which it enters there.

Called with the keyframe, the one registered before it (None for the first, which keeps its pose) and
the estimate of that one; returns the estimate of the keyframe.
"""


@dataclass(frozen=True, kw_only=True)
class BootstrapConfig(Checked, of="the bootstrap"):
    """Distances at which the start is refined.

    Attributes:
        first: distance traveled at the first refinement, meters; the next are due at 2, 4, 8 ... times that.
        last: distance after which there is none, meters.
    """

    first: float = limited(4.0, "(0, inf]", "m")
    last: float = limited(40.0, "(0, inf]", "m")


class Bootstrap(Generic[K]):
    """Schedule of the refinements, and their keyframes.

    Attributes:
        keyframes: the first ones; empty when the last refinement is over.
        refinements: number of refinements.
    """

    def __init__(self, config: BootstrapConfig) -> None:
        self.keyframes: list[K] = []
        self.refinements = 0
        self._last = config.last
        self._next = config.first
        self._distance = 0.0

    @property
    def over(self) -> bool:
        """Whether there will be no more refinement."""
        return self._next > self._last or self._next == math.inf

    def add(self, keyframe: K, distance_traveled: float) -> bool:
        """Keep a keyframe while it may be needed; return whether a refinement is due."""
        if self.over or distance_traveled > self._last:
            self.close()
            return False
        self.keyframes.append(keyframe)
        self._distance = distance_traveled
        return distance_traveled >= self._next

    def replace(self, keyframes: Sequence[K]) -> None:
        """Replace the keyframes by refined ones; all refinements due so far are done."""
        self.keyframes = list(keyframes)
        self.refinements += 1
        while self._next <= self._distance:
            self._next *= 2

    def close(self) -> None:
        """End the refinements."""
        self.keyframes.clear()
        self._next = math.inf


def register_forwards(keyframes: Sequence[K], register: Register[K]) -> list[PoseEstimate]:
    """Register keyframes from the fixed first one to the last; return their estimates."""
    before, estimates = None, [PoseEstimate(keyframes[0].pose, np.zeros((3, 3)))]
    for keyframe in keyframes:
        estimates.append(register(keyframe, before, estimates[-1]))
        before = keyframe
    return estimates[1:]


def register_backwards(keyframes: Sequence[K], register: Register[K]) -> list[PoseEstimate]:
    """Register keyframes from the last to the first.

    So the new map grows from known walls.

    Returns:
        Estimates of the keyframes, moved such that the first keeps its pose.
    """
    estimates = register_forwards(keyframes[::-1], register)[::-1]
    T_new_old = keyframes[0].pose @ estimates[0].pose.inverse()
    return [PoseEstimate(T_new_old @ e.pose, e.covariance) for e in estimates]
