"""Planar lidars (laser range finders) as data: one row for each device."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from lirs_wct.arrays import FloatArray
from lirs_wct.errors import ConfigError, unknown_name
from lirs_wct.field_validators import require_above, require_at_least, require_within


@dataclass(frozen=True, kw_only=True)
class LidarPreset:
    """Specification of a planar lidar.

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

    def __post_init__(self) -> None:
        of = f"lidar {self.name!r}"
        require_at_least(self, 2, "beams", of=of)
        require_within(self, f"(0, {math.tau}]", "fov", of=of, unit="rad")
        require_above(self, 0, "rate", of=of, unit="Hz", finite=True)
        require_at_least(self, 0, "range_min", "range_max", of=of, unit="m", finite=True)
        require_at_least(self, 0, "sigma", "sigma_relative", of=of, finite=True)
        if self.range_min >= self.range_max:
            raise ConfigError(
                f"range_min of {of} must be below range_max, got {self.range_min} and {self.range_max} m"
            )

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
    def directions(self) -> FloatArray:
        """(beams, 3) unit vectors of the beams in the sensor's frame."""
        return planar_directions(
            self.angle_min + self.angle_increment * np.arange(self.beams, dtype=np.float64)
        )

    @property
    def period(self) -> float:
        """Time between two scans, seconds."""
        return 1 / self.rate


def planar_directions(angles: FloatArray) -> FloatArray:
    """Return (n, 3) unit vectors in the sensor's x-y plane at angles (n,) from x, radians."""
    return np.stack((np.cos(angles), np.sin(angles), np.zeros_like(angles)), axis=1)


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
    if not isinstance(name, str) or name not in LIDARS:
        raise unknown_name("lidar", name, LIDARS)
    return LIDARS[name]
