"""Sensor messages of bags: laser scans and point clouds of any driver as arrays."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lirs_wct.formats.rosbag.frames import seconds
from lirs_wct.formats.rosbag.open_bag import open_bag
from lirs_wct.geometry import Float32Array, FloatArray, PointCloud, Pose3

ANGLE_TOLERANCE = 1e-4
"""Largest difference between angle_max and the sum of increments, both float32, radians."""
FULL_TURN = math.tau * 1.01
"""Largest span of a scan's beams, radians; with some drivers the last beam meets the first."""


class BeamGeometry(NamedTuple):
    """The geometry of a scan's beams, rounded to float32."""

    first: float
    step: float
    last: float
    range_min: float
    range_max: float
    time_increment: float


def ranges_of(message: Any) -> Float32Array:
    """Return the range of each beam: of several echoes the first, NaN without echo."""
    if len(message.ranges) and hasattr(message.ranges[0], "echoes"):
        first = [beam.echoes[0] if len(beam.echoes) else np.nan for beam in message.ranges]
        return np.array(first, np.float32)
    return np.asarray(message.ranges, np.float32)


def beams_of(message: Any, n: int) -> BeamGeometry | None:
    """Return the geometry of n beams; None if neither increment nor angle_max gives one.

    An increment of 0, or of more than a turn, is replaced by that from angle_min to angle_max.
    """
    m = message
    step = m.angle_increment if _legal(m.angle_increment, n) else (m.angle_max - m.angle_min) / max(1, n - 1)
    if not (math.isfinite(m.angle_min) and _legal(step, n)):
        return None
    time_increment = m.time_increment if math.isfinite(m.time_increment) else 0.0
    return BeamGeometry(m.angle_min, step, m.angle_max, m.range_min, m.range_max, time_increment)


@lru_cache
def geometry(beams: BeamGeometry, n: int) -> tuple[float, float, float, float]:
    """Return first angle, increment and range limits without float32 rounding."""
    first, step, last = _angle(beams.first), _angle(beams.step), _angle(beams.last)
    if n > 1 and abs(first + step * (n - 1) - last) < ANGLE_TOLERANCE:
        # Rounding of the increment would add up over the beams.
        step = (last - first) / (n - 1)
    return first, step, _decimal(beams.range_min), _decimal(beams.range_max)


def _legal(step: float, n: int) -> bool:
    """Whether an increment is legal for n beams; any is for a single beam."""
    return n == 1 or (math.isfinite(step) and step != 0.0 and abs(step) * (n - 1) <= FULL_TURN)


def _decimal(value: float) -> float:
    """Return the shortest decimal that rounds to a float32: 0.1 for 0.10000000149."""
    return float(str(np.float32(value)))


def _angle(value: float) -> float:
    """Return an angle in whole 1e-4 degrees that rounds to a float32, else the float32.

    The rounding of messages is large enough to change the trajectory of a mapper.
    """
    if not math.isfinite(value):
        return float(value)
    exact = math.radians(round(math.degrees(value), 4))
    return exact if np.float32(exact) == np.float32(value) else float(value)


TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""NumPy types by the `datatype` of a PointField."""
TIMES = ("t", "time", "timestamp", "offset_time")
"""Names of the time field with different drivers."""
FIELDS = ("x", "y", "z", "intensity", "ring", *TIMES)
"""Fields that are read."""
NANOSECONDS = 1e-9
MIN_CLOCK_TIME = 1e3
"""Smallest time of a point, seconds, that is a clock's time and not relative to the sweep."""
MIN_CLOCK_NANOSECONDS = 1e15
"""Smallest floating-point time that is in nanoseconds of a clock."""
MAX_REVOLUTION = 10.0
"""Largest difference to the header's stamp, seconds, for times of the same clock."""


def records_of(message: Any) -> NDArray[Any] | None:
    """Return the points (height, width) as records by field name; None without legal x, y, z."""
    m = message
    kinds = {f.name: (f.datatype, f.offset) for f in m.fields if f.name in FIELDS and f.datatype in TYPES}
    fields = {name: ("<>"[m.is_bigendian] + TYPES[kind], at) for name, (kind, at) in kinds.items()}
    if any(fields.get(axis, ("",))[0][1:] not in ("f4", "f8") for axis in "xyz"):
        return None
    if any(offset + np.dtype(kind).itemsize > m.point_step for kind, offset in fields.values()):
        return None
    row = m.row_step if m.height > 1 else m.width * m.point_step
    if row < m.width * m.point_step or len(m.data) < m.height * row:
        return None
    formats, offsets = zip(*fields.values(), strict=True)
    dtype = np.dtype(
        {"names": list(fields), "formats": formats, "offsets": offsets, "itemsize": m.point_step}
    )
    shape, strides = (m.height, m.width), (row, m.point_step)
    return np.ndarray(shape, dtype, np.ascontiguousarray(m.data).data, 0, strides)


def times_of(records: NDArray[Any], header: float) -> FloatArray:
    """Return the seconds of the points from the header's stamp, in their shape; 0 without times.

    Integers are nanoseconds. Times of a clock count from the header's stamp if it is of the same clock,
    else from the earliest point.
    """
    name = next((name for name in TIMES if name in (records.dtype.names or ())), None)
    if name is None or not records.size:
        return np.zeros(records.shape)
    unit = NANOSECONDS if records.dtype[name].kind in "iu" else 1.0
    times = records[name].astype(np.float64)
    known = np.isfinite(times)
    times[~known] = times.min(where=known, initial=times.max(where=known, initial=0.0))
    if times.max() > MIN_CLOCK_NANOSECONDS:
        unit = NANOSECONDS
    first = float(times.min()) * unit
    if abs(first) < MIN_CLOCK_TIME:
        return times * unit
    same_clock = abs(first - header) < MAX_REVOLUTION
    return (times - (header / unit if same_clock else times.min())) * unit


def start_of(records: NDArray[Any], header: float) -> float:
    """Return the start of the sweep relative to the header's stamp, seconds, at most 0."""
    return min(0.0, float(times_of(records, header).min(initial=0.0)))


@dataclass(frozen=True)
class BagClouds:
    """Usable clouds of a bag's topic, read one by one on iteration to save memory.

    Attributes:
        stamps: Stamps in the order of the bag, seconds.
        mounts: Pose of the sensor on the robot `T_base_laser` at each cloud.
    """

    path: Path
    topic: str
    stamps: tuple[float, ...]
    mounts: tuple[Pose3, ...]

    def __len__(self) -> int:
        return len(self.stamps)

    def __iter__(self) -> Iterator[PointCloud]:
        with open_bag(self.path) as bag:
            stamps = iter(zip(self.stamps, self.mounts, strict=True))
            for _, _, message in bag.messages((self.topic,)):
                records = records_of(message)
                if records is not None:
                    header = seconds(message.header.stamp)
                    yield _cloud(records, header, *next(stamps))


def _cloud(records: NDArray[Any], header: float, stamp: float, T_base_laser: Pose3) -> PointCloud:
    """Build a cloud of the finite points off the origin, where drivers place missing returns."""
    time = times_of(records, header) - start_of(records, header)
    known = records.dtype.names or ()
    ring = records["ring"] if "ring" in known else np.zeros(records.shape)
    xyz = np.stack([records[axis] for axis in "xyz"], axis=-1).astype(np.float32)
    valid = np.isfinite(xyz).all(axis=-1) & (xyz != 0.0).any(axis=-1)
    column, shape = None, (0, 0)
    if len(valid) > 1 and (ring == np.arange(len(valid))[:, None]).all():  # rows are rings
        column, shape = np.nonzero(valid)[1].astype(np.uint16), (valid.shape[0], valid.shape[1])
    return PointCloud(
        xyz[valid],
        ring[valid].astype(np.uint16),
        time[valid].astype(np.float32),
        stamp,
        T_base_laser,
        records["intensity"][valid].astype(np.float32) if "intensity" in known else None,
        column,
        shape,
    )
