"""Preflight of a log: rates, stamps, mounts, ranges and motion, before a mapper runs."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from lirs_wct.arrays import FloatArray
from lirs_wct.formats.laser_log import LaserLog, LogTopic

TILTED = math.radians(20)
"""Smallest angle between the scan plane and the ground at which a scan is no plan of the place."""
LAG, ANOTHER = 0.3, 60.0
"""Smallest difference of two clocks that spoils a map, and from which one is no wall clock, seconds."""
PAUSE, PERIODS = 1.0, 5.0
"""Shortest pause of a topic, seconds, and in its periods."""
LATE = 0.5
"""Shortest time by which the odometry begins or ends too late or early, seconds."""
JUMP, FAST, MAX_JUMP = 1.0, 10.0, 1000.0
"""Shortest jump of the odometry, meters, the speed over it, m/s, and a jump that leaves no map, meters."""
FEW_RETURNS, SEEING = 10, 0.5
"""Returns of a scan that sees its surroundings, and share of such scans, at least."""
FROZEN = 0.5
"""Longest path on which a scan may stay the same to the last digit, meters."""
WINDOW = 0.5
"""Time over which the motion is measured, seconds."""
STANDING, STANDING_TURN, REST = 0.01, 0.01, 50
"""Motion of a robot at rest, m/s and rad/s, at most; its inertial readings, at least."""
SHAKY = 0.05
"""Smallest noise of a gyroscope at rest that deserves a word, rad/s."""


@dataclass(frozen=True)
class Deviation:
    """Deviation of a log.

    Attributes:
        text: Deviation in words.
        remedy: Option or step that helps; empty = none.
        unfit: Whether a planar map of the log will be wrong.
        hopeless: Whether a map of the log would not fit into memory.
    """

    text: str
    remedy: str = ""
    unfit: bool = False
    hopeless: bool = False

    def __str__(self) -> str:
        return f"{self.text}{self.remedy and f': {self.remedy}'}"


@dataclass(frozen=True)
class Preflight:
    """Facts of a log, its deviations, and repairs of its reader.

    The deviations that spoil a map come first.
    """

    facts: tuple[tuple[str, str], ...]
    findings: tuple[Deviation, ...]
    repairs: tuple[str, ...]

    @property
    def notes(self) -> tuple[tuple[str, str], ...]:
        """Deviations and repairs, to be shown as a table."""
        deviations = (("deviation", str(finding)) for finding in self.findings)
        return *deviations, *(("put right", repair) for repair in self.repairs)

    @property
    def unfit(self) -> str:
        """First reason why a map will be wrong, with its remedy; else empty."""
        return next((str(finding) for finding in self.findings if finding.unfit), "")

    @property
    def sentence(self) -> str:
        """Conclusion for the user."""
        if self.unfit:
            return f"not fit for planar mapping: {self.unfit}"
        advice = next((f"; {finding}" for finding in self.findings if finding.remedy), "")
        return f"fit for planar mapping{advice}"


def check_log_data(log: LaserLog) -> Preflight:
    """Measure a log's data and look for faults, in one pass."""
    checks = _clock_faults, _odometry_faults, _scan_faults, _inertial_faults, _pauses
    findings = sorted((found for check in checks for found in check(log)), key=lambda found: not found.unfit)
    skipped = (f"{count} {reason} skipped" for reason, count in log.skipped.items())
    return Preflight(tuple(_facts(log)), tuple(findings), (*log.repaired, *skipped))


def _facts(log: LaserLog) -> Iterator[tuple[str, str]]:
    for topic in log.topics:
        seconds = float(np.ptp(topic.stamps))
        rate = f", {(len(topic.stamps) - 1) / seconds:.1f} Hz" if seconds > 0 else ""
        frames = f", {', '.join(topic.frames)}" if any(topic.frames) else ""
        lag = _lag(topic)
        late = "" if lag is None or abs(lag) > ANOTHER else f", stamps {1000 * lag:.0f} ms before reception"
        yield topic.name, f"{len(topic.stamps)} messages{rate}{frames}{late}"
    stamps = log.stamps
    yield "time", f"{stamps[-1] - stamps[0]:.1f} s from {stamps[0]:.3f} s"
    if len(log.topics) > 1 and len(log.track):
        a, b = (topic.stamps for topic in log.topics[:2])
        common = float(min(a.max(), b.max()) - max(a.min(), b.min()))
        yield "common to scans and odometry", f"{max(0.0, common):.1f} s"
    if len(log.track) > 1:
        _, speed, turn = _motion(log)
        fastest = f"{speed.max(initial=0.0):.2f} m/s, {np.degrees(turn.max(initial=0.0)):.0f} deg/s"
        yield "motion by odometry", f"{log.track.length:.1f} m, at most {fastest}"
    if log.scans:
        yield from _scan_facts(log)
    gyro = _gyro_at_rest(log)
    if gyro is not None:
        yield "gyroscope at rest", f"noise {gyro[0]:.4f} rad/s, mean {gyro[1]:.4f} rad/s"


def _scan_facts(log: LaserLog) -> Iterator[tuple[str, str]]:
    first = log.scans[0]
    T = first.T_base_laser
    angles = ", ".join(f"{np.degrees(angle):.1f}" for angle in (T.roll, T.pitch, T.yaw))
    yield "laser on the base", f"{T.x:.3f}, {T.y:.3f}, {T.z:.3f} m; {angles} deg"
    field = f"{abs(np.degrees(first.angle_increment)) * (len(first.ranges) - 1):.1f} deg"
    yield "beams", f"{len(first.ranges)} over {field}, {first.range_min:g} to {first.range_max:g} m"
    readings = np.concatenate([scan.ranges for scan in log.scans[:: max(1, len(log.scans) // 500)]])
    hits = readings[np.isfinite(readings)]
    shares = (hits.size, (readings == np.inf).sum(), np.isnan(readings).sum())
    returned, none, invalid = (f"{100 * count / readings.size:.0f} %" for count in shares)
    longest = f", up to {hits.max():.2f} m" if hits.size else ""
    yield "ranges", f"{returned} measured{longest}; {none} no return, {invalid} invalid"


def _lag(topic: LogTopic) -> float | None:
    """Return the median time from stamp to reception, seconds; None where unknown."""
    return float(np.median(topic.received - topic.stamps)) if len(topic.received) else None


def _pauses(log: LaserLog) -> Iterator[Deviation]:
    for topic in log.topics:
        steps = np.diff(np.sort(topic.stamps))
        usual = float(np.median(steps)) if len(steps) else 0.0
        long = steps[steps > max(PAUSE, PERIODS * usual)]
        if len(long):
            yield Deviation(f"{topic.name} pauses for up to {long.max():.1f} s ({len(long)} x)")


def _clock_faults(log: LaserLog) -> Iterator[Deviation]:
    """Yield clocks that differ, and odometry that does not span the scans."""
    if len(log.topics) < 2 or not len(log.track):
        return
    scans, odometry = log.topics[:2]
    lags = _lag(scans), _lag(odometry)
    if lags[0] is not None and lags[1] is not None and abs(lags[0] - lags[1]) > LAG:
        apart = f"{abs(lags[0] - lags[1]):.2f} s"
        older, other = (scans, odometry) if lags[0] > lags[1] else (odometry, scans)
        behind = f"stamps of {older.name} are {apart} older than those of {other.name} by their reception"
        yield Deviation(behind, "--time receive if the map breaks")
    begin, end = odometry.stamps.min() - scans.stamps.min(), scans.stamps.max() - odometry.stamps.max()
    if begin > LATE:
        yield Deviation(f"odometry begins {begin:.1f} s after the scans: those before it are left out")
    if end > LATE:
        yield Deviation(f"odometry ends {end:.1f} s before the scans: those after it are left out")


def _odometry_faults(log: LaserLog) -> Iterator[Deviation]:
    if not len(log.track):
        yield Deviation("no odometry, or one that never changes", "--mapper hector maps without")
        return
    steps = np.linalg.norm(np.diff(log.track.xy, axis=0), axis=1)
    usual = 3 * float(np.median(steps)) if len(steps) else 0.0
    jumps = steps[steps > np.maximum(max(JUMP, usual), FAST * np.diff(log.track.stamps))]
    if len(jumps):
        said = f"odometry jumps by up to {jumps.max():.1f} m ({len(jumps)} x)"
        yield Deviation(said, unfit=True, hopeless=float(jumps.max()) > MAX_JUMP)


def _scan_faults(log: LaserLog) -> Iterator[Deviation]:
    if not log.scans:
        return
    up = np.array([scan.T_base_laser.rotation[2, 2] for scan in log.scans])
    tilt = float(np.degrees(np.median(np.arccos(np.clip(np.abs(up), 0.0, 1.0)))))
    if tilt > np.degrees(TILTED):
        tilted = f"the transforms mount the laser at {tilt:.0f} deg to the ground"
        yield Deviation(tilted, "--scan-topic of a level laser", unfit=True)
    seeing = np.mean([scan.hits.sum() >= FEW_RETURNS for scan in log.scans])
    if seeing < SEEING:
        share = f"{100 * (1 - seeing):.0f} %"
        yield Deviation(f"{share} of the scans have fewer than {FEW_RETURNS} returns", unfit=True)
    frozen = _frozen_path(log)
    if frozen > FROZEN:
        yield Deviation(f"the scan stays the same over {frozen:.1f} m of odometry", unfit=True)


def _frozen_path(log: LaserLog) -> float:
    """Return the longest path on which scans with returns stay the same, meters."""
    longest = path = 0.0
    for (before, last), (scan, pose) in pairwise(zip(log.scans, log.odometry, strict=True)):
        if last is None or pose is None:
            continue
        repeats = scan.hits.any() and np.array_equal(before.ranges, scan.ranges, equal_nan=True)
        path = path + math.hypot(pose.x - last.x, pose.y - last.y) if repeats else 0.0
        longest = max(longest, path)
    return longest


def _inertial_faults(log: LaserLog) -> Iterator[Deviation]:
    gyro = _gyro_at_rest(log)
    if gyro is not None and max(gyro) > SHAKY:
        shown = f"{gyro[1]:.3f} rad/s with a noise of {gyro[0]:.3f} rad/s"
        yield Deviation(f"the gyroscope at rest shows {shown}")


def _gyro_at_rest(log: LaserLog) -> tuple[float, float] | None:
    """Return noise and mean of the gyroscope at rest, rad/s; None without readings."""
    if log.inertial is None or len(log.track) < 2:
        return None
    begins, speed, turn = _motion(log)
    resting = begins[(speed < STANDING) & (turn < STANDING_TURN)]
    in_rest = np.isin(np.floor(log.inertial.stamps / WINDOW), np.rint(resting / WINDOW))
    rates = log.inertial.angular_velocity[in_rest]
    if len(rates) < REST:
        return None
    return float(rates.std(axis=0).max()), float(np.abs(rates.mean(axis=0)).max())


def _motion(log: LaserLog) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return begins (n,) of windows, seconds, with speeds (m/s) and turn rates (rad/s)."""
    begins = np.unique(np.floor(log.track.stamps / WINDOW)) * WINDOW
    whole = np.diff(begins) < 1.5 * WINDOW  # a pause of the odometry has no speed
    steps = np.diff(log.track.planar_at(begins), axis=0)[whole] / WINDOW
    return begins[:-1][whole], np.hypot(steps[:, 0], steps[:, 1]), np.abs(steps[:, 2])
