"""Path following: speed profile and pure pursuit.

Pure pursuit: Coulter, CMU-RI-TR-92-01, 1992.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from lirs_envs.robots.command import Twist
from lirs_validation.driving.paths import SPACING, arc_length, curvature
from lirs_wct.arrays import FloatArray
from lirs_wct.field_validators import require_above
from lirs_wct.geometry import Pose2, wrap_angle


@dataclass(frozen=True, kw_only=True)
class PursuitConfig:
    """Speed limits and pursuit parameters.

    Attributes:
        speed: on straight level ground, m/s.
        turn_rate: largest, rad/s.
        acceleration: along the path, speeding up and braking, m/s^2.
        lookahead: distance of the pursued point when slow, meters; it grows with the speed.
        lookahead_time: seconds of travel added to it.
        turn_in_place: heading error above which the robot stops and turns, radians.
        careful_room: room to blocked cells below which it drives slower, meters.
        careful_speed: share of the speed where there is no room or the ground is steep.
        steep: slope along the path above which the speed falls, radians; lowest at twice the slope.

    Raises:
        ConfigError: a value is not above 0.
    """

    speed: float = 0.8
    turn_rate: float = 1.2
    acceleration: float = 0.6
    lookahead: float = 0.35
    lookahead_time: float = 0.5
    turn_in_place: float = 1.0
    careful_room: float = 0.3
    careful_speed: float = 0.6
    steep: float = math.radians(8)

    def __post_init__(self) -> None:
        require_above(self, 0, *vars(self), of="a pursuit")


def speed_profile(
    points: FloatArray, room: FloatArray, config: PursuitConfig, height: FloatArray | None = None
) -> FloatArray:
    """Return (n,) m/s along a path: slow in bends, narrow places and on slopes.

    Args:
        points: (n, 2) meters, evenly spaced.
        room: (n,) meters to the nearest blocked cell.
        config: limits.
        height: (n,) meters of the ground, where slopes matter.
    """
    bend = curvature(points)
    speed = np.minimum(config.speed, 0.7 * config.turn_rate / np.maximum(bend, 1e-6))
    care = np.clip(room / config.careful_room, 0.0, 1.0)
    if height is not None and len(points) > 1:
        slope = np.abs(np.arctan2(np.gradient(height), np.maximum(np.gradient(arc_length(points)), 1e-6)))
        care = np.minimum(care, np.clip(2.0 - slope / config.steep, 0.0, 1.0))
    speed = np.minimum(speed, config.speed * (config.careful_speed + (1 - config.careful_speed) * care))
    speed = np.maximum(speed, 0.15 * config.speed)
    return _limit_acceleration(speed, config.acceleration)


def _limit_acceleration(speed: FloatArray, acceleration: float) -> FloatArray:
    """Limit acceleration and braking along a path.

    The path ends at rest.
    """
    squared = np.square(speed).tolist()
    gain = 2 * acceleration * SPACING
    squared[-1] = min(squared[-1], gain)
    for k in range(1, len(squared)):
        squared[k] = min(squared[k], squared[k - 1] + gain)
    for k in range(len(squared) - 2, -1, -1):
        squared[k] = min(squared[k], squared[k + 1] + gain)
    profile: FloatArray = np.sqrt(squared)
    return profile


class Pursuit:
    """Follows one path; remembers how far it got.

    Args:
        points: (n, 2) meters, 0.1 m apart, in the frame of the poses.
        speed: (n,) m/s.
        config: how to drive.
    """

    WINDOW = 1.5
    """Meters ahead in which the nearest point of the path is looked for: it never jumps a loop."""

    def __init__(self, points: FloatArray, speed: FloatArray, config: PursuitConfig) -> None:
        self.config = config
        self._x: list[float] = points[:, 0].tolist()
        self._y: list[float] = points[:, 1].tolist()
        self._speed: list[float] = speed.tolist()
        self._at = 0
        self._turning = False
        self.distance = 0.0
        """Meters between the robot and the path, at the last command."""

    @property
    def progress(self) -> float:
        """Meters of path behind the robot."""
        return self._at * SPACING

    @property
    def remaining(self) -> float:
        """Meters of path ahead of the robot."""
        return (len(self._x) - 1 - self._at) * SPACING

    def twist(self, pose: Pose2) -> Twist:
        """Return the command at a pose."""
        c = self.config
        self._advance(pose)
        planned = self._speed[self._at]
        target = self._target(pose, c.lookahead + c.lookahead_time * planned)
        dx, dy = self._x[target] - pose.x, self._y[target] - pose.y
        error = wrap_angle(math.atan2(dy, dx) - pose.yaw)
        # Once it turns in place it goes on until it nearly faces the target.
        self._turning = abs(error) > (0.2 if self._turning else c.turn_in_place)
        if self._turning:
            return Twist(0.0, max(-c.turn_rate, min(c.turn_rate, 2.0 * error)))
        bend = 2 * math.sin(error) / max(math.hypot(dx, dy), 0.5 * c.lookahead)
        v = planned * max(0.3, math.cos(error))
        if abs(v * bend) > c.turn_rate:
            v = c.turn_rate / abs(bend)
        return Twist(v, v * bend)

    def _advance(self, pose: Pose2) -> None:
        """Move on to the nearest point within the window."""
        last = min(len(self._x), self._at + int(self.WINDOW / SPACING) + 1)
        x, y, xs, ys = pose.x, pose.y, self._x, self._y
        best = math.inf
        for k in range(self._at, last):
            dx, dy = xs[k] - x, ys[k] - y
            d = dx * dx + dy * dy
            if d < best - 1e-12:
                best, self._at = d, k
        self.distance = math.sqrt(best)

    def _target(self, pose: Pose2, distance: float) -> int:
        """Return the first point ahead at a distance or more.

        It is at most twice as far along the path.
        """
        last = min(len(self._x) - 1, self._at + max(1, int(2 * distance / SPACING)))
        x, y, xs, ys = pose.x, pose.y, self._x, self._y
        for k in range(self._at, last):
            if math.hypot(xs[k] - x, ys[k] - y) >= distance:
                return k
        return last
