"""A laser log of any file format: scans in file order, odometry, inertial readings, and rising stamps.

A line of a CARMEN log is stamped when its message passes the log's network. Messages wait there and come in
bursts, so the stamps of real logs go back and repeat while the robot moves on. The order of the lines is
right.

Wrong stamps are replaced by the nearest stamps, in the least squares' sense, that rise with the lines and
keep the log's usual speed limit between them. This is an isotonic regression (Barlow et al., Statistical
Inference under Order Restrictions, 1972) of the stamps less the least time between lines. A burst is thereby
spread over the gap around it. Stamps that already rise stay as logged.

The odometry is that of the laser's own messages, else that of ODOM lines, else none.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from lirs_wct.geometry import (
    BoolArray,
    Float32Array,
    FloatArray,
    Imu,
    ImuReadings,
    LaserScan,
    PointCloud,
    Pose2,
    Trajectory,
)


@dataclass(frozen=True, slots=True)
class LaserConfig:
    """Beams of a laser message: first angle and increment, radians; largest range, meters."""

    start: float
    step: float
    range_max: float


@dataclass(frozen=True, slots=True)
class Message:
    """A usable line: number, stamp in seconds, and what it holds of poses, ranges and beams.

    Attributes:
        base: `T_odom_base`.
        laser: `T_odom_laser`.
        ranges: (n,) Meters, as logged.
    """

    line: int
    stamp: float
    base: Pose2 | None
    laser: Pose2 | None = None
    ranges: Float32Array = field(default_factory=lambda: np.empty(0, np.float32))
    config: LaserConfig | None = None


@dataclass(frozen=True)
class LineStamps:
    """Stamps of every used line, in file order.

    Attributes:
        logged: (n,) Seconds, as in the file.
        repaired: (n,) Seconds, rising; equal to `logged` where no repair was needed.
        scans: (n,) Whether a line holds a scan.
    """

    logged: FloatArray
    repaired: FloatArray
    scans: BoolArray

    @property
    def back(self) -> int:
        """Count of steps between lines at which the stamp decreases."""
        return int((np.diff(self.logged) < 0).sum())

    @property
    def repeated(self) -> int:
        """Count of steps between lines at which the stamp repeats."""
        return int((np.diff(self.logged) == 0).sum())

    @property
    def moved(self) -> int:
        """Count of lines with a repaired stamp."""
        return int((self.repaired != self.logged).sum())

    @property
    def furthest(self) -> float:
        """Largest change of a stamp by the repair, seconds."""
        return float(np.abs(self.repaired - self.logged).max(initial=0.0))

    def repaired_at(self, stamps: FloatArray) -> FloatArray:
        """Return (m,) repaired stamps: each moves like the nearest line, scans preferred."""
        order = np.lexsort((~self.scans, self.logged))
        logged, shift = self.logged[order], (self.repaired - self.logged)[order]
        after = np.clip(np.searchsorted(logged, stamps), 0, len(logged) - 1)
        before = np.maximum(after - 1, 0)
        nearest = np.where(stamps - logged[before] < logged[after] - stamps, before, after)
        moved: FloatArray = stamps + shift[nearest]
        return moved

    def summary(self) -> str:
        """Return one line about faults of the stamps and their repair."""
        steps = f"{len(self.logged) - 1:,}"
        return (
            f"stamps go back at {self.back:,} of {steps} steps and repeat at {self.repeated:,}: "
            f"the order of the file is kept, {self.moved:,} stamps moved by up to {self.furthest:.2f} s"
        )


@dataclass(frozen=True, eq=False)
class LogTopic:
    """Messages of one topic, or of one name in a CARMEN log.

    Attributes:
        frames: Frames of its messages; of poses "parent -> child".
        stamps: (n,) Stamps in the order of the log, seconds.
        received: (n,) Times of reception, seconds; empty where unknown.
    """

    name: str
    frames: tuple[str, ...]
    stamps: FloatArray
    received: FloatArray


@dataclass(frozen=True)
class LaserLog:
    """A laser log in file order.

    Attributes:
        scans: Planar scans in file order; their stamps increase strictly.
        odometry: `T_odom_base` of each scan, as many as scans; all None where the log holds no odometry.
        track: Every pose that the log's odometry gives, of messages with and without a scan; may be empty.
        lines: Stamps of the lines as logged and as repaired; scans and track have the repaired ones.
        skipped: Count of skipped lines by reason.
        late: Lines whose logged stamp is before that of an earlier line.
        repaired: Count of repairs by kind.
        laser: Message name of the scans.
        left_out: Number of scans that could not be used.
        clouds: Point clouds in place of scans, read one by one; None of a log of planar scans.
        imu: Inertial readings with attitude; a CARMEN log holds none.
        inertial: All inertial readings, with or without attitude, by stamp.
        topics: Topics of the scans, of the odometry, and of the inertial readings, as far as they exist.
    """

    scans: tuple[LaserScan, ...]
    odometry: tuple[Pose2 | None, ...]
    track: Trajectory
    lines: LineStamps
    skipped: Mapping[str, int] = field(default_factory=dict)
    late: int = 0
    repaired: Mapping[str, int] = field(default_factory=dict)
    laser: str = "FLASER"
    left_out: int = 0
    clouds: Iterable[PointCloud] | None = None
    imu: tuple[Imu, ...] = ()
    inertial: ImuReadings | None = None
    topics: tuple[LogTopic, ...] = ()

    @property
    def stamps(self) -> FloatArray:
        """(n,) stamps of the scans or clouds, seconds."""
        return self.lines.repaired[self.lines.scans]


MAX_DELAY = 10.0
"""Longest delay, seconds; a larger step back is a damaged line or a clock that was set."""
WINDOW_LINES = 20
"""Lines over which pace and speed are measured, so that delays average out."""
SPEED_PERCENTILE, SPEED_FACTOR = 99.0, 1.25
"""Speed limit between repaired lines: this percentile of the speed over windows, times the factor."""
MIN_STEP = 1e-3
"""Seconds between repaired lines, at least."""
DEFAULT_STEP = 0.1
"""Seconds between the lines of a log whose stamps are all the same."""
STAMP_RESOLUTION = 1e-6
"""Resolution of logged stamps (six decimals), seconds."""


def in_file_order(
    scans: Sequence[Message], odoms: Sequence[Message]
) -> tuple[list[Message], list[Message], LineStamps]:
    """Return messages with a scan (at least one) and without, in file order with rising stamps.

    If a file holds one kind of message after the other, only the stamps order the two kinds.
    """
    lines = sorted([*scans, *odoms], key=lambda m: m.line)
    if (
        _steps(lines).min(initial=0) < -MAX_DELAY
        and min(_steps(k).min(initial=0) for k in (scans, odoms)) >= 0
    ):
        lines.sort(key=lambda m: m.stamp)
    holds_scan = np.array([len(m.ranges) > 0 for m in lines])
    logged = np.array([m.stamp for m in lines])
    distances = _motion(lines)
    steps, moving = np.diff(logged), (distances > 0).any(axis=1)
    rises = (steps >= 0).all() and (steps[moving] > 0).all() and (np.diff(logged[holds_scan]) > 0).all()
    repaired = logged if rises else _rising(logged, distances)
    moved = [replace(m, stamp=stamp) for m, stamp in zip(lines, repaired.tolist(), strict=True)]
    return (
        [m for m in moved if len(m.ranges)],
        [m for m in moved if not len(m.ranges)],
        LineStamps(logged, repaired, holds_scan),
    )


def _steps(lines: Sequence[Message]) -> FloatArray:
    """Return (n - 1,) seconds from line to line."""
    return np.diff(np.array([m.stamp for m in lines]))


def _motion(lines: Sequence[Message]) -> FloatArray:
    """Return (n - 1, 2) meters and radians from line to line.

    A line without a pose has that of the line before or after it, whichever is nearer in time. Constant poses
    of scans are ignored: the odometry is then in the other lines.
    """
    own = len({m.base for m in lines if len(m.ranges)}) > 1
    bases = [m.base if own or not len(m.ranges) else None for m in lines]
    posed = np.flatnonzero([base is not None for base in bases])
    if len(posed) == 0:
        return np.zeros((len(lines) - 1, 2))
    at, stamps = np.arange(len(lines)), np.array([m.stamp for m in lines])
    after = posed[np.minimum(np.searchsorted(posed, at), len(posed) - 1)]
    before = posed[np.maximum(np.searchsorted(posed, at, side="right") - 1, 0)]
    nearer = np.where(np.abs(stamps[after] - stamps) <= np.abs(stamps - stamps[before]), after, before)
    known = {k: bases[k] or Pose2() for k in posed.tolist()}
    steps = np.diff(np.array([known[k].as_array() for k in nearer.tolist()]), axis=0)
    turn = np.abs(np.remainder(steps[:, 2] + np.pi, 2 * np.pi) - np.pi)
    return np.column_stack((np.hypot(steps[:, 0], steps[:, 1]), turn))


def _rising(logged: FloatArray, distances: FloatArray) -> FloatArray:
    """Return (n,) rising stamps, unchanged where they are right."""
    from scipy.optimize import isotonic_regression  # imported here: sound logs do not need it

    start = float(np.median(logged))
    stamps = logged - start
    least = np.concatenate(((0.0,), np.cumsum(_least_steps(stamps, distances))))
    rising = isotonic_regression(stamps - least).x + least
    repaired: FloatArray = np.where(
        np.abs(rising + start - logged) < STAMP_RESOLUTION, logged, rising + start
    )
    return repaired


def _least_steps(stamps: FloatArray, distances: FloatArray) -> FloatArray:
    """Return (n - 1,) the least time between lines at the log's speed limit, seconds."""
    n = min(WINDOW_LINES, len(stamps) - 1)
    span = stamps[n:] - stamps[:-n]
    pace = float(np.median(span)) / n
    pace = pace if pace > 0 else float(np.ptp(stamps)) / (len(stamps) - 1) or DEFAULT_STEP
    path = np.concatenate((np.zeros((1, 2)), np.cumsum(distances, axis=0)))
    # A window much shorter than most is a burst, which does not show the speed.
    speeds = (path[n:] - path[:-n]) / np.maximum(span, n * pace / 2)[:, None]
    limit = SPEED_FACTOR * np.percentile(speeds, SPEED_PERCENTILE, axis=0)
    takes = np.divide(distances, limit, out=np.zeros_like(distances), where=limit > 0).max(axis=1)
    least: FloatArray = np.clip(takes, MIN_STEP, max(pace, MIN_STEP))
    return least


MAX_DISAGREEMENT = 1.0
"""Largest median distance of two sources in the same frame, meters."""


def odometry_of(scans: Sequence[Message], odoms: Sequence[Message]) -> tuple[list[Pose2 | None], Trajectory]:
    """Return `T_odom_base` of each scan, and the track of all poses; constant odometry counts as none."""
    own, wheels = _track(scans), _track(odoms)
    if _moves(own) or (len(scans) == 1 and len(own)):
        return [m.base for m in scans], _add_wheel_poses(own, wheels)
    if _moves(wheels):
        at = wheels.planar_at(np.array([m.stamp for m in scans]))
        return [Pose2(*row) for row in at.tolist()], wheels
    return [None] * len(scans), Trajectory.from_poses([], [])


def _track(messages: Sequence[Message]) -> Trajectory:
    """Return the poses by stamp; of equal stamps, the later line's."""
    poses = {m.stamp: m.base for m in messages if m.base is not None}
    stamps = sorted(poses)
    return Trajectory.from_poses(stamps, [poses[t] for t in stamps])


def _moves(track: Trajectory) -> bool:
    if len(track) < 2:
        return False
    return bool(np.ptp(track.xy, axis=0).any() or np.ptp(track.quaternions, axis=0).any())


def _add_wheel_poses(own: Trajectory, wheels: Trajectory) -> Trajectory:
    """Add the poses of ODOM lines between scans if they share the scans' frame."""
    if len(wheels) == 0:
        return own
    far = np.linalg.norm(wheels.planar_at(own.stamps)[:, :2] - own.xy, axis=1)
    if len(own) > 1 and float(np.median(far)) > MAX_DISAGREEMENT:
        return own
    fresh = ~np.isin(wheels.stamps, own.stamps)
    stamps = np.concatenate((own.stamps, wheels.stamps[fresh]))
    order = np.argsort(stamps)
    return Trajectory(
        stamps[order],
        np.concatenate((own.positions, wheels.positions[fresh]))[order],
        np.concatenate((own.quaternions, wheels.quaternions[fresh]))[order],
    )
