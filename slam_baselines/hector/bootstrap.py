"""Start-up refinement: the map built again from the start with what is known by now about ground and walls.

On uneven ground nothing is known to be a wall at first, so the robot begins on odometry alone and the
first scans enter at poses that are a little wrong; the map would keep that error for ever. After some
metres most of the walls that the first scans saw are known, and so is the odometry's calibration: they fit
to each other as well as all later ones.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lirs_wct.errors import ConfigError
from lirs_wct.geometry.pose import Pose2
from slam_baselines.hector.keyframes import Keyframe
from slam_baselines.mapping.map_builder import MapBuilder
from slam_baselines.matching.registration import Registration
from slam_baselines.motion.dead_reckoning import DeadReckoning, PoseEstimate


@dataclass(frozen=True, kw_only=True)
class BootstrapConfig:
    """When the map is built again.

    Attributes:
        first: after so many metres, and then whenever the distance has doubled ...
        last: ... up to this many metres.

    Raises:
        ConfigError: not 0 < first.
    """

    first: float = 4.0
    last: float = 40.0

    def __post_init__(self) -> None:
        if not self.first > 0:
            raise ConfigError(f"first of the bootstrap must be above 0 m, got {self.first}")


class Bootstrap:
    """Keeps the first keyframes and lays them into a new map when it is due.

    Attributes:
        refinements: how often that was done.
    """

    def __init__(self, config: BootstrapConfig) -> None:
        self.refinements = 0
        self._config = config
        self._next = config.first
        self._keyframes: list[Keyframe] = []

    @property
    def over(self) -> bool:
        """Whether the map will not be built again."""
        return self._next > self._config.last

    def note(self, keyframe: Keyframe, distance_traveled: float) -> bool:
        """Keep a keyframe while it may be needed; return whether a refinement is due."""
        if self.over:
            self._keyframes.clear()
            return False
        self._keyframes.append(keyframe)
        return distance_traveled >= self._next

    def refine(
        self, builder: MapBuilder, registration: Registration, reckoning: DeadReckoning
    ) -> list[Pose2]:
        """Build the map again, with the odometry as it is now known; return the keyframes' new poses."""
        self.refinements += 1
        self._next *= 2
        builder.restart()
        estimate, before = PoseEstimate(self._keyframes[0].pose, np.zeros((3, 3))), None
        frames: list[Keyframe] = []
        for frame in self._keyframes:
            last = estimate.pose
            if before is not None:
                estimate = _expected(estimate, before, frame, reckoning)
            min_slopes = builder.min_slopes(frame.scan, estimate.pose, frame.height, frame.min_slopes)
            if before is not None:
                weights = builder.weights(min_slopes)
                estimate, _ = registration.register(builder.pyramid, frame.scan.hits, weights, estimate, last)
            builder.enter_again(frame.scan, estimate.pose, frame.height, min_slopes)
            frames.append(replace(frame, pose=estimate.pose, min_slopes=min_slopes))
            before = frame
        self._keyframes = frames
        return [frame.pose for frame in frames]


def _expected(
    estimate: PoseEstimate, before: Keyframe, now: Keyframe, reckoning: DeadReckoning
) -> PoseEstimate:
    """Go from one keyframe to the next by dead reckoning; without odometry as they were found at first."""
    predict, seconds = reckoning.config.predict, now.scan.stamp - before.scan.stamp
    if not now.moves or None in now.moves:
        return predict(estimate, before.pose.inverse() @ now.pose, seconds)
    for move in filter(None, now.moves):
        delta = move.corrected(reckoning.calibration)
        estimate = predict(estimate, delta, seconds / len(now.moves), delta.yaw, move.tilt)
    return estimate
