"""Sensor readings, their noise and faults with its YAML file, odometry objects of single robots."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from lirs_envs.lidar.noise import LEVELS, LidarNoise, NoiseLevel, lidar_noise
from lirs_envs.lidar.presets import LidarPreset
from lirs_envs.sensing.imu import ImuConfig
from lirs_envs.sensing.wheel_odometry import OdometryConfig
from lirs_wct import (
    ConfigError,
    Float32Array,
    Imu,
    ImuReadings,
    LaserScan,
    PointCloud,
    Pose2,
    SourceError,
    require_known,
)
from lirs_wct.errors import Checked, check_field, limited, of_type
from lirs_wct.files import atomic_write
from lirs_wct.formats.yaml_text import load_yaml

FAULT_STREAM = 16
"""Random stream of the faults."""
DUST_RANGES = (0.3, 2.0)
"""Nearest and farthest return of a dust particle, meters."""
MAX_LAG = 1.0
"""Longest lag of a scan, seconds."""


@dataclass(frozen=True, kw_only=True)
class SensorFaults(Checked, of="the sensor faults"):
    """Faults of a robot's sensors; all are off by default.

    Attributes:
        lag: Time by which a scan is older than its stamp, seconds; rounded to whole scans.
        field_of_view: Angle around straight ahead in which beams measure, degrees; others are invalid.
        dust: Share of beams that a particle nearer than 2 m returns.
        slip: Excess of the measured distance, as a share, per unit sine of the slope uphill. On a cross slope
            it is the sideways motion that the wheels do not measure.
    """

    lag: float = limited(0.0, f"[0, {MAX_LAG:g}]", "s")
    field_of_view: float = limited(360.0, "(0, 360]", "deg")
    dust: float = limited(0.0, "[0, 1]")
    slip: float = limited(0.0, "[0, 1]")

    @property
    def any(self) -> bool:
        """Whether a fault is on."""
        return self != SensorFaults()


class FaultInjector:
    """Applies faults to the readings of one robot, in the order of the scans."""

    def __init__(self, faults: SensorFaults, lidar: LidarPreset, seed: int) -> None:
        if lidar.rings > 1 and (faults.dust or faults.field_of_view < 360.0):
            raise ConfigError("field_of_view and dust are faults of planar lidars; this one has rings")
        self.faults, self._angles = faults, lidar.angles
        self._rng = sensor_stream(seed, FAULT_STREAM)
        scans = 1 + round(faults.lag / lidar.period)
        self._late: deque[tuple[Float32Array, PointCloud | None]] = deque(maxlen=scans)
        self._true, self._measured = Pose2(), Pose2()

    def scan(self, ranges: Float32Array, cloud: PointCloud | None) -> tuple[Float32Array, PointCloud | None]:
        """Return ranges (beams,) and cloud that arrive now, with the present cloud's stamp."""
        ranges, faults = ranges.copy(), self.faults
        if faults.dust:
            draws = self._rng.random((len(ranges), 2))
            near = DUST_RANGES[0] + (DUST_RANGES[1] - DUST_RANGES[0]) * draws[:, 1]
            hit = (draws[:, 0] < faults.dust) & ~(ranges < near)
            ranges[hit] = near[hit]
        half = math.radians(faults.field_of_view) / 2
        ranges[np.abs(self._angles) > half + 1e-9] = np.nan
        self._late.append((ranges, cloud))
        old_ranges, old_cloud = self._late[0]
        late_cloud = None if old_cloud is None or cloud is None else replace(old_cloud, stamp=cloud.stamp)
        return old_ranges, late_cloud

    def odometry(self, odometry: Pose2, roll: float, pitch: float) -> Pose2:
        """Return `T_odom_base` with the slip since the last call.

        Args:
            odometry: Pose `T_odom_base` of the wheels without slip.
            roll: Roll of the robot, radians.
            pitch: Pitch of the robot, radians.
        """
        if not self.faults.slip:
            return odometry
        step, slip = self._true.inverse() @ odometry, self.faults.slip
        forward = step.x * (1 - slip * math.sin(pitch))
        sideways = step.y + slip * abs(step.x) * math.sin(roll)
        self._true, self._measured = odometry, self._measured @ Pose2(forward, sideways, step.yaw)
        return self._measured


LIDAR_STREAM, ODOMETRY_STREAM, IMU_STREAM, INERTIAL_STREAM = 11, 12, 13, 14
"""Random stream of each sensor: with one each, another lidar leaves the noise of the others as it was."""


@dataclass(frozen=True, slots=True)
class Observation:
    """Sensor readings at a scan's stamp.

    Attributes:
        scan: Scan of the lidar; of one with rings, the ring nearest the horizon.
        odometry: Pose `T_odom_base`.
        imu: Reading of the inertial unit.
        cloud: Cloud of a lidar with rings; None for a planar one.
        inertial: Readings near 200 Hz in the last period; None where the config has none.
        odometry_track: Stamps and `T_odom_base` near 50 Hz within the last period, without its end; empty
            where the config has no inertial readings, and of odometry that is filtered once a scan.
    """

    scan: LaserScan
    odometry: Pose2
    imu: Imu
    cloud: PointCloud | None = None
    inertial: ImuReadings | None = None
    odometry_track: tuple[tuple[float, Pose2], ...] = ()


@dataclass(frozen=True, kw_only=True)
class SensorNoise(Checked, of="the sensor noise"):
    """Errors of all sensors.

    Attributes:
        imu: Noise of the inertial unit.
        odometry: Noise of the wheels, and method.
        lidar: Noise level (`none`, `simulated`, `datasheet`), or noise of your own.
        rolling_scan: Whether the beams of a scan are cast one after the other over its time; None = those of
            lidars with rings.
        faults: Late scans, covered beams, dust and slip.
    """

    imu: ImuConfig = check_field(of_type(ImuConfig), default_factory=ImuConfig)
    odometry: OdometryConfig = check_field(of_type(OdometryConfig), default_factory=OdometryConfig)
    lidar: LidarNoise | NoiseLevel = check_field(of_type(LidarNoise | str), default="simulated")
    rolling_scan: bool | None = check_field(of_type(bool), default=None)
    faults: SensorFaults = check_field(of_type(SensorFaults), default_factory=SensorFaults)

    def with_odometry_noise(self, factor: float) -> SensorNoise:
        """Return the noise with that of wheels and gyro multiplied by a factor."""
        imu, wheels = self.imu, self.odometry
        rates = {"rate_sigma": factor * imu.rate_sigma, "rate_bias": factor * imu.rate_bias}
        odometry = replace(wheels, scale_sigma=factor * wheels.scale_sigma)
        return replace(self, imu=replace(imu, **rates), odometry=odometry)

    def rolls(self, preset: LidarPreset) -> bool:
        """Return whether the scans of a lidar are rolling."""
        return preset.rings > 1 if self.rolling_scan is None else self.rolling_scan

    def of_lidar(self, preset: LidarPreset) -> LidarNoise:
        """Return the noise of a lidar."""
        return self.lidar if isinstance(self.lidar, LidarNoise) else lidar_noise(preset, self.lidar)


def sensor_stream(seed: int, stream: int) -> np.random.Generator:
    """Return the random generator of a sensor's stream."""
    return np.random.default_rng((seed, stream))


SECTIONS: dict[str, type[Any]] = {
    "lidar": LidarNoise,
    "odometry": OdometryConfig,
    "imu": ImuConfig,
    "faults": SensorFaults,
}
"""Classes of the sections."""


def resolve_noise(noise: str) -> SensorNoise:
    """Return the noise of a level of the lidar, or of a YAML file."""
    for level in LEVELS:
        if noise == level:
            return SensorNoise(lidar=level)
    return read_noise(Path(noise))


def read_noise(path: Path) -> SensorNoise:
    """Read the noise of a YAML file; omitted sections and fields keep their defaults.

    Raises:
        SourceError: the file cannot be read, or holds anything else; the message names it.
    """
    try:
        entries = load_yaml(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SourceError(f"{path}: cannot be read: {error.strerror or error}") from error
    except ValueError as error:
        raise SourceError(f"{path}: {error}") from error
    if not isinstance(entries, dict) or not entries:
        raise SourceError(f"{path}: must hold sections, got none; legal: {', '.join(SECTIONS)}")
    noise = SensorNoise()
    try:
        for name, figures in entries.items():
            require_known("section", name, SECTIONS)
            legal = [field.name for field in fields(SECTIONS[name])]
            if not isinstance(figures, dict):
                raise ConfigError(
                    f"section {name} must hold fields, got {figures!r}; legal: {', '.join(legal)}"
                )
            for key in figures:
                require_known(f"field of {name}", key, legal)
            noise = replace(noise, **{name: SECTIONS[name](**figures)})
    except ConfigError as error:
        raise SourceError(f"{path}: {error}") from error
    return noise


def write_noise(path: Path, noise: SensorNoise, comment: str) -> None:
    """Write the noise, and faults if any, as YAML after a comment."""
    if not isinstance(noise.lidar, LidarNoise):
        raise ConfigError(f"a noise file needs the lidar's own figures, got level {noise.lidar!r}")
    written = [name for name in SECTIONS if name != "faults" or noise.faults.any]
    entries = {name: asdict(getattr(noise, name)) for name in written}
    text = "".join(f"# {line}\n" for line in comment.splitlines())
    with atomic_write(path) as temporary:
        temporary.write_text(text + yaml.safe_dump(entries, sort_keys=False), encoding="utf-8")
