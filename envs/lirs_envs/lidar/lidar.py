"""The laser range finder (LRF): a preset of figures, a mount, and noise on the ranges."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit

from lirs_envs.lidar.deskew import moved_frames
from lirs_envs.lidar.noise import LidarNoise, draws, lidar_noise, measure
from lirs_envs.lidar.presets import LidarPreset
from lirs_envs.lidar.ray_casting import Caster
from lirs_wct.arrays import FloatArray
from lirs_wct.errors import SimulationError
from lirs_wct.geometry.pose import Pose3
from lirs_wct.geometry.scan import LaserScan

OtherRanges = Callable[[FloatArray, FloatArray, float], FloatArray]
"""origin (3,) or origins (n, 3), directions (n, 3), largest range -> (n,) ranges of what the caster does not
hold."""


@dataclass(frozen=True, slots=True)
class Motion:
    """How the base moves while a scan is swept.

    Attributes:
        velocity: of base_link along x, y, z of the base, m/s.
        rates: about x, y, z of the base, rad/s.
    """

    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rates: tuple[float, float, float] = (0.0, 0.0, 0.0)


class Lidar:
    """A laser range finder on a robot in a world.

    Args:
        preset: figures of the device.
        caster: what the beams meet.
        T_base_laser: mount.
        rng: of the noise.
        noise: default: Gaussian with the preset's deviation.
        sweep: whether a scan is spread over the time that the mirror takes; else all beams are cast at once.
            The mirror turns once a period. The first beam is cast at the stamp, the others while the robot
            goes on with the motion that it has then.
    """

    def __init__(
        self,
        preset: LidarPreset,
        caster: Caster,
        T_base_laser: Pose3,
        rng: np.random.Generator,
        noise: LidarNoise | None = None,
        *,
        sweep: bool = False,
    ) -> None:
        self.preset = preset
        self.caster = caster
        self.T_base_laser = T_base_laser
        self.noise = lidar_noise(preset) if noise is None else noise
        self.time_increment = preset.angle_increment / math.tau * preset.period if sweep else 0.0
        self._rng = rng
        angles = preset.angle_min + preset.angle_increment * np.arange(preset.beams)
        beams = np.stack((np.cos(angles), np.sin(angles), np.zeros_like(angles)), axis=1)
        self._beams = beams @ T_base_laser.rotation.T
        self._mount = T_base_laser.position
        self._limits, self._figures = (preset.range_min, preset.range_max), self.noise.figures

    def scan(
        self,
        T_world_base: Pose3,
        stamp: float,
        others: OtherRanges | None = None,
        motion: Motion | None = None,
    ) -> LaserScan:
        """Return the scan from a pose of the robot, with noise.

        Args:
            T_world_base: pose of the robot at the first beam.
            stamp: seconds.
            others: ranges of what MuJoCo's rays meet; the nearer of both counts.
            motion: of the robot; only a sweep needs it. None = at rest.

        Raises:
            SimulationError: the pose is not finite.
        """
        preset = self.preset
        T = T_world_base
        if not all(map(math.isfinite, (T.x, T.y, T.z, T.qw, T.qx, T.qy, T.qz))):
            raise SimulationError(f"the laser's pose must be finite, got {T_world_base}")
        origin, directions = self._rays(T_world_base, motion)
        exact = self.caster.ranges(origin, directions, preset.range_max)
        if others is not None:
            exact = np.minimum(exact, others(origin, directions, preset.range_max))
        normal, uniform = draws(self.noise, preset.beams, self._rng)
        ranges = np.empty(preset.beams, np.float32)
        measure(exact, normal, uniform, self._limits, self._figures, ranges)
        return LaserScan(
            ranges,
            preset.angle_min,
            preset.angle_increment,
            preset.range_min,
            preset.range_max,
            stamp,
            self.T_base_laser,
            self.time_increment,
        )

    def _rays(self, T_world_base: Pose3, motion: Motion | None) -> tuple[FloatArray, FloatArray]:
        """Return origin (3,) or origins (n, 3), and directions (n, 3) of the beams in the world."""
        T = T_world_base
        quaternion, position = (T.qw, T.qx, T.qy, T.qz), (T.x, T.y, T.z)
        if self.time_increment == 0.0 or motion is None:
            origin, directions = np.empty((1, 3)), np.empty_like(self._beams)
            _carry(quaternion, position, self._mount[None], self._beams, origin, directions)
            return origin[0], directions
        times = self.time_increment * np.arange(self.preset.beams)
        R, p = moved_frames(times, motion.velocity, motion.rates)
        origins, directions = p + R @ self._mount, np.einsum("nij,nj->ni", R, self._beams)
        _carry(quaternion, position, origins, directions, origins, directions)
        return origins, directions


@njit(cache=True)
def _carry(
    quaternion: tuple[float, float, float, float],
    position: tuple[float, float, float],
    starts: FloatArray,
    beams: FloatArray,
    origins: FloatArray,
    directions: FloatArray,
) -> None:
    """Fill origins (m, 3) and directions (n, 3) in the world from those in the base, in place if need be."""
    w, x, y, z = quaternion
    a, b, c = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    d, e, f = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    g, h, i = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    for k in range(len(beams)):
        u, v, s = beams[k, 0], beams[k, 1], beams[k, 2]
        directions[k, 0], directions[k, 1] = a * u + b * v + c * s, d * u + e * v + f * s
        directions[k, 2] = g * u + h * v + i * s
    for k in range(len(starts)):
        u, v, s = starts[k, 0], starts[k, 1], starts[k, 2]
        origins[k, 0] = position[0] + (a * u + b * v + c * s)
        origins[k, 1] = position[1] + (d * u + e * v + f * s)
        origins[k, 2] = position[2] + (g * u + h * v + i * s)
