"""Lidars with any pattern of beams: several rings, a dome, a line down."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from lirs_envs.lidar.noise import LidarNoise, draw_noise, measure
from lirs_envs.lidar.presets import ring_directions
from lirs_envs.lidar.ray_casting import Caster
from lirs_wct.arrays import Float32Array, FloatArray
from lirs_wct.errors import ConfigError
from lirs_wct.geometry import Pose3


def rings(count: int, beams: int, elevation: tuple[float, float]) -> FloatArray:
    """Return (count * beams, 3) unit directions of rings around z, from below.

    Args:
        count: number of rings.
        beams: number of beams in each ring, evenly over a full turn.
        elevation: elevation of the lowest and the highest ring above the plane, radians.

    Raises:
        ConfigError: there is no ring or no beam, or an elevation is beyond 90 deg.
    """
    low, high = elevation
    if count < 1 or beams < 1 or not -math.pi / 2 <= low <= high <= math.pi / 2:
        raise ConfigError(
            "rings need at least 1 ring of 1 beam between -pi/2 and pi/2, "
            f"got {count} of {beams} in {elevation}"
        )
    around = math.tau * np.arange(beams) / beams - math.pi
    return np.concatenate([ring_directions(around, up) for up in np.linspace(low, high, count).tolist()])


@dataclass(frozen=True, kw_only=True)
class BeamPattern:
    """Directions of all beams, and how far and how well they measure.

    Attributes:
        directions: (n, 3) unit vectors in the sensor's frame.
        range_min: smallest range, meters.
        range_max: largest range, meters.
        noise: noise of the ranges; beams that follow each other count as neighbors.

    Raises:
        ConfigError: the directions are no unit vectors, or the ranges no interval.
    """

    directions: FloatArray
    range_min: float = 0.1
    range_max: float = 100.0
    noise: LidarNoise = field(default_factory=LidarNoise)

    def __post_init__(self) -> None:
        d = self.directions
        if d.ndim != 2 or d.shape[1] != 3 or not np.allclose(np.linalg.norm(d, axis=1), 1, atol=1e-6):
            raise ConfigError(f"a beam pattern needs unit vectors (n, 3), got an array {d.shape}")
        if not 0 <= self.range_min < self.range_max < math.inf:
            raise ConfigError(
                f"a beam pattern needs 0 <= range_min < range_max, got {self.range_min} and {self.range_max}"
            )


class PatternLidar:
    """Casts a pattern from a mount on a robot: `ranges(sim.T_world_base)`.

    Args:
        pattern: directions, ranges, noise.
        caster: geometry that the beams hit, such as `Simulation.caster`.
        T_base_laser: mount.
        rng: random generator of the noise.
    """

    def __init__(
        self,
        pattern: BeamPattern,
        caster: Caster,
        T_base_laser: Pose3,
        rng: np.random.Generator,
    ) -> None:
        self.pattern = pattern
        self.caster = caster
        self._noise = pattern.noise.parameters
        self.T_base_laser = T_base_laser
        self._rng = rng

    def ranges(self, T_world_base: Pose3) -> Float32Array:
        """Return (n,) ranges in meters. +inf = nothing in range, -inf = too near, NaN = lost (REP 117)."""
        pattern, T = self.pattern, T_world_base @ self.T_base_laser
        exact = self.caster.ranges(T.position, pattern.directions @ T.rotation.T, pattern.range_max)
        normal, uniform = draw_noise(pattern.noise, len(exact), self._rng)
        ranges = np.empty(len(exact), np.float32)
        limits = (pattern.range_min, pattern.range_max)
        measure(exact, normal, uniform, limits, self._noise, ranges)
        return ranges

    def points(self, ranges: ArrayLike) -> FloatArray:
        """Return (m, 3) ends of the beams that met something, in the base frame, meters."""
        r = np.asarray(ranges, dtype=np.float64)
        met = np.isfinite(r)
        return self.T_base_laser.apply(r[met, None] * self.pattern.directions[met])
