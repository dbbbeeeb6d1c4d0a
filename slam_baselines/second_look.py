"""The second look: the map built again, from the start, with what is known by now about ground and walls.

On uneven ground nothing is known to be a wall at first, so the robot begins on odometry alone and the
first scans enter at poses that are a little wrong; the map would keep that error for ever. After some
metres most of what the first scans saw is proven, and then they fit to each other as well as all later ones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lirs_wct.errors import ConfigError
from lirs_wct.pose import Pose2
from slam_baselines.keyframes import Keyframe
from slam_baselines.map_builder import MapBuilder
from slam_baselines.odometry import Estimate, MotionConfig
from slam_baselines.registration import Registration


@dataclass(frozen=True, kw_only=True)
class SecondLookConfig:
    """When to look again.

    Attributes:
        first: after so many metres, and then whenever the way has doubled ...
        last: ... up to this many metres.

    Raises:
        ConfigError: not 0 < first.
    """

    first: float = 4.0
    last: float = 40.0

    def __post_init__(self) -> None:
        if not self.first > 0:
            raise ConfigError(f"first of the second look must be above 0 m, got {self.first}")


class SecondLook:
    """Keeps the first keyframes and lays them into a new map when it is due.

    Attributes:
        looks: how often that was done.
    """

    def __init__(self, config: SecondLookConfig) -> None:
        self.looks = 0
        self._config = config
        self._next = config.first
        self._keyframes: list[Keyframe] = []

    def note(self, keyframe: Keyframe, travelled: float) -> bool:
        """Keep a keyframe while it may be needed; return whether it is time to look again."""
        if self._next > self._config.last:
            self._keyframes.clear()
            return False
        self._keyframes.append(keyframe)
        return travelled >= self._next

    def look(self, builder: MapBuilder, registration: Registration, motion: MotionConfig) -> list[Pose2]:
        """Build the map again; return the keyframes' new poses."""
        self.looks += 1
        self._next *= 2
        builder.restart()
        last = self._keyframes[0]
        estimate, poses, moved = Estimate(last.pose, np.zeros((3, 3))), [last.pose], []
        builder.enter_again(last.scan, last.pose, last.height)
        for frame in self._keyframes[1:]:
            delta, before = last.pose.inverse() @ frame.pose, estimate.pose
            expected = motion.predict(estimate, delta, frame.scan.stamp - last.scan.stamp, delta.yaw)
            weights = builder.weights(frame.scan, expected.pose, frame.height)
            estimate, _ = registration.fit(builder.pyramid, frame.scan.hits, weights, expected, before)
            builder.enter_again(frame.scan, estimate.pose, frame.height)
            poses.append(estimate.pose)
            last = frame
        self._keyframes = [
            Keyframe(frame.scan, pose, frame.height)
            for frame, pose in zip(self._keyframes, poses, strict=True)
        ]
        return poses
