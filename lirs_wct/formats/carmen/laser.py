"""The laser of a CARMEN log: field of view, codes for no return, and mount."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from itertools import takewhile
from pathlib import Path

import numpy as np

from lirs_wct.arrays import Float32Array
from lirs_wct.errors import ConfigError
from lirs_wct.files import readable_lines
from lirs_wct.formats.carmen.lines import LaserConfig, Message
from lirs_wct.geometry import LaserScan, Pose2, Pose3

SICK_INVALID = (81.87, 81.88, 81.89, 81.90, 81.91)
"""Codes of the SICK LMS for "no valid measurement" (dazzled, too noisy), read as NaN, meters."""
NO_RETURN = 50.0
"""Ranges from here on mean no return (50, 51.2, 81.83), read as +inf, meters."""
RANGE_MIN = 0.02
"""Shortest valid range, that of the SICK LMS's front pane; shorter ranges are errors, meters."""
FIELDS = {
    **dict.fromkeys((180, 181, 360, 361), 180.0),
    **dict.fromkeys((101, 201, 401), 100.0),
    **dict.fromkeys((540, 541, 1080, 1081), 270.0),
}
"""Field of view of the usual lasers by their number of beams, degrees."""
REAR = ("RLASER", "ROBOTLASER2", "RAWLASER2")
"""Messages of the rear laser."""

CODE_SHARE, CODE_BEAMS, CODE_CONTRAST, CODE_MOST = 0.001, 0.05, 20, 100
"""Conditions under which the largest range is a code: least share of all ranges, least share of the beams,
least ratio to the frequency of the three meters below it, and largest ratio to all other ranges."""
MOUNT_SPREAD = 0.05
"""Largest deviation of the mounts from their median, meters and radians."""
MOUNT_REACH = 3.0
"""Largest distance of a laser from its base, meters."""


def scans_of(
    name: str,
    messages: Sequence[Message],
    parameters: Mapping[str, float],
    repaired: Counter[str],
    fov: float | None,
    range_max: float | None,
) -> list[LaserScan]:
    """Return the scans of messages with equal numbers of beams.

    Their `range_max` is the laser's reading for no return (81.83 m of a SICK). Without such a reading, it is
    the largest range that the message or the user states.

    Raises:
        ConfigError: the field of view is unknown.
    """
    n = len(messages[0].ranges)
    ranges = np.stack([m.ranges for m in messages])
    found = no_return(ranges)
    limit = range_max or found
    if range_max is None and limit < NO_RETURN:
        codes = int(((ranges >= limit) & (ranges < NO_RETURN)).sum())
        repaired[f"readings of {limit:.2f} m or more, a code for no return"] = codes
    mount = _mount(name, messages, parameters, repaired)
    field = None if fov is None else _config(n, fov)
    decoded = _decode_ranges(ranges)
    code = usual_reading(decoded[decoded >= max(found, limit)])
    scans = []
    for message, meant in zip(messages, decoded, strict=True):
        config = field or message.config or _usual_config(name, n, parameters)
        logged = NO_RETURN if message.config is None else message.config.most
        # A code within a centimeter of the largest range equals that range; shorter ranges are hits.
        most = logged if logged - limit <= 0.01 else limit
        r = np.where(meant >= most, np.float32(np.inf), meant)
        farthest = most if code is None else code
        scans.append(LaserScan(r, config.start, config.step, RANGE_MIN, farthest, message.stamp, mount))
    return scans


def no_return(ranges: Float32Array, farthest: float = NO_RETURN) -> float:
    """Return the smallest code for no return, meters; `farthest` without a smaller one.

    Many sensors report their largest range. That value repeats often, in
    all directions, and similar values are rare.

    Args:
        ranges: (scans, beams) meters, as logged.
        farthest: Range from which on every reading is a code, meters.
    """
    real = (ranges >= RANGE_MIN) & (ranges < farthest)
    cm = np.where(real, np.round(np.where(real, ranges, 0) * 100), 0).astype(np.int64)
    counts = np.bincount(cm.ravel(), minlength=2)
    counts[0] = 0
    limit = farthest
    while counts.any():
        top = int(np.flatnonzero(counts)[-1])
        below = counts[max(0, top - 300) : top]
        count, rest = int(counts[top]), int(counts[:top].sum())
        usual = CODE_CONTRAST * max(1.0, float(np.median(below)))
        if CODE_MOST * rest < count or count < max(usual, CODE_SHARE * ranges.size):
            return limit
        if (cm == top).any(axis=0).sum() < CODE_BEAMS * ranges.shape[1]:
            return limit
        limit = (top - 0.5) / 100
        counts[top] = 0
    return limit


def usual_reading(ranges: Float32Array) -> float | None:
    """Return the most frequent finite reading to the millimeter, meters; None without one."""
    readings, counts = np.unique(
        np.round(ranges[np.isfinite(ranges)].astype(np.float64), 3), return_counts=True
    )
    return float(readings[np.argmax(counts)]) if len(readings) else None


def _decode_ranges(ranges: Float32Array) -> Float32Array:
    """Convert codes to REP 117: NaN = invalid, -inf = too near."""
    invalid = np.zeros(ranges.shape, np.bool_)
    for code in SICK_INVALID:
        invalid |= np.abs(ranges - np.float32(code)) < 1e-3
    decoded = np.where(ranges < RANGE_MIN, np.float32(-np.inf), ranges)
    decoded[invalid] = np.nan
    return decoded


def _usual_config(name: str, n: int, parameters: Mapping[str, float]) -> LaserConfig:
    """Return the usual beam geometry for a number of beams, else that of PARAM lines."""
    if n in FIELDS:
        return _config(n, math.radians(FIELDS[n]))
    side = "rear" if name in REAR else "front"
    resolution = parameters.get(f"laser_{side}_laser_resolution", 0.0)
    fov = resolution * (n - n % 2)
    if not 0 < fov <= 360:
        raise ConfigError(
            f"{name} messages of {n} beams do not say how wide they see: give it (lirs-wct map --fov DEG)"
        )
    return _config(n, math.radians(fov))


def _config(n: int, fov: float) -> LaserConfig:
    """Spread beams over a field of view.

    An even number of beams omits the last direction (180 beams: -90..+89 deg).
    """
    return LaserConfig(-fov / 2, fov / max(n - n % 2, 1), math.inf)


def _mount(
    name: str, messages: Sequence[Message], parameters: Mapping[str, float], repaired: Counter[str]
) -> Pose3:
    """Return `T_base_laser` from the two logged poses, else from PARAM lines.

    The poses are rounded; older logs hold one pose twice.
    """
    mounts = [m.base.inverse() @ m.laser for m in messages if m.base is not None and m.laser is not None]
    found = _steady(mounts)
    if found is None:
        repaired["laser poses that do not follow the odometry: the laser is taken to be at the base"] = len(
            mounts
        )
        found = Pose2()
    if max(abs(found.x), abs(found.y), abs(found.yaw)) >= 1e-3:
        return Pose3.from_pose2(found)
    side, yaw = ("rear", math.pi) if name in REAR else ("front", 0.0)
    offset = parameters.get(f"robot_{side}laser_offset", 0.0)
    usable = abs(offset) < MOUNT_REACH
    return Pose3.from_pose2(Pose2(offset if usable else 0.0, 0.0, yaw)) if offset or yaw else Pose3()


def _steady(mounts: Sequence[Pose2]) -> Pose2 | None:
    """Return the median mount; None if most mounts differ from it (a corrected pose)."""
    if not mounts:
        return Pose2()
    x, y = (float(np.median([getattr(m, key) for m in mounts])) for key in ("x", "y"))
    yaws = np.array([m.yaw for m in mounts])
    yaw = float(math.atan2(np.median(np.sin(yaws)), np.median(np.cos(yaws))))
    off = [max(math.hypot(m.x - x, m.y - y), abs(math.remainder(m.yaw - yaw, math.tau))) for m in mounts]
    steady = float(np.median(off)) <= MOUNT_SPREAD and math.hypot(x, y) <= MOUNT_REACH
    return Pose2(x, y, yaw) if steady else None


LABEL = "# laser on base_link, x y z roll pitch yaw:"
"""Meters and radians follow."""


def mount_comment(T_base_laser: Pose3) -> str:
    """Return the comment line with the pose of the laser. Messages hold only the planar part."""
    x, y, z = T_base_laser.position.tolist()
    angles = f"{T_base_laser.roll:.6f} {T_base_laser.pitch:.6f} {T_base_laser.yaw:.6f}"
    return f"{LABEL} {x:.6f} {y:.6f} {z:.6f} {angles}\n"


def read_mount(path: Path) -> Pose3 | None:
    """Return `T_base_laser` from the comments before the first message; None without it."""
    for line in takewhile(lambda text: text.startswith(b"#"), readable_lines(path)):
        if line.startswith(LABEL.encode()):
            with suppress(ValueError):
                x, y, z, roll, pitch, yaw = map(float, line.removeprefix(LABEL.encode()).split())
                return Pose3.from_rpy(x, y, z, roll, pitch, yaw)
    return None
