"""Quality of a mapped log: errors of its trajectory, consistency with its scans.

Placed by a correct trajectory, the scans of one pass end where the other passes see a wall as well, or where
they cannot see. The revisit residual is the mean distance from a hit to the nearest hit of another pass, at
most `MAX_RESIDUAL`. Hits behind what the other scan sees by more than that, or where it has no return, are
not counted. It needs neither the truth nor the mapper.

Limits: the test misses a place that was passed only once, and a shift along a corridor whose walls look
alike. A hillside seen from two heights differs from itself: where the attitude is known and the robot tilts,
there is no test; where it is unknown, the ground is taken for level.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lirs_validation.metrics.trajectory import (
    associated,
    motion,
    move_poses,
    nearest,
    planar,
    rigid_alignment,
    rms,
)
from lirs_wct.arrays import FloatArray, IntArray, njit
from lirs_wct.geometry import Imu, LaserScan, Pose2, Pose3, Trajectory, wrap_angle, wrap_angles

PROPAGATION_GAP = 0.1
"""A pose farther than this from a constraint's stamp is propagated there by odometry, seconds."""
STAMP_MARGIN = 2.0
"""Seconds around an estimate's time; constraints with a stamp outside are left out."""
REFERENCE_GAP = 0.5
"""A reference pose is compared with the nearest scan, at most so many seconds away."""
MAX_RANGE = 10.0
"""Range up to which beams count, meters: farther away, a small error of the yaw is a large distance."""
PASS_LENGTH = 10.0
"""Distance driven between two scans from which on they belong to different passes, meters."""
STEP, TURN = 0.5, 0.5
"""Meters and radians after which the next scan is tested: those between see the same."""
BLOCK, LEAST_BLOCKS = 10, 5
"""Number of such steps whose odometry errors depend on each other, and fewest such blocks of a fit."""
HITS = 90
"""Number of beams of a scan that are tested, about; the other scan counts with all of its beams."""
MIN_HITS = 30
"""Hits in view of other passes that a scan needs to be tested."""
MAX_RESIDUAL = 1.0
"""Largest distance from a hit to the wall of another pass that counts, meters; larger ones count as this."""
LEVEL_SHARE, MAX_HEIGHT = 0.95, 0.3
"""Share of the scans that must be level, and most height of their hits above or below the laser, meters."""


@dataclass(frozen=True)
class RelativePoseConstraint:
    """The true pose of the robot at `stamp_b` in its frame at `stamp_a`."""

    stamp_a: float
    stamp_b: float
    T_ab: Pose2


@dataclass(frozen=True)
class ConstraintErrors:
    """Errors of the constraints inside the trajectory's time, and how many lay outside.

    Attributes:
        translation: (n,) meters.
        rotation: (n,) radians, not negative.
        outside: Number of constraints that were left out.
        stamps: (n,) earlier stamp of each constraint, seconds.
    """

    translation: FloatArray
    rotation: FloatArray
    outside: int
    stamps: FloatArray

    def metrics(self) -> dict[str, Any]:
        """Return the metrics as a record holds them."""
        turn = np.degrees(self.rotation)
        some = len(turn) > 0
        return {
            "translation_mean": float(self.translation.mean()) if some else None,
            "translation_std": float(self.translation.std()) if some else None,
            "rotation_mean_deg": float(turn.mean()) if some else None,
            "rotation_std_deg": float(turn.std()) if some else None,
            "used": len(turn),
            "outside": self.outside,
        }


def constraint_errors(
    estimate: Trajectory, constraints: Sequence[RelativePoseConstraint], odometry: Trajectory
) -> ConstraintErrors:
    """Compare an estimate, in any frame, with the constraints.

    Raw odometry over the same time propagates poses to the stamps; where it is empty, the estimate does.
    """
    low, high = estimate.stamps[0] - STAMP_MARGIN, estimate.stamps[-1] + STAMP_MARGIN
    stamps = np.array([(c.stamp_a, c.stamp_b) for c in constraints]).reshape(-1, 2)
    inside = (stamps.min(axis=1) >= low) & (stamps.max(axis=1) <= high)
    stamps = stamps[inside]
    true = np.array([c.T_ab.as_array() for c in constraints]).reshape(-1, 3)[inside]
    propagator = odometry if len(odometry) else estimate
    a, b = (poses_at(estimate, stamps[:, k], propagator) for k in (0, 1))
    error = motion(true, motion(a, b))
    return ConstraintErrors(
        np.linalg.norm(error[:, :2], axis=1),
        np.abs(wrap_angles(error[:, 2])),
        int((~inside).sum()),
        stamps.min(axis=1),
    )


def poses_at(estimate: Trajectory, stamps: FloatArray, odometry: Trajectory) -> FloatArray:
    """Return (n, 3) estimated poses at stamps (n,), propagated from distant poses by odometry."""
    near = nearest(estimate.stamps, stamps)
    poses, there = planar(estimate)[near], estimate.stamps[near]
    step = motion(odometry.planar_at(there), odometry.planar_at(stamps))
    step[np.abs(there - stamps) <= PROPAGATION_GAP] = 0.0
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    return poses + np.column_stack(
        (c * step[:, 0] - s * step[:, 1], s * step[:, 0] + c * step[:, 1], step[:, 2])
    )


@dataclass(frozen=True)
class ReferenceErrors:
    """Errors at the reference poses with a scan near by, after rigid alignment without scale.

    Attributes:
        stamps: (n,) seconds.
        position: (n,) meters.
        yaw: (n,) radians, not negative.
        outside: Number of reference poses without a scan near by.
        T_map_reference: Place of the reference's frame in the map, so that the two can be drawn together.
    """

    stamps: FloatArray
    position: FloatArray
    yaw: FloatArray
    outside: int
    T_map_reference: Pose2

    def metrics(self) -> dict[str, Any]:
        """Return the metrics as a record holds them."""
        some = len(self.position) > 0
        return {
            "ate_rmse": rms(self.position) if some else None,
            "ate_max": float(self.position.max()) if some else None,
            "yaw_rmse_deg": math.degrees(rms(self.yaw)) if some else None,
            "used": len(self.position),
            "outside": self.outside,
        }


@dataclass(frozen=True)
class Accuracy:
    """Errors of a trajectory; None if not requested, or nothing can be compared."""

    constraints: ConstraintErrors | None = None
    reference: ReferenceErrors | None = None

    def metrics(self) -> dict[str, Any]:
        """Return the metrics as a record holds them."""
        return {
            "relations": None if self.constraints is None else self.constraints.metrics(),
            "reference": None if self.reference is None else self.reference.metrics(),
        }


def trajectory_accuracy(
    estimate: Trajectory,
    odometry: Trajectory,
    constraints: Sequence[RelativePoseConstraint] | None,
    reference: Trajectory | None,
) -> Accuracy:
    """Compare an estimate in the map frame with relations and reference."""
    return Accuracy(
        None if constraints is None else constraint_errors(estimate, constraints, odometry),
        None if reference is None else reference_errors(estimate, reference),
    )


def reference_errors(estimate: Trajectory, reference: Trajectory) -> ReferenceErrors:
    """Compare each reference pose with the nearest scan's (ATE of Sturm et al. 2012, Eq. 4, in the plane)."""
    i, j = associated(reference.stamps, estimate.stamps, max_gap=REFERENCE_GAP)
    outside = len(reference) - len(i)
    if len(i) < 2:
        nothing = np.empty(0)
        return ReferenceErrors(nothing, nothing, nothing, outside, Pose2())
    true, found = planar(reference)[i], planar(estimate)[j]
    T_reference_map = rigid_alignment(found[:, :2], true[:, :2])
    aligned = move_poses(found, T_reference_map)
    return ReferenceErrors(
        reference.stamps[i],
        np.linalg.norm(aligned[:, :2] - true[:, :2], axis=1),
        np.abs(wrap_angles(aligned[:, 2] - true[:, 2])),
        outside,
        T_reference_map.inverse(),
    )


def odometry_scale(odometry: Trajectory, path: Trajectory) -> dict[str, tuple[float, float] | None]:
    """Return relative errors of odometry's distance and turn, with 95 % margins, by a path.

    None where the path is too short. Shifts per radian and turns per meter are no errors of scale.
    """
    i, j = associated(odometry.stamps, path.stamps)
    true, measured = planar(path)[j], planar(odometry)[i]
    steps, _ = _select_spaced(true)
    true, measured = (motion(poses[steps[:-1]], poses[steps[1:]]) for poses in (true, measured))
    ahead, turn = true[:, 0], wrap_angles(true[:, 2])
    return {
        "distance": _excess(np.column_stack((ahead, np.abs(turn))), measured[:, 0]),
        "turn": _excess(np.column_stack((turn, ahead)), wrap_angles(measured[:, 2])),
    }


def _excess(true: FloatArray, measured: FloatArray) -> tuple[float, float] | None:
    """Return the slope over the first of columns (n, 2), less one, and its margin."""
    blocks = len(true) // BLOCK
    if blocks < LEAST_BLOCKS or np.linalg.matrix_rank(true) < 2:
        return None
    inverse = np.linalg.inv(true.T @ true)
    slopes = inverse @ true.T @ measured
    influence = true @ inverse[0] * (measured - true @ slopes)
    sums = np.add.reduceat(influence, BLOCK * np.arange(blocks))
    return float(slopes[0]) - 1, 2 * math.sqrt(float(sums @ sums) * blocks / (blocks - 2))


@dataclass(frozen=True, kw_only=True)
class ScanConsistency:
    """Quality of a trajectory by its own scans, without a truth.

    Attributes:
        revisit_residual: Mean distance from hits to walls that another pass saw, meters; None = no revisits.
        pass_residual: Mean distance between scans of one pass, meters; None = too few hits.
        revisited: Share of the scans that another pass can test.
        longest_gap: Longest way between two scans, meters.
    """

    revisit_residual: float | None
    pass_residual: float | None
    revisited: float
    longest_gap: float


def scan_consistency(
    scans: Sequence[LaserScan], readings: Sequence[Imu | None], trajectory: Trajectory
) -> ScanConsistency | None:
    """Return distances between walls of several scans; None without level scans.

    One scan per half meter is tested. The readings hold the attitude at each scan, where it is known; the
    trajectory, `T_map_base` of two scans or more.
    """
    placed = _place_scans(scans, readings, trajectory)
    if placed is None:
        return None
    arrays = placed.ranges, placed.angles, placed.sensors, placed.driven
    compared, total = _residuals(*arrays, PASS_LENGTH, math.inf)
    compared_within, total_within = _residuals(*arrays, 0.0, PASS_LENGTH)
    return ScanConsistency(
        revisit_residual=_mean(total, compared),
        pass_residual=_mean(total_within, compared_within),
        revisited=float((compared >= MIN_HITS).mean()),
        longest_gap=float(np.diff(placed.driven).max()),
    )


def _mean(total: FloatArray, count: IntArray) -> float | None:
    """Return the mean over all counted hits; None of fewer than one scan needs."""
    return float(total.sum() / count.sum()) if count.sum() >= MIN_HITS else None


@dataclass(frozen=True)
class _PlacedScans:
    """Spaced scans of a planar laser at a trajectory's poses.

    Attributes:
        ranges: (n, beams) NaN without return, meters.
        angles: (n, 2) of the first beam, and between beams, radians.
        sensors: (n, 3) poses of the laser in the map.
        driven: (n,) meters driven up to each scan.
    """

    ranges: FloatArray
    angles: FloatArray
    sensors: FloatArray
    driven: FloatArray


def _place_scans(
    scans: Sequence[LaserScan], readings: Sequence[Imu | None], trajectory: Trajectory
) -> _PlacedScans | None:
    """Place spaced scans; None of fewer than two poses, or of scans not level."""
    i, j = associated(np.array([scan.stamp for scan in scans]), trajectory.stamps)
    poses = planar(trajectory)[j]
    chosen, driven = _select_spaced(poses)
    used = i[chosen]
    level = [_is_level(scans[k], readings[k]) for k in used]
    if len(used) < 2 or np.mean(level) < LEVEL_SHARE:
        return None
    sweeps = [_sweep(scans[k]) for k in used]
    ranges = np.full((len(used), max(len(sweep) for sweep, _, _ in sweeps)), np.nan)
    for row, (sweep, _, _) in zip(ranges, sweeps, strict=True):
        row[: len(sweep)] = sweep
    angles = np.array([(start, step) for _, start, step in sweeps])
    mounts = [scans[k].T_base_laser.to_pose2() for k in used]
    placed = zip(poses[chosen].tolist(), mounts, strict=True)
    sensors = np.array([(Pose2(*pose) @ mount).as_array() for pose, mount in placed])
    return _PlacedScans(ranges, angles, sensors, driven)


def _select_spaced(poses: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return indices of poses (n, 3) a step or turn apart, and meters driven."""
    chosen, driven, total = list[int](), list[float](), 0.0
    for k, (x, y, yaw) in enumerate(poses.tolist()):
        if chosen:
            x0, y0, yaw0 = poses[chosen[-1]].tolist()
            distance = math.hypot(x - x0, y - y0)
            if distance < STEP and abs(wrap_angle(yaw - yaw0)) < TURN:
                continue
            total += distance
        chosen.append(k)
        driven.append(total)
    return np.array(chosen, dtype=np.int64), np.array(driven)


def _is_level(scan: LaserScan, reading: Imu | None) -> bool:
    """Return whether a hit at `MAX_RANGE` lies less than `MAX_HEIGHT` above or below the laser."""
    attitude = Pose3() if reading is None else Pose3.from_rpy(0, 0, 0, reading.roll, reading.pitch, 0)
    upright = (attitude @ scan.T_base_laser).rotation[2, 2]
    return bool(abs(upright) >= math.cos(MAX_HEIGHT / MAX_RANGE))


def _sweep(scan: LaserScan) -> tuple[FloatArray, float, float]:
    """Return ranges counter-clockwise, NaN without return, and angle of the first beam and between beams."""
    ranges = np.where(scan.hits, scan.ranges, np.nan)
    side = -1.0 if scan.T_base_laser.rotation[2, 2] < 0 else 1.0  # a laser mounted upside down
    start, step = side * scan.angle_min, side * scan.angle_increment
    if step >= 0:
        return ranges, start, step
    return ranges[::-1], start + step * (len(ranges) - 1), -step


@njit
def _residuals(
    ranges: FloatArray, angles: FloatArray, sensors: FloatArray, driven: FloatArray, least: float, most: float
) -> tuple[IntArray, FloatArray]:
    """Return (n,) compared hits of each scan and (n,) the sum of their distances, meters.

    The arrays are those of `_PlacedScans`; compared scans have `least` to `most` meters driven between them.
    """
    n, beams = ranges.shape
    compared, total = np.zeros(n, np.int64), np.zeros(n)
    stride = max(1, beams // HITS)
    for i in range(n):
        for j in range(n):
            dx, dy = sensors[i, 0] - sensors[j, 0], sensors[i, 1] - sensors[j, 1]
            apart = abs(driven[i] - driven[j])
            if i == j or apart < least or apart >= most or dx * dx + dy * dy > 4 * MAX_RANGE * MAX_RANGE:
                continue
            for k in range(0, beams, stride):
                if not ranges[i, k] <= MAX_RANGE:
                    continue
                bearing = sensors[i, 2] + angles[i, 0] + k * angles[i, 1]
                x, y = dx + ranges[i, k] * math.cos(bearing), dy + ranges[i, k] * math.sin(bearing)
                distance = math.sqrt(x * x + y * y)
                if MAX_RESIDUAL / 2 <= distance <= MAX_RANGE:
                    turn = (math.atan2(y, x) - sensors[j, 2] - angles[j, 0]) % math.tau
                    residual = _nearest_hit(ranges[j], turn, angles[j, 1], distance)
                    compared[i] += residual >= 0
                    total[i] += max(0.0, residual)
    return compared, total


@njit
def _nearest_hit(ranges: FloatArray, turn: float, step: float, distance: float) -> float:
    """Return a point's distance from a scan's nearest hit, meters; -1 if unseen."""
    beam = int(turn / step + 0.5)
    if beam >= len(ranges) or not ranges[beam] >= distance - MAX_RESIDUAL:  # no return says nothing
        return -1.0
    around = math.asin(min(1.0, MAX_RESIDUAL / distance))
    first, last = max(0, math.floor((turn - around) / step)), math.ceil((turn + around) / step)
    nearest = MAX_RESIDUAL * MAX_RESIDUAL
    for k in range(first, min(len(ranges), last + 1)):
        r = ranges[k]
        if not math.isnan(r):
            nearest = min(nearest, distance * distance + r * r - 2 * distance * r * math.cos(turn - k * step))
    return math.sqrt(max(0.0, nearest))
