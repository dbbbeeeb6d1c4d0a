"""The laser range finder (LRF): a preset of figures, a mount, and noise on the ranges."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lirs_envs.lidar_noise import LidarNoise, draws, lidar_noise, measure
from lirs_envs.lidar_presets import LIDARS, LidarPreset, make_lidar_preset
from lirs_envs.raycast import Caster
from lirs_wct.deskew import moved_frames
from lirs_wct.errors import SimulationError
from lirs_wct.pose import Pose3
from lirs_wct.scan import LaserScan

__all__ = ["LIDARS", "Lidar", "LidarPreset", "Motion", "OtherRanges", "make_lidar_preset"]

Array = NDArray[np.float64]
OtherRanges = Callable[[Array, Array, float], Array]
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
        self._beams = np.stack((np.cos(angles), np.sin(angles), np.zeros_like(angles)), axis=1)

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
        origin, directions = self._rays(T_world_base, motion)
        if not (np.isfinite(origin).all() and np.isfinite(directions[0]).all()):
            raise SimulationError(f"the laser's pose must be finite, got {T_world_base}")
        exact = self.caster.ranges(origin, directions, preset.range_max)
        if others is not None:
            exact = np.minimum(exact, others(origin, directions, preset.range_max))
        normal, uniform = draws(self.noise, preset.beams, self._rng)
        ranges = np.empty(preset.beams, np.float32)
        measure(exact, normal, uniform, (preset.range_min, preset.range_max), self.noise.figures, ranges)
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

    def _rays(self, T_world_base: Pose3, motion: Motion | None) -> tuple[Array, Array]:
        """Return origin (3,) or origins (n, 3), and directions (n, 3) of the beams in the world."""
        if self.time_increment == 0.0 or motion is None:
            T_world_laser = T_world_base @ self.T_base_laser
            return T_world_laser.position, self._beams @ T_world_laser.rotation.T
        times = self.time_increment * np.arange(self.preset.beams)
        R, p = moved_frames(times, motion.velocity, motion.rates)
        in_base = self._beams @ self.T_base_laser.rotation.T
        origins = p + R @ self.T_base_laser.position
        rotation = T_world_base.rotation
        directions = np.einsum("nij,nj->ni", R, in_base) @ rotation.T
        return origins @ rotation.T + T_world_base.position, directions
