"""Pipelines compiled into the package evalio.

Potokar and Kaess, "A Comprehensive Evaluation of LiDAR Odometry Techniques" (IROS 2025).
"""

from __future__ import annotations

import importlib
import math
import sys
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.util import find_spec, module_from_spec
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from lirs_extensions.clouds.packages import TimedOdometry, TimedSystem, matrix_of
from lirs_wct.errors import ConfigError, require_known, require_within
from lirs_wct.geometry import FloatArray, ImuReadings, PointCloud

GRAVITY = 9.80665
THREADS = {"max_num_threads": 1, "num_threads": 1, "ls_num_threads": 1, "numberOfCores": 1}
"""Parameters of pipelines that set a number of threads; 1 = as every other mapper here."""


class Pipeline(NamedTuple):
    """Properties of a pipeline.

    Attributes:
        pose_at: Share of the sweep at which its poses lie: 0 = start, .5 = middle, as without deskewing.
        delay: Sweeps by which its poses are late.
        inertial: Whether it takes inertial readings.
        organized: Whether it needs the beams without return, too.
        rolling: Whether it needs times in the sweep.
    """

    type: str
    pose_at: float = 0.5
    delay: int = 0
    inertial: bool = False
    organized: bool = False
    rolling: bool = False


PIPELINES: Mapping[str, Pipeline] = {
    "ct": Pipeline("CTICP", pose_at=0.0, rolling=True),
    "dlio": Pipeline("DLIO", inertial=True),
    "form": Pipeline("FORM", organized=True),
    "genz": Pipeline("GenZICP"),
    "kiss": Pipeline("KissICP", rolling=True),
    "liosam": Pipeline("LioSAM", pose_at=0.0, delay=2, inertial=True, organized=True),
    "loam": Pipeline("LOAM", organized=True),
    "mad": Pipeline("MadICP"),
}
"""Pipelines by evalio's names."""


@dataclass(frozen=True, kw_only=True)
class EvalioConfig:
    """Configurable parameters of a pipeline; the defaults are evalio's, with one thread.

    Attributes:
        pipeline: Name in evalio.
        max_range: points beyond are left out, meters.
        min_range: points nearer are left out, meters.
        rate: sweeps a second, Hz.
        inertial_rate: inertial readings a second, Hz.
        parameters: Parameters of the pipeline, by evalio's names.

    Raises:
        ConfigError: a value is not legal.
    """

    pipeline: str
    max_range: float = 100.0
    min_range: float = 0.3
    rate: float = 10.0
    inertial_rate: float = 200.0
    parameters: Mapping[str, bool | int | float | str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        require_known("pipeline of evalio", self.pipeline, PIPELINES)
        of = f"evalio:{self.pipeline}"
        require_within(self, "(0, inf)", "max_range", "rate", "inertial_rate", of=of)
        require_within(self, "[0, inf]", "min_range", of=of, unit="m")


class EvalioPipeline(TimedSystem):
    """A pipeline of evalio as a `TimedSystem`; the inertial unit's frame is the base's."""

    def __init__(self, config: EvalioConfig) -> None:
        self._config, self._kind = config, PIPELINES[config.pipeline]
        self.inertial = self._kind.inertial
        self._cpp = extension()
        self._made: Any = getattr(self._cpp.pipelines, self._kind.type)()
        defaults = self._made.default_params()
        threads = {name: count for name, count in THREADS.items() if name in defaults}
        for name in config.parameters:
            require_known(f"parameter of evalio:{config.pipeline}", name, defaults)
        self._made.set_params({**defaults, **threads, **config.parameters})
        self._running = False
        self._early: list[ImuReadings] = []
        self._stamps: deque[float] = deque(maxlen=1 + self._kind.delay)

    def add_readings(self, readings: ImuReadings) -> None:
        """Add inertial readings one by one; those before the first sweep wait for it."""
        if not self._running:
            self._early.append(readings)
            return
        T = self._cpp.types
        rows = zip(readings.stamps, readings.angular_velocity, readings.linear_acceleration, strict=True)
        for stamp, rates, force in rows:
            self._made.add_imu(T.ImuMeasurement(T.Stamp.from_sec(float(stamp)), rates, force))

    def register(self, cloud: PointCloud) -> list[tuple[float, FloatArray]]:
        """Register a sweep; return the pose that the pipeline saved, if any."""
        if not self._running:
            self._begin(cloud)
        if self._kind.rolling and not cloud.rolling:
            # Pipelines divide by the span of the times; a span of 0 ends the process.
            raise ConfigError(f"evalio:{self._config.pipeline} needs rolling sweeps (option scan-time)")
        self._made.add_lidar(self._measurement(cloud))
        self._stamps.append(cloud.stamp)
        saved = self._made.saved_estimates()
        if len(self._stamps) <= self._kind.delay:
            return []
        time = self._stamps[0] + self._kind.pose_at * float(cloud.time.max())
        return [(time, pose.to_mat()) for _, pose in saved[-1:]]

    def _begin(self, cloud: PointCloud) -> None:
        """Give the pipeline the sensors' properties, and the readings so far."""
        T, config = self._cpp.types, self._config
        rows, columns = cloud.shape
        near, far = config.min_range, config.max_range
        lidar = {"num_rows": rows, "num_columns": columns, "min_range": near, "max_range": far}
        self._made.set_lidar_params(T.LidarParams(**lidar, rate=config.rate))
        if self._early:
            # evalio takes densities: the deviation of a reading over the root of the rate.
            root, last = math.sqrt(config.inertial_rate), self._early[-1]
            noise = {"gyro": last.rate_sigma / root, "accel": last.acceleration_sigma / root}
            gravity = np.array((0.0, 0.0, -GRAVITY))
            self._made.set_imu_params(T.ImuParams(**noise, gravity=gravity, rate=config.inertial_rate))
        self._made.set_imu_T_lidar(T.SE3.from_mat(matrix_of(cloud.T_base_laser)))
        self._made.initialize()
        self._running = True
        for readings in self._early:
            self.add_readings(readings)

    def _measurement(self, cloud: PointCloud) -> Any:
        """Return a sweep as evalio's, converted in C++ like a `sensor_msgs/PointCloud2`."""
        H, T = self._cpp.helpers, self._cpp.types
        points = (cloud.organized() if self._kind.organized else cloud.records()).ravel()
        kinds = {"<f4": H.DataType.FLOAT32, "<u2": H.DataType.UINT16}
        described: dict[str, Any] = dict(points.dtype.fields or {})
        fields = [H.Field(name=n, datatype=kinds[t.str], offset=o) for n, (t, o, *_) in described.items()]
        size = {"point_step": points.itemsize, "row_step": points.nbytes, "width": len(points), "height": 1}
        stamp = T.Stamp.from_sec(cloud.stamp)
        about = H.PointCloudMetadata(stamp=stamp, **size, is_bigendian=0, is_dense=1)
        measurement = H.pc2_to_evalio(about, fields, points.tobytes())
        H.fill_col_row_major(measurement)
        return measurement


def extension() -> ModuleType:
    """Import evalio's compiled extension, which needs NumPy only.

    The package itself imports modules that its datasets need.
    """
    found = find_spec("evalio")
    assert found is not None, "the factory checks that evalio is installed"
    sys.modules.setdefault("evalio", module_from_spec(found))  # the package, whose code does not run
    return importlib.import_module("evalio._cpp")


def make_evalio(config: EvalioConfig) -> TimedOdometry:
    """Return a pipeline as a mapper."""
    return TimedOdometry(EvalioPipeline(config))
