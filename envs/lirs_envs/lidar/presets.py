"""Lidars: one preset per device, planar (laser range finder) or with rings."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from lirs_wct.arrays import FloatArray
from lirs_wct.errors import ConfigError, require_known, require_within


@dataclass(frozen=True, kw_only=True)
class LidarPreset:
    """Specification of a lidar.

    A lidar with rings has a planar scan as well: its ring nearest the horizon, of two as near the upper one,
    as ROS `velodyne_laserscan` takes it.

    Attributes:
        beams: number of beams in a ring; a planar lidar is one ring.
        fov: angle from the first beam to the last, radians; for a full circle the last beam is one
            increment short of the first.
        rate: scans a second, Hz.
        range_min: smallest range, meters.
        range_max: largest range, meters.
        sigma: standard deviation of the range noise, meters.
        sigma_relative: the part of it that grows with the range, meters a meter; both add.
        elevations: elevations of the rings above the sensor's x-y plane, radians, from the lowest up.

    Raises:
        ConfigError: a value is not legal.
    """

    name: str
    beams: int
    fov: float
    rate: float
    range_min: float
    range_max: float
    sigma: float = 0.0
    sigma_relative: float = 0.0
    elevations: tuple[float, ...] = (0.0,)

    def __post_init__(self) -> None:
        of = f"lidar {self.name!r}"
        require_within(self, "[2, inf]", "beams", of=of)
        require_within(self, f"(0, {math.tau}]", "fov", of=of, unit="rad")
        require_within(self, "(0, inf)", "rate", of=of, unit="Hz")
        require_within(self, "[0, inf)", "range_min", "range_max", of=of, unit="m")
        require_within(self, "[0, inf)", "sigma", "sigma_relative", of=of)
        if self.range_min >= self.range_max:
            raise ConfigError(
                f"range_min of {of} must be below range_max, got {self.range_min} and {self.range_max} m"
            )
        e = self.elevations
        if not e or not all(-math.pi / 2 < a < math.pi / 2 for a in e) or list(e) != sorted(set(e)):
            raise ConfigError(f"elevations of {of} must rise from above -pi/2 to below pi/2 rad, got {e}")

    @property
    def rings(self) -> int:
        """Number of rings; 1 = a planar lidar."""
        return len(self.elevations)

    @property
    def horizon(self) -> int:
        """Ring nearest the horizon, of two as near the upper one: the planar scan."""
        return min(range(self.rings), key=lambda ring: (round(abs(self.elevations[ring]), 9), -ring))

    @property
    def horizon_beams(self) -> slice:
        """Beams of the planar scan among all beams, ring by ring from below."""
        return slice(self.horizon * self.beams, (self.horizon + 1) * self.beams)

    @property
    def planar(self) -> LidarPreset:
        """The lidar's planar scan alone: one ring."""
        return replace(self, elevations=(self.elevations[self.horizon],))

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
    def angles(self) -> FloatArray:
        """(beams,) angles of a ring's beams about the sensor's z, radians."""
        return self.angle_min + self.angle_increment * np.arange(self.beams, dtype=np.float64)

    @property
    def directions(self) -> FloatArray:
        """(beams, 3) unit vectors of the planar scan's beams in the sensor's frame."""
        return ring_directions(self.angles, self.elevations[self.horizon])

    @property
    def all_directions(self) -> FloatArray:
        """(rings * beams, 3) unit beam directions in the sensor's frame, from the lowest ring."""
        return np.concatenate([ring_directions(self.angles, elevation) for elevation in self.elevations])

    @property
    def period(self) -> float:
        """Time between two scans, seconds."""
        return 1 / self.rate


def ring_directions(angles: FloatArray, elevation: float = 0.0) -> FloatArray:
    """Return (n, 3) unit vectors at angles (n,) about the sensor's z from x, radians.

    Args:
        angles: (n,) radians, counter-clockwise.
        elevation: common elevation above the sensor's x-y plane, radians.
    """
    c, s = math.cos(elevation), math.sin(elevation)
    return np.stack((c * np.cos(angles), c * np.sin(angles), np.full_like(angles, s)), axis=1)


def _preset(
    name: str,
    beams: int,
    fov: float,
    rate: float,
    limits: tuple[float, float],
    *,
    sigma: float = 0.0,
    sigma_relative: float = 0.0,
) -> LidarPreset:
    return LidarPreset(
        name=name,
        beams=beams,
        fov=math.radians(fov),
        rate=rate,
        range_min=limits[0],
        range_max=limits[1],
        sigma=sigma,
        sigma_relative=sigma_relative,
    )


def _ring_preset(
    name: str, rings: int, lowest: float, beams: int, limits: tuple[float, float], sigma: float
) -> LidarPreset:
    """Return a preset of 10 Hz with evenly spaced rings, symmetric about the horizon.

    `lowest` is the elevation of the lowest ring, degrees.
    """
    planar = _preset(name, beams, 360.0, 10.0, limits, sigma=sigma)
    elevations = np.radians(np.linspace(lowest, -lowest, rings))
    return replace(planar, elevations=tuple(elevations.tolist()))


LIDARS: dict[str, LidarPreset] = {
    preset.name: preset
    for preset in (
        # The Husky's simulated SICK, and the one of the data sheet.
        _preset("lms1xx", 720, 270.0, 50.0, (0.1, 30.0), sigma=0.001),
        _preset("lms111", 541, 270.0, 25.0, (0.5, 20.0), sigma=0.012),
        # Its data sheet gives no deviation but a bound of 0.03 m; simulators use this value.
        _preset("utm30lx", 1081, 270.25, 40.0, (0.2, 30.0), sigma=0.004),
        _preset("urg04lx", 682, 239.77, 10.0, (0.02, 5.6), sigma_relative=0.01),
        _preset("rplidar_a1", 360, 360.0, 5.5, (0.15, 12.0), sigma_relative=0.01),
        _preset("lds01", 360, 360.0, 5.0, (0.12, 3.5), sigma=0.01),
        # SICK LMS200 in steps of 1 deg and of 1 cm; its data sheet gives the deviation up to 8 m.
        _preset("lms200", 181, 180.0, 75.0, (0.05, 80.0), sigma=0.005),
        # SICK PLS in steps of 0.5 deg. No deviation is published; CARMEN's driver states an accuracy of
        # 0.15 m, taken as three deviations.
        _preset("pls", 361, 180.0, 25.0, (0.05, 50.0), sigma=0.05),
        # Velodyne VLP-16: a ring every 2 deg, a column every 0.2 deg.
        _ring_preset("vlp16", 16, -15.0, 1800, (0.5, 100.0), 0.03),
        # Ouster OS1-32, Rev 6 and 7, in its mode 1024 x 10; the deviation is that of a bright target.
        _ring_preset("os1_32", 32, -22.5, 1024, (0.5, 120.0), 0.015),
    )
}
"""Presets by name."""
RING_LIDARS = tuple(name for name, preset in LIDARS.items() if preset.rings > 1)
"""Names of the presets with rings."""


def make_lidar_preset(name: str) -> LidarPreset:
    """Return a preset by its name.

    Raises:
        ConfigError: no preset has this name; the message lists them.
    """
    require_known("lidar", name, LIDARS)
    return LIDARS[name]
