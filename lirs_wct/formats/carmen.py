"""CARMEN logs (.clf, .log, also gzipped): laser scans with the odometry of the robot that made them.

Read are `FLASER`, `ROBOTLASER1` and `ODOM` messages; what else the log holds is counted, not kept.
"""

from __future__ import annotations

import gzip
import math
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lirs_wct.errors import SourceError
from lirs_wct.pose import Pose2, Pose3
from lirs_wct.scan import LaserScan
from lirs_wct.trajectory import Trajectory

SICK_INVALID = (81.87, 81.88, 81.89, 81.90, 81.91)
"""Codes of the SICK LMS for "no valid measurement" (dazzled, too noisy): NaN, they say nothing, metres."""
NO_RETURN = 50.0
"""Ranges from here on mean that nothing came back (50, 51.2, 81.83): +inf, metres."""
RANGE_MIN = 0.02
"""A SICK LMS measures from its front pane on; shorter ranges are errors, metres."""


@dataclass(frozen=True)
class CarmenLog:
    """A log as read, sorted by stamp.

    Attributes:
        scans: by stamp, strictly increasing.
        odometry: `T_odom_base` of each scan, as many as scans.
        track: every pose that the log's odometry gives, of messages with and without a scan.
        skipped: how many lines were left out, by reason.
        late: lines whose stamp was before that of an earlier line; they were sorted in and kept.
    """

    scans: tuple[LaserScan, ...]
    odometry: tuple[Pose2, ...]
    track: Trajectory
    skipped: Mapping[str, int] = field(default_factory=dict)
    late: int = 0

    @property
    def stamps(self) -> NDArray[np.float64]:
        """(n,) seconds, of the scans."""
        return np.array([scan.stamp for scan in self.scans])


def read_carmen(path: Path) -> CarmenLog:
    """Read a CARMEN log; lines that cannot be used are skipped and counted.

    Raises:
        SourceError: the file cannot be read, is not text, or holds no usable laser scan.
    """
    scans: dict[float, tuple[LaserScan, Pose2]] = {}
    track: dict[float, Pose2] = {}
    skipped: Counter[str] = Counter()
    late, newest = 0, -math.inf
    for words in _messages(path):
        try:
            stamp, pose, scan = _parse(words)
        except _SkippedError as reason:
            skipped[str(reason)] += 1
            continue
        if scan is not None and stamp in scans:
            skipped["stamp of an earlier scan repeated"] += 1
            continue
        late += stamp < newest
        newest = max(newest, stamp)
        track[stamp] = pose
        if scan is not None:
            scans[stamp] = scan, pose
    if not scans:
        raise SourceError(
            f"{path}: no usable laser scan (FLASER or ROBOTLASER1) in this CARMEN log{_told(skipped)}"
        )
    ordered = [scans[t] for t in sorted(scans)]
    times = sorted(track)
    return CarmenLog(
        tuple(s for s, _ in ordered),
        tuple(p for _, p in ordered),
        Trajectory.from_poses(times, [track[t] for t in times]),
        dict(skipped),
        late,
    )


class _SkippedError(Exception):
    """Why a line is left out."""


def _told(skipped: Counter[str]) -> str:
    return "; skipped: " + ", ".join(f"{n} x {why}" for why, n in skipped.items()) if skipped else ""


def _messages(path: Path) -> Iterator[list[str]]:
    """Yield the words of each line that is neither empty nor a comment."""
    try:
        with path.open("rb") as raw:
            zipped = raw.read(2) == b"\x1f\x8b"
        with gzip.open(path, "rt") if zipped else path.open("rt") as lines:
            for line in lines:
                words = line.split()
                if words and not words[0].startswith("#"):
                    yield words
    except UnicodeDecodeError as error:
        raise SourceError(f"{path}: not a text file, a CARMEN log is one") from error
    except (EOFError, zlib.error) as error:
        raise SourceError(f"{path}: the gzip stream is damaged or cut off ({error})") from error
    except OSError as error:
        raise SourceError(f"{path}: cannot be read: {error.strerror or error}") from error


def _parse(words: list[str]) -> tuple[float, Pose2, LaserScan | None]:
    """Return stamp, odometry and scan, if any, of one message."""
    parsers = {"FLASER": _flaser, "ROBOTLASER1": _robotlaser, "ODOM": _odom}
    parser = parsers.get(words[0])
    if parser is None:
        raise _SkippedError(f"message {words[0][:20]}" if words[0].isidentifier() else "not a message")
    try:
        stamp, pose, scan = parser(words)
    except (ValueError, IndexError):
        raise _SkippedError(f"{words[0]} cut off or malformed") from None
    if not all(map(math.isfinite, (stamp, pose.x, pose.y, pose.yaw))):
        raise _SkippedError(f"{words[0]} whose stamp or pose is not finite")
    return stamp, pose, scan


def _odom(words: list[str]) -> tuple[float, Pose2, None]:
    """`ODOM x y theta tv rv accel ipc_stamp host logger_stamp`."""
    return float(words[7]), _pose(words[1:4]), None


def _flaser(words: list[str]) -> tuple[float, Pose2, LaserScan]:
    """`FLASER n r... x y theta odom_x odom_y odom_theta ipc_stamp host logger_stamp`."""
    n = _count(words[1])
    rest = words[2 + n :]
    stamp, laser, base = float(rest[6]), _pose(rest[0:3]), _pose(rest[3:6])
    start, step = _field_of_view(n)
    return stamp, base, _scan(words[2 : 2 + n], stamp, start, step, NO_RETURN, _mount(base, laser))


def _robotlaser(words: list[str]) -> tuple[float, Pose2, LaserScan]:
    """`ROBOTLASER1 type start fov step max accuracy remission n r... m rem... laser robot ... stamp`."""
    start, step, most = float(words[2]), float(words[4]), float(words[5])
    n = _count(words[8])
    rest = words[9 + n :]
    rest = rest[1 + _count(rest[0], least=0) :]
    stamp, laser, base = float(rest[11]), _pose(rest[0:3]), _pose(rest[3:6])
    if not (step > 0 and most > 0):
        raise ValueError
    return stamp, base, _scan(words[9 : 9 + n], stamp, start, step, min(most, NO_RETURN), _mount(base, laser))


def _count(word: str, least: int = 1) -> int:
    n = int(word)
    if n < least:
        raise ValueError
    return n


def _pose(words: list[str]) -> Pose2:
    x, y, yaw = map(float, words)
    return Pose2(x, y, yaw)


def _mount(base: Pose2, laser: Pose2) -> Pose3:
    """Return `T_base_laser`; the log holds both poses, rounded, so less than 1 mm is nothing."""
    mount = base.inverse() @ laser
    moved = max(abs(mount.x), abs(mount.y), abs(mount.yaw)) >= 1e-3
    return Pose3.from_pose2(mount) if moved else Pose3()


def _field_of_view(n: int) -> tuple[float, float]:
    """Return first angle and increment of a FLASER: the message holds neither.

    An even number of beams leaves out the last of the field of view (180 beams: -90..+89 deg).
    """
    fov = math.radians(270.0) if n in (540, 541, 1080, 1081) else math.pi
    return -fov / 2, fov / (n - n % 2 if n > 1 else 1)


def _scan(words: list[str], stamp: float, start: float, step: float, most: float, mount: Pose3) -> LaserScan:
    """Build the scan with its codes as REP 117 has them."""
    r = np.array(words, dtype=np.float64)
    code = np.isclose(r[:, None], SICK_INVALID, atol=1e-3).any(axis=1)
    ranges = np.where(r < RANGE_MIN, -np.inf, np.where(r >= most, np.inf, r))
    ranges[code | np.isnan(r)] = np.nan
    return LaserScan(ranges.astype(np.float32), start, step, RANGE_MIN, most, stamp, mount)
