"""The laser range finder (LRF): a preset of figures, a mount, and noise on the ranges."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lirs_envs.mipmap import Terrain
from lirs_envs.raycast import RayCaster, cast_rays
from lirs_envs.wall_cells import WallCells
from lirs_wct.errors import ConfigError, SimulationError, unknown_name
from lirs_wct.pose import Pose3
from lirs_wct.scan import LaserScan

Array = NDArray[np.float64]
OtherRanges = Callable[[Array, Array, float], Array]
"""origin (3,), directions (n, 3), largest range -> (n,) ranges of what the world itself does not hold."""


@dataclass(frozen=True, kw_only=True)
class LidarPreset:
    """The figures of a planar laser range finder.

    Attributes:
        name: how users call it.
        beams: number of beams in a scan.
        fov: angle from the first beam to the last, radians; for a full circle the last beam is one
            increment short of the first.
        rate: scans a second, Hz.
        range_min: smallest range, metres.
        range_max: largest range, metres.
        sigma: standard deviation of the range noise, metres.
        sigma_relative: the part of it that grows with the range, metres a metre; both add.

    Raises:
        ConfigError: a figure is not legal.
    """

    name: str
    beams: int
    fov: float
    rate: float
    range_min: float
    range_max: float
    sigma: float = 0.0
    sigma_relative: float = 0.0

    def __post_init__(self) -> None:
        legal = {
            "beams must be at least 2": self.beams >= 2,
            "fov must be above 0 and at most 2 pi rad": 0 < self.fov <= math.tau,
            "rate must be above 0 Hz": 0 < self.rate < math.inf,
            "range_min must be at least 0 m and below range_max": 0 <= self.range_min < self.range_max,
            "range_max must be finite": self.range_max < math.inf,
            "sigma must be at least 0": self.sigma >= 0 and self.sigma_relative >= 0,
        }
        for rule, holds in legal.items():
            if not holds:
                raise ConfigError(f"lidar {self.name!r}: {rule}, got {self}")

    @property
    def angle_min(self) -> float:
        """Angle of the first beam, radians; beams run counter-clockwise, the middle one looks ahead."""
        return -self.fov / 2

    @property
    def angle_increment(self) -> float:
        """Angle between two beams, radians."""
        gaps = self.beams if self.fov == math.tau else self.beams - 1
        return self.fov / gaps

    @property
    def period(self) -> float:
        """Time between two scans, seconds."""
        return 1 / self.rate


def _preset(
    name: str, beams: int, fov: float, rate: float, limits: tuple[float, float], **noise: float
) -> LidarPreset:
    low, high = limits
    angle = math.radians(fov)
    return LidarPreset(name=name, beams=beams, fov=angle, rate=rate, range_min=low, range_max=high, **noise)


LIDARS: dict[str, LidarPreset] = {
    preset.name: preset
    for preset in (
        # The Husky's simulated SICK, and the one of the data sheet.
        _preset("lms1xx", 720, 270.0, 50.0, (0.1, 30.0), sigma=0.001),
        _preset("lms111", 541, 270.0, 25.0, (0.5, 20.0), sigma=0.012),
        # Its data sheet gives no deviation but a bound of 0.03 m; this is what simulators use.
        _preset("utm30lx", 1081, 270.25, 40.0, (0.2, 30.0), sigma=0.004),
        _preset("urg04lx", 682, 239.77, 10.0, (0.02, 5.6), sigma_relative=0.01),
        _preset("rplidar_a1", 360, 360.0, 5.5, (0.15, 12.0), sigma_relative=0.01),
        _preset("lds01", 360, 360.0, 5.0, (0.12, 3.5), sigma=0.01),
    )
}
"""Presets by name."""


def make_lidar_preset(name: str) -> LidarPreset:
    """Return a preset by its name.

    Raises:
        ConfigError: no preset has this name; the message lists them.
    """
    if name not in LIDARS:
        raise unknown_name("lidar", name, LIDARS)
    return LIDARS[name]


class Lidar:
    """A laser range finder on a robot in a world. All beams of a scan are cast at one instant."""

    def __init__(
        self, preset: LidarPreset, caster: RayCaster, T_base_laser: Pose3, rng: np.random.Generator
    ) -> None:
        self.preset = preset
        self.caster = caster
        self.T_base_laser = T_base_laser
        self._rng = rng
        angles = preset.angle_min + preset.angle_increment * np.arange(preset.beams)
        self._beams = np.stack((np.cos(angles), np.sin(angles), np.zeros_like(angles)), axis=1)

    def scan(self, T_world_base: Pose3, stamp: float, others: OtherRanges | None = None) -> LaserScan:
        """Return the scan from a pose of the robot, with noise.

        Args:
            T_world_base: pose of the robot.
            stamp: seconds.
            others: ranges of robots and props; the nearer of both counts.

        Raises:
            SimulationError: the pose is not finite.
        """
        preset = self.preset
        T_world_laser = T_world_base @ self.T_base_laser
        origin = T_world_laser.position
        directions = self._beams @ T_world_laser.rotation.T
        if not (math.isfinite(origin.sum()) and math.isfinite(directions[0].sum())):
            raise SimulationError(f"the laser's pose must be finite, got {T_world_laser}")
        other = others(origin, directions, preset.range_max) if others else np.empty(0)
        noise = self._rng.standard_normal(preset.beams)
        limits = (preset.range_min, preset.range_max, preset.sigma, preset.sigma_relative)
        ranges = np.empty(preset.beams, np.float32)
        _sweep(self.caster.terrain, self.caster.walls, origin, directions, other, noise, limits, ranges)
        return LaserScan(
            ranges,
            preset.angle_min,
            preset.angle_increment,
            preset.range_min,
            preset.range_max,
            stamp,
            self.T_base_laser,
        )


@njit(cache=True)
def _sweep(
    terrain: Terrain,
    walls: WallCells,
    origin: Array,
    directions: Array,
    others: Array,
    noise: Array,
    limits: tuple[float, float, float, float],
    ranges: NDArray[np.float32],
) -> None:
    """Fill `ranges` (n,): +inf = nothing in range, -inf = too near (REP 117), else the range with noise."""
    range_min, range_max, sigma, sigma_relative = limits
    exact = np.empty(len(directions))
    cast_rays(terrain, walls, origin, directions, range_max, exact)
    for k in range(len(exact)):
        true = min(exact[k], others[k]) if len(others) else exact[k]
        if true > range_max:
            ranges[k] = np.inf
            continue
        measured = true + (sigma + sigma_relative * true) * noise[k]
        if true < range_min or measured < range_min:
            ranges[k] = -np.inf
        else:
            ranges[k] = measured if measured <= range_max else np.inf
