"""Lidars: one preset per device, planar (laser range finder) or with rings, and their noise.

The noise model turns true ranges into measured ones.
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from lirs_wct.arrays import Float32Array, FloatArray, njit
from lirs_wct.errors import Checked, ConfigError, limited, require_within, unknown_name


@dataclass(frozen=True, kw_only=True)
class LidarPreset:
    """Specification of a lidar.

    A lidar with rings has a planar scan as well: its ring nearest the horizon, of two as near the upper one,
    as ROS `velodyne_laserscan` takes it.

    Attributes:
        name: how users call it.
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
    low, high = limits
    return LidarPreset(
        name=name,
        beams=beams,
        fov=math.radians(fov),
        rate=rate,
        range_min=low,
        range_max=high,
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
    if not isinstance(name, str) or name not in LIDARS:
        raise unknown_name("lidar", name, LIDARS)
    return LIDARS[name]


NoiseLevel = Literal["none", "simulated", "datasheet"]
LEVELS = ("none", "simulated", "datasheet")


class NoiseParameters(NamedTuple):
    """`LidarNoise` as the kernel reads it."""

    sigma: float
    sigma_relative: float
    quantization: float
    dropout: float
    mixed_pixels: float
    edge_threshold: float


@dataclass(frozen=True, kw_only=True)
class LidarNoise(Checked, of="the lidar noise"):
    """Errors of a range measurement.

    Attributes:
        sigma: standard deviation of the range noise, meters.
        sigma_relative: deviation proportional to the range, meters a meter; both add.
        quantization: step of the measured ranges, meters; 0 = continuous.
        dropout: share of invalid beams (NaN, REP 117).
        mixed_pixels: share of the beams at an edge that fall on both sides of it and measure a range between.
        edge_threshold: difference between the ranges of two neighbors that makes an edge, meters.
    """

    sigma: float = limited(0.0, "[0, inf)")
    sigma_relative: float = limited(0.0, "[0, inf)")
    quantization: float = limited(0.0, "[0, inf)")
    dropout: float = limited(0.0, "[0, 1]")
    mixed_pixels: float = limited(0.0, "[0, 1]")
    edge_threshold: float = limited(0.2, "[0, inf)")

    @property
    def parameters(self) -> NoiseParameters:
        """All fields, for the kernel."""
        return NoiseParameters(*map(float, astuple(self)))

    @property
    def draws_uniform(self) -> bool:
        """Whether beams are lost or mixed by chance."""
        return self.dropout > 0 or self.mixed_pixels > 0


DATASHEET: dict[str, LidarNoise] = {
    "lms1xx": LidarNoise(sigma=0.012, quantization=0.001, dropout=0.001, mixed_pixels=0.5),
    "lms111": LidarNoise(sigma=0.012, quantization=0.001, dropout=0.001, mixed_pixels=0.5),
    "lms200": LidarNoise(sigma=0.005, quantization=0.01, dropout=0.001, mixed_pixels=0.5),
    "pls": LidarNoise(sigma=0.05, quantization=0.01, dropout=0.001, mixed_pixels=0.5),
    "utm30lx": LidarNoise(sigma=0.03, quantization=0.001, dropout=0.001, mixed_pixels=0.5),
    "urg04lx": LidarNoise(sigma_relative=0.01, quantization=0.001, dropout=0.002, mixed_pixels=0.5),
    "rplidar_a1": LidarNoise(sigma_relative=0.01, quantization=0.0005, dropout=0.01, mixed_pixels=0.3),
    "lds01": LidarNoise(sigma=0.01, quantization=0.001, dropout=0.01, mixed_pixels=0.3),
    "vlp16": LidarNoise(sigma=0.03, quantization=0.002, dropout=0.001, mixed_pixels=0.5),
    "os1_32": LidarNoise(sigma=0.03, quantization=0.001, dropout=0.001, mixed_pixels=0.5),
}
"""Deviation and quantization are the makers', of `pls` see the presets. No data sheet says how many beams are
lost or mixed: both are assumed, from nearly none for SICK, Velodyne and Ouster to one in a hundred for the
cheap ones; a beam as wide as the gap to the next one lies on an edge whenever there is one, half of them on
enough of both sides to be mixed."""


def lidar_noise(preset: LidarPreset, level: NoiseLevel = "simulated") -> LidarNoise:
    """Return the noise of a preset.

    Args:
        preset: the device.
        level: `none`; `simulated` = Gaussian with the preset's own deviation, as simulators have it;
            `datasheet` = all that the device is known for. A preset of the user's has no data sheet: there
            it is `simulated`.
    """
    if level not in LEVELS:
        raise unknown_name("lidar noise", level, LEVELS)
    simulated = LidarNoise(sigma=preset.sigma, sigma_relative=preset.sigma_relative)
    if level == "none":
        return LidarNoise()
    return simulated if level == "simulated" else DATASHEET.get(preset.name, simulated)


NO_DRAWS: FloatArray = np.empty((0, 2))


def draw_noise(noise: LidarNoise, beams: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return (n,) normal and (n, 2) uniform random numbers for one scan.

    Without dropout and mixed pixels, the uniform array is (0, 2).
    """
    normal = rng.standard_normal(beams)
    return normal, rng.random((beams, 2)) if noise.draws_uniform else NO_DRAWS


@njit
def measure(
    exact: FloatArray,
    normal: FloatArray,
    uniform: FloatArray,
    limits: tuple[float, float],
    parameters: NoiseParameters,
    ranges: Float32Array,
) -> None:
    """Fill `ranges` (n,) with measured ranges, meters.

    +inf = nothing in range, -inf = too near, NaN = lost (REP 117).
    """
    range_min, range_max = limits
    sigma, sigma_relative, quantization, dropout, mixed_pixels, edge_threshold = parameters
    for k in range(len(exact)):
        true = exact[k]
        if len(uniform):
            if uniform[k, 1] < dropout:
                ranges[k] = np.nan
                continue
            if k + 1 < len(exact) and uniform[k, 0] < mixed_pixels:
                jump = exact[k + 1] - true
                if edge_threshold < abs(jump) < np.inf:
                    true += jump * uniform[k, 0] / mixed_pixels
        if true > range_max or true == np.inf:
            ranges[k] = np.inf
            continue
        measured = true + (sigma + sigma_relative * true) * normal[k]
        if quantization > 0:
            measured = quantization * round(measured / quantization)
        if true < range_min or measured < range_min:
            ranges[k] = -np.inf
        else:
            ranges[k] = measured if measured <= range_max else np.inf
