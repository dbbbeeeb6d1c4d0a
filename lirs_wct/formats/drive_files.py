"""Text files of a drive: scans, waypoints, velocity commands, inertial readings, trajectories."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lirs_wct.errors import SourceError
from lirs_wct.files import atomic_write, read_text, readable_lines, write_gzipped
from lirs_wct.formats import MAPS, yaml_text
from lirs_wct.geometry import FloatArray, Imu, LaserScan, Pose2, Pose3, Trajectory

COMMANDS_HEADER = "time,v,omega"
"""Time of the command since the start, seconds; m/s; rad/s."""
START = "# start"
"""Begins the line with the start pose: x, y, yaw in the world frame, meters and radians."""
IMU_HEADER = "stamp,roll,pitch,rate_x,rate_y,rate_z,acceleration_x,acceleration_y,acceleration_z"
"""Seconds; radians, REP 103; rad/s; m/s^2 with +9.81 on z at rest; all of base_link."""


@dataclass(frozen=True)
class Commands:
    """The velocity commands of a drive.

    Attributes:
        start: Start pose of the robot, world frame.
        rows: (n, 3) Time in seconds, speed in m/s, turn rate in rad/s.
    """

    start: Pose2
    rows: FloatArray


def write_commands(path: Path, commands: Commands) -> None:
    """Write commands; numbers read back exactly."""
    lines = [f"{START} {' '.join(map(repr, commands.start.as_array().tolist()))}", COMMANDS_HEADER]
    lines += [",".join(map(repr, row)) for row in commands.rows.tolist()]
    with atomic_write(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")


def read_commands(path: Path) -> Commands:
    """Read commands: three finite numbers a line."""
    first, *lines = read_text(path).splitlines() or [""]
    start = _finite(first.removeprefix(START).split())
    if not first.startswith(START) or len(start) != 3:
        raise SourceError(f"{path}: line 1: commands begin with '{START} X Y YAW', got {first!r:.60}")
    return Commands(Pose2(*start), _read_rows(path, lines, COMMANDS_HEADER, 2))


def write_imu(path: Path, readings: Iterable[Imu]) -> None:
    """Write inertial readings, gzipped; the same data give the same bytes."""
    rows = [reading.row for reading in readings]
    with write_gzipped(path) as zipped:
        np.savetxt(zipped, rows, fmt="%.9g", delimiter=",", header=IMU_HEADER, comments="")


def read_imu(path: Path) -> tuple[Imu, ...]:
    """Read inertial readings, gzipped or not: as many finite numbers a line as the header has names."""
    rows = _read_rows(path, read_text(path).splitlines(), IMU_HEADER, 1)
    return tuple(Imu.from_row(*row) for row in rows.tolist())


MOUNT = "# laser on base_link, x y z roll pitch yaw:"
"""Meters and radians follow."""
INVALID = 81.91
"""Code of an invalid measurement, meters, as a SICK has it."""
SCANS_HEADER = (
    "# CARMEN log: ROBOTLASER1 laser_type start_angle field_of_view angular_resolution maximum_range\n"
    "#   accuracy remission_mode num_readings [ranges] num_remissions laser_x laser_y laser_theta\n"
    "#   robot_x robot_y robot_theta laser_tv laser_rv forward_safety_dist side_safety_dist turn_axis\n"
    "#   timestamp host logger_timestamp\n"
    "# meters, radians, seconds since the start; the robot's pose is its odometry\n"
)


def write_scans(path: Path, scans: Iterable[tuple[LaserScan, Pose2]]) -> None:
    """Write scans and their odometry `T_odom_base` as a CARMEN log; the same data give the same bytes.

    Its `ROBOTLASER1` messages state start angle, field of view, resolution and largest range, so that no
    reader has to assume 180 degrees. They hold only the planar part of the laser's mount (x, y, yaw); a
    comment holds all of it.
    """
    with write_gzipped(path) as zipped:
        zipped.write(SCANS_HEADER.encode())
        for k, (scan, T_odom_base) in enumerate(scans):
            if k == 0:
                mount = scan.T_base_laser
                values = *mount.position.tolist(), mount.roll, mount.pitch, mount.yaw
                zipped.write(f"{MOUNT} {' '.join(f'{value:.6f}' for value in values)}\n".encode())
            zipped.write(_message(scan, T_odom_base))


def _message(scan: LaserScan, T_odom_base: Pose2) -> bytes:
    """Return a line with ranges in millimeters; no return is the largest range, too near is 0."""
    n = len(scan.ranges)
    poses = T_odom_base @ scan.T_base_laser.to_pose2(), T_odom_base
    fov = scan.angle_increment * (n - 1)
    farthest = scan.limits[1]
    geometry = f"{scan.angle_min:.9f} {fov:.9f} {scan.angle_increment:.12f} {farthest:.3f}"
    places = " ".join(f"{pose.x:.6f} {pose.y:.6f} {pose.yaw:.8f}" for pose in poses)
    stamp = f"{scan.stamp:.6f}"
    before, after = f"ROBOTLASER1 0 {geometry} 0 0 {n}", f" 0 {places} 0 0 0 0 0 {stamp} lirs-wct {stamp}\n"
    texts = _formatted_ranges(math.ceil(farthest * 1000) + 1)
    none = len(texts) - 2  # a hit stays below
    mm = np.rint(np.where(np.isfinite(scan.ranges), scan.ranges, 0) * 1000.0)
    mm = np.clip(mm, 0, none - 1).astype(np.int64)
    mm[scan.ranges == np.inf] = none
    mm[np.isnan(scan.ranges)] = -1
    return before.encode() + texts[mm].tobytes().translate(None, b"\0") + after.encode()


@cache
def _formatted_ranges(millimeters: int) -> NDArray[np.bytes_]:
    """Return texts of ranges by millimeter, a space before each; the last means invalid."""
    return np.array([*(f" {mm / 1000:.3f}" for mm in range(millimeters)), f" {INVALID:.2f}"], np.bytes_)


def read_mount(path: Path) -> Pose3 | None:
    """Return `T_base_laser` from the comments before a log's first message; None without it."""
    for line in takewhile(lambda text: text.startswith(b"#"), readable_lines(path)):
        if line.startswith(MOUNT.encode()):
            with suppress(ValueError):
                x, y, z, roll, pitch, yaw = map(float, line.removeprefix(MOUNT.encode()).split())
                return Pose3.from_rpy(x, y, z, roll, pitch, yaw)
    return None


def _read_rows(path: Path, lines: Sequence[str], header: str, number: int) -> FloatArray:
    """Return the numbers of lines with commas below a header, which stands on the line of a number."""
    columns = header.count(",") + 1
    if lines[:1] != [header]:
        raise SourceError(f"{path}: line {number}: the header {header} is needed, got {lines[:1]!s:.60}")
    rows = [_finite(line.split(",")) for line in lines[1:]]
    for k, row in enumerate(rows, 1):
        if len(row) != columns:
            raise SourceError(
                f"{path}: line {number + k}: {columns} finite numbers are needed, got {lines[k]!r:.60}"
            )
    return np.array(rows, np.float64).reshape(-1, columns)


def _finite(words: Iterable[Any]) -> list[float]:
    """Return words as numbers; empty if one is no finite number."""
    try:
        numbers = [float(word) for word in words if not isinstance(word, bool)]
    except (TypeError, ValueError):
        return []
    return numbers if all(map(math.isfinite, numbers)) else []


NAMES = ["x", "y", "yaw"]


@dataclass(frozen=True)
class RoutePoint:
    """A position to reach; `yaw` = heading there, None = any."""

    x: float
    y: float
    yaw: float | None = None


def read_waypoints(path: Path) -> tuple[RoutePoint, ...]:
    """Read waypoints.

    Text and CSV: one waypoint per line, numbers separated by commas or blanks. `#` begins a comment, and a
    first line `x,y,yaw` is a heading. YAML (`.yaml`, `.yml`): a list of `[x, y]`, `[x, y, yaw]` or
    `{x: ..., y: ..., yaw: ...}`, plain or under `waypoints:`. At least two are needed.
    """
    text = read_text(path)
    lines = [line.partition("#")[0].replace(",", " ").split() for line in text.splitlines()]
    entries: list[tuple[str, Any]] = [
        (f"line {number}", words) for number, words in enumerate(lines, 1) if words
    ]
    if path.suffix.lower() in MAPS:
        entries = _yaml_entries(path, text)
    elif entries and [word.lower() for word in entries[0][1]] in (NAMES, NAMES[:2]):
        del entries[0]
    waypoints = []
    for place, values in entries:
        numbers = _finite(values) if isinstance(values, list) else []
        if len(numbers) not in (2, 3) or len(numbers) != len(values):
            raise SourceError(
                f"{path}: {place}: a waypoint is x, y and perhaps yaw (finite numbers), got {values!r}"
            )
        waypoints.append(RoutePoint(*numbers))
    if len(waypoints) < 2:
        raise SourceError(
            f"{path}: at least 2 waypoints are needed, the first is the start; got {len(waypoints)}"
        )
    return tuple(waypoints)


def _yaml_entries(path: Path, text: str) -> list[tuple[str, Any]]:
    """Return the name and the values of each waypoint; mappings of other names have none."""
    try:
        entries = yaml_text.load_yaml(text)
    except ValueError as error:
        raise SourceError(f"{path}: {error}") from error
    if isinstance(entries, dict) and set(entries) == {"waypoints"}:
        entries = entries["waypoints"]
    if not isinstance(entries, list):
        raise SourceError(f"{path}: a YAML list of waypoints is needed, got {entries!r:.40}")
    rows = [
        [entry[name] for name in NAMES if name in entry]
        if isinstance(entry, dict) and set(entry) in ({"x", "y"}, set(NAMES))
        else entry
        for entry in entries
    ]
    return [(f"waypoint {k}", row) for k, row in enumerate(rows, 1)]


MAX_COORDINATE = 1e9
"""Largest coordinate, meters; squares of far larger ones overflow."""
NANOSECONDS, PERIOD = 1e15, 1e5
"""Smallest stamp of a wall clock, and period of poses, in nanoseconds."""


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """Write a trajectory, rounded to the nanometer and the nanosecond."""
    rows = np.column_stack(
        (trajectory.stamps, trajectory.positions, np.roll(trajectory.quaternions, -1, axis=1))
    )
    with atomic_write(path) as temporary:
        np.savetxt(temporary, rows, fmt="%.9f", header="# stamp[s] x y z[m] qx qy qz qw", comments="")


TRIANGLE = [8, 9, 10, 9, 11, 12, 10, 12, 13]
"""Columns of a TUM file that make a covariance of x, y, yaw."""


def read_tum(path: Path, scans: FloatArray | None = None) -> Trajectory:
    """Read a trajectory: TUM, EuRoC (commas, nanoseconds) or KITTI (12 numbers a line).

    Six more numbers of a TUM file are the upper triangle of the covariance of x, y, yaw: meters and radians.
    Stamps may be out of order or repeat; of equal stamps the last pose counts, and a warning says so. A KITTI
    file lacks stamps: its poses get those of the scans, seconds.
    """
    text = read_text(path, errors="replace")
    lines = [re.split(r"[,\s]+", line.strip(", \t")) for line in text.splitlines() if line.strip(", \t")]
    lines = [words for words in lines if not words[0].startswith("#")]
    try:
        rows = np.array([[float(word) for word in words] for words in lines])
    except ValueError as error:  # a word, or lines of different lengths
        raise SourceError(f"{path}: not a trajectory: {' '.join(str(error).split())[:100]}") from error
    width = rows.shape[1] if rows.ndim == 2 else 0
    if width not in (8, 12, 14) and not (width > 8 and "," in text):
        forms = "8 numbers a line (TUM), 14 with a covariance, 12 (KITTI) or commas (EuRoC)"
        raise SourceError(f"{path}: a trajectory has {forms}")
    if width == 12 and "," not in text:
        return _kitti(path, rows, scans)
    nanoseconds = rows[:, 0].max() > NANOSECONDS or np.median(np.abs(np.diff(rows[:, 0], prepend=0))) > PERIOD
    if nanoseconds and "," in text:  # EuRoC has w first
        rows[:, 4:8] = np.roll(rows[:, 4:8], -1, axis=1)
    claimed = rows[:, TRIANGLE].reshape(-1, 3, 3) if width == 14 and "," not in text else None
    rows = rows[:, :8] * np.where(np.arange(8) == 0, 1e-9 if nanoseconds else 1.0, 1.0)
    stamps, last = np.unique(rows[::-1, 0], return_index=True)
    unordered, equal = int((np.diff(rows[:, 0]) < 0).sum()), len(rows) - len(stamps)
    if unordered or equal:
        said = f"stamps go back {unordered} times, {equal} poses of equal stamps are left out"
        warnings.warn(f"{path}: {said}", stacklevel=2)
    covariances = None if claimed is None else claimed[::-1][last]
    return replace(_trajectory(path, rows[::-1][last]), covariances=covariances)


def _kitti(path: Path, rows: FloatArray, scans: FloatArray | None) -> Trajectory:
    """Return poses given as the upper three rows of a matrix each, one per scan."""
    if scans is None or len(scans) != len(rows):
        wanted = "stamps, as a TUM file has them" if scans is None else f"one pose per scan, {len(scans)}"
        raise SourceError(f"{path}: a KITTI file has no stamps: needs {wanted}, got {len(rows)} poses")
    matrices = rows.reshape(-1, 3, 4)
    if not (np.isfinite(rows).all() and np.allclose(np.linalg.det(matrices[:, :, :3]), 1.0, atol=0.1)):
        raise SourceError(f"{path}: not a KITTI trajectory: its matrices are no rotations")
    quaternions = Rotation.from_matrix(matrices[:, :, :3]).as_quat()
    return _trajectory(path, np.column_stack((scans, matrices[:, :, 3], quaternions)))


def _trajectory(path: Path, rows: FloatArray) -> Trajectory:
    """Build a trajectory from rows (n, 8) of a TUM file, with rising stamps."""
    length = np.linalg.norm(rows[:, 4:], axis=1, keepdims=True)
    if not (np.isfinite(rows).all() and length.all()):
        raise SourceError(f"{path}: not a trajectory: its numbers must be finite, and no quaternion zero")
    if (farthest := float(np.abs(rows[:, 1:4]).max())) > MAX_COORDINATE:
        raise SourceError(f"{path}: a position must be within {MAX_COORDINATE:.0e} m, got {farthest:.3g} m")
    return Trajectory(rows[:, 0], rows[:, 1:4], np.roll(rows[:, 4:], 1, axis=1) / length)
