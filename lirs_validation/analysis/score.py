"""Scores of another program's trajectory and map from a run's recorded scans."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import scipy
from scipy.spatial.transform import Rotation, Slerp

from lirs_validation.analysis.results import RunFolder, recorded_truth, recorded_world_config, true_pose_map
from lirs_validation.experiment.scenario import build_scenario
from lirs_validation.logs.read_log import read_trajectory
from lirs_validation.metrics.map import agreement, as_stored, map_scores, sample_like
from lirs_validation.metrics.trajectory import (
    MAX_GAP,
    StartAlignment,
    associated,
    inside_95,
    nearest,
    rigid_alignment,
    start_alignment,
    trajectory_errors,
)
from lirs_validation.record.verdict import Verdict, incompleteness, judge
from lirs_wct import ConfigError, FloatArray, Pose2, SourceError, Trajectory, covariance_fault, wrap_angle
from lirs_wct.formats import drive_files, map_server

Frame = Literal["auto", "map", "world", "align"]
START_RADIUS, START_SHARE, START_YAW = 0.5, 0.1, math.radians(20)
"""Tolerances of a trajectory's first pose: meters, share of the path driven until then, and angle. Beyond
them, the trajectory is in another frame."""
CLEAR_F1 = 0.2
"""Smallest difference of F1 that identifies one of two frames."""
RESOLUTION_TOLERANCE = 1e-6
"""Largest difference of equal cell sizes, meters."""
SAME_STAMP = 1e-3
"""Poses within this time of a scan are of the scan, seconds."""
GAP_PERIODS, KEYFRAME_GAP = 1.5, 2.0
"""Largest distance of two poses between which a scan's pose is interpolated, in periods of the scans, or
seconds if that is more."""
STEP, WINDOW = 0.05, 0.5
"""Sampling of the motion, and time over which a speed and a turn are measured, seconds."""
MIN_OVERLAP, MIN_COMMON, MAX_SPAN = 0.5, 3.0, 1e5
"""Least share of the shorter trajectory within the other; least common and longest time, seconds."""
MIN_CORRELATION, EQUAL_CORRELATION = 0.5, 0.02
"""Least correlation of the motions at the right offset, and a difference that does not tell offsets apart."""
UPRIGHT_PART, MIN_SPREAD = math.cos(math.radians(45)), 0.05
"""Least vertical part of an upright z axis, and least ratio of a path's width to its length by which a fit in
space finds the axes."""


@dataclass(frozen=True, kw_only=True)
class Score:
    """Score of a trajectory and a map, by the metrics of a record.

    Attributes:
        run: Name of the run.
        status: `incomplete` if the trajectory leaves out scans; `reason` says how many.
        frame: Frame of the result.
        given: Number of poses of the trajectory; 0 without one.
        time_offset: Seconds that were added to the trajectory's stamps.
        trajectory: Metrics as in a record; empty without a trajectory.
        map: Metrics as in a record; empty without a map.
    """

    run: str
    status: Literal["ok", "incomplete"]
    reason: str
    frame: Literal["map", "world", "align"]
    given: int
    time_offset: float
    trajectory: dict[str, Any]
    map: dict[str, Any]

    def verdict(self, entry: Mapping[str, Any]) -> Verdict | None:
        """Return the verdict on the result; None without a trajectory."""
        if not self.trajectory:
            return None
        driven = {"robot_lengths": entry["trajectory"].get("robot_lengths")}
        own = {"status": self.status, "reason": self.reason, "map": self.map}
        return judge({**entry, **own, "trajectory": self.trajectory | driven}, method="the scored method")


def score(
    run: RunFolder,
    *,
    trajectory: Path | None = None,
    map_yaml: Path | None = None,
    frame: Frame = "auto",
    time_offset: float | Literal["auto"] = 0.0,
) -> Score:
    """Score a trajectory and a map that were made from a run's `scans.clf.gz` or bag.

    Args:
        run: Run.
        trajectory: TUM, EuRoC or KITTI file, BAG or BAG:/TOPIC: poses of base_link. Those of another rate,
            and keyframes at most 2 s apart, are interpolated at the scans. Axes of a camera are turned.
        map_yaml: ROS map.
        frame: Frame of both: `map`, whose origin is the first base pose; `world`, that of the run; `auto`:
            found by where the trajectory begins; without one, by the true-pose map; `align`: any, moved to
            the best fit of the trajectory.
        time_offset: Seconds to add to the trajectory's stamps; `auto`: found by its motion.
    """
    truth = recorded_truth(run.folder)
    estimate, given, offset = None, 0, 0.0
    if trajectory is not None:
        read = read_trajectory(trajectory, truth.stamps)
        given = len(read)
        try:
            offset = find_time_offset(truth, read) if time_offset == "auto" else time_offset
        except SourceError as error:
            raise SourceError(f"{trajectory}: {error}") from error
        estimate = interpolate_poses(replace(read, stamps=read.stamps + offset), truth.stamps)
        _check_stamps(trajectory, estimate, truth)
        estimate, frame = _in_frame(trajectory, estimate, truth, frame)
    if frame == "auto":
        frame = "map" if map_yaml is None else frame_of_map(run, map_yaml, truth)
    T_world_frame = _place(truth, estimate, frame)
    errors, alignment, lacking = dict[str, Any](), None, None
    if estimate is not None:
        errors = asdict(trajectory_errors(truth, estimate, T_world_map=T_world_frame))
        odometry = drive_files.read_tum(run.folder / "odometry.tum")
        errors["odometry_ate_rmse"] = trajectory_errors(truth, odometry).ate_rmse
        alignment = start_alignment(truth, estimate.moved(T_world_frame))
        if estimate.covariances is not None and frame != "align":
            errors["inside_95"] = _inside_95(trajectory, truth, estimate.moved(T_world_frame))
        lacking = incompleteness(errors["scan_coverage"])
    return Score(
        run=str(run.entry["name"]),
        status="ok" if lacking is None else "incomplete",
        reason=lacking or "",
        frame=frame,
        given=given,
        time_offset=offset,
        trajectory=errors,
        map={} if map_yaml is None else _score_map(run, map_yaml, T_world_frame, alignment),
    )


def _inside_95(path: Path | None, truth: Trajectory, estimate: Trajectory) -> float | None:
    """Return the share of positions within their claimed ellipse; poses are in the world frame."""
    i, j = associated(truth.stamps, estimate.stamps)
    assert estimate.covariances is not None
    claimed = [None if np.isnan(P).all() else P for P in estimate.covariances[j]]
    for P, stamp in zip(claimed, estimate.stamps[j].tolist(), strict=True):
        if P is not None and (fault := covariance_fault(P)):
            raise SourceError(f"{path}: {fault} at {stamp:.3f} s")
    return inside_95(truth.xy[i], estimate.xy[j], claimed)


def _in_frame(path: Path, estimate: Trajectory, truth: Trajectory, frame: Frame) -> tuple[Trajectory, Frame]:
    """Return a trajectory with the axes of base_link, and its frame."""
    if turned := turn_upright(estimate, truth):
        estimate, axes = turned
        if frame not in ("auto", "align"):
            raise SourceError(
                f"{path}: its axes are {axes}, those of the {frame} frame x ahead, z up: "
                "--frame align turns it and moves it to the best fit"
            )
        frame = "align"
        warnings.warn(f"{path}: its axes are {axes}: moved to the best fit", stacklevel=3)
    return estimate, frame_of(path, estimate, truth, frame)


def _place(truth: Trajectory, estimate: Trajectory | None, frame: Frame) -> Pose2:
    """Return where the origin of a frame lies in the world."""
    if frame != "align":
        return truth.pose2(0) if frame == "map" else Pose2()
    if estimate is None:
        raise ConfigError("--frame align needs a trajectory to align, give --trajectory")
    i, j = associated(truth.stamps, estimate.stamps)
    return rigid_alignment(estimate.xy[j], truth.xy[i])


def frame_of(
    path: Path, estimate: Trajectory, truth: Trajectory, frame: Frame
) -> Literal["map", "world", "align"]:
    """Return the frame in which a trajectory begins where the run was; `align` stays."""
    if frame == "align":
        return frame
    i, j = associated(truth.stamps, estimate.stamps)
    true, first = truth.pose2(int(i[0])), estimate.pose2(int(j[0]))
    driven = float(np.linalg.norm(np.diff(truth.xy[: int(i[0]) + 1], axis=0), axis=1).sum())
    there = {"map": truth.pose2(0).inverse() @ true, "world": true}
    fits = [
        name
        for name, pose in there.items()
        if first.distance(pose) <= START_RADIUS + START_SHARE * driven
        and abs(wrap_angle(first.yaw - pose.yaw)) <= START_YAW
    ]
    if frame in fits or (frame == "auto" and fits):
        return "map" if (frame if frame in fits else fits[0]) == "map" else "world"
    places = " or ".join(
        f"{_pose_text(pose)} in the {name} frame" for name, pose in there.items() if frame in ("auto", name)
    )
    hint = "--frame align moves it to the best fit"
    hint = f"it fits the {fits[0]} frame: --frame {fits[0]}" if fits else hint
    raise SourceError(
        f"{path}: another frame: at {estimate.stamps[j[0]]:.2f} s it begins at {_pose_text(first)}, where "
        f"the run was at {places}; the map frame's origin is the first base pose; {hint}"
    )


def frame_of_map(run: RunFolder, path: Path, truth: Trajectory) -> Literal["map", "world"]:
    """Return the frame in which a map agrees clearly better with the recorded true-pose map."""
    built, reference = map_server.read_map(path), map_server.read_map(run.folder / "map_true_pose.yaml")
    in_map, in_world = (
        agreement(as_stored(grid), as_stored(reference)).f1 or 0.0
        for grid in (built.moved(truth.pose2(0)), built)
    )
    if in_map == in_world:  # the frames are the same, or the map is of another place
        return "map"
    if abs(in_map - in_world) < CLEAR_F1:
        raise SourceError(
            f"{path}: in which frame? F1 is {in_map:.3f} in the map frame, {in_world:.3f} in the world "
            "frame: --frame map (origin: the first base pose) or --frame world (as the run's own files)"
        )
    return "map" if in_map > in_world else "world"


def _pose_text(pose: Pose2) -> str:
    return f"({pose.x:.2f}, {pose.y:.2f}) m, {math.degrees(pose.yaw):.0f} deg"


def _check_stamps(path: Path, estimate: Trajectory, truth: Trajectory) -> None:
    """Refuse a trajectory with fewer than two poses at stamps of the run."""
    i, _ = associated(truth.stamps, estimate.stamps)
    if len(i) >= 2:
        return
    spans = [f"{t.stamps[0]:.2f} .. {t.stamps[-1]:.2f} s" if len(t) else "none" for t in (estimate, truth)]
    raise SourceError(
        f"{path}: other stamps: {len(i)} of its {len(estimate)} poses lie within {MAX_GAP} s of one of the "
        f"run's {len(truth)}, at least 2 must; its stamps are {spans[0]}, the run's {spans[1]} (seconds "
        "since the start, as in scans.clf.gz); --time-offset auto finds a constant difference"
    )


def _score_map(
    run: RunFolder, path: Path, T_world_frame: Pose2, alignment: StartAlignment | None
) -> dict[str, Any]:
    """Compare a map with the true-pose map, which is rebuilt for another cell size."""
    config = recorded_world_config(run.entry)
    built = map_server.read_map(path).moved(T_world_frame)
    reference = map_server.read_map(run.folder / "map_true_pose.yaml")
    if abs(reference.resolution - built.resolution) > RESOLUTION_TOLERANCE:
        reference = true_pose_map(run.folder, config, built.resolution)
    there = ~np.isnan(sample_like(as_stored(built), as_stored(reference)))
    if not (there & as_stored(reference).known).any():
        raise SourceError(
            f"{path}: knows no cell of where the run took place: is its origin given in the map frame, "
            "that of the first base pose?"
        )
    world = build_scenario(config).world
    scores = map_scores(
        built, reference, surface=world.surface, walls=world.walls, truth=world.truth, alignment=alignment
    )
    return asdict(scores)


def interpolate_poses(trajectory: Trajectory, stamps: FloatArray) -> Trajectory:
    """Return the poses at the stamps of scans (n,) whose neighboring poses are near enough.

    A trajectory is returned as it is if all scans have a pose, or most poses are too far apart.
    """
    period = float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.0
    most, gaps = max(GAP_PERIODS * period, KEYFRAME_GAP), np.diff(trajectory.stamps)
    own = np.abs(trajectory.stamps[nearest(trajectory.stamps, stamps)] - stamps) <= SAME_STAMP
    if not len(gaps) or np.median(gaps) > most or own.all():
        return trajectory
    after = np.clip(np.searchsorted(trajectory.stamps, stamps), 1, len(gaps))
    inside = (stamps >= trajectory.stamps[0]) & (stamps <= trajectory.stamps[-1])
    known = stamps[inside & (own | (gaps[after - 1] <= most))]
    if not len(known):
        return trajectory
    positions, turns = _poses_at(trajectory, known)
    claimed = trajectory.covariances
    claimed = None if claimed is None else claimed[nearest(trajectory.stamps, known)]
    return Trajectory(known, positions, turns.as_quat(scalar_first=True), claimed)


def find_time_offset(truth: Trajectory, estimate: Trajectory) -> float:
    """Return the seconds that lead from the estimate's clock to that of the truth.

    Speed and turn rate do not depend on the frame. Their correlation finds the offset to a step, and the
    least squares of their differences refine it. Errors of a mapper shift it by up to a step: less is none.
    """
    span = float(np.ptp(estimate.stamps))
    if span > MAX_SPAN:
        raise SourceError(f"its stamps span {span:.4g} s, which has no time offset: give it in seconds")
    start = float(truth.stamps[0] - estimate.stamps[0])
    true, found = (_motion(t, np.arange(*_span(t), STEP)) for t in (truth, estimate))
    if min(len(true), len(found)) * STEP < MIN_COMMON or not (true.std(axis=0) > 0).all():
        raise SourceError("too short to find its time offset: give it in seconds")
    a, b = ((m - m.mean(axis=0)) / np.maximum(m.std(axis=0), 1e-9) for m in (true, found))
    lags = scipy.signal.correlation_lags(len(a), len(b))
    common = scipy.signal.correlate(np.ones(len(a)), np.ones(len(b)))
    total = sum(scipy.signal.correlate(a[:, k], b[:, k]) for k in range(2)) / (2 * np.maximum(common, 1))
    total[common < max(MIN_OVERLAP * min(len(a), len(b)), MIN_COMMON / STEP)] = -1
    equal = np.flatnonzero(total > total.max() - EQUAL_CORRELATION)
    equal = equal[common[equal] >= common[equal].max() - 1]
    if np.ptp(equal) * STEP > 2 * WINDOW:
        found_at = ", ".join(f"{start + STEP * float(lags[k]):.1f}" for k in (equal[0], equal[-1]))
        raise SourceError(
            f"its motion fits the run's at several time offsets, {found_at} s: give it in seconds"
        )
    best = int(equal[np.argmax(total[equal])])
    if total[best] < MIN_CORRELATION:
        raise SourceError(
            "no time offset found: at the best one, its motion and the run's correlate by "
            f"{total[best]:.2f}, at least {MIN_CORRELATION:g} is needed"
        )
    coarse = start + STEP * float(lags[best])
    near = replace(estimate, stamps=estimate.stamps + coarse)
    fine = scipy.optimize.minimize_scalar(
        lambda x: _difference(truth, near, x), bounds=(-2 * STEP, 2 * STEP), method="bounded"
    )
    offset = coarse + float(fine.x)
    return offset if abs(offset) >= STEP else 0.0


def _span(trajectory: Trajectory) -> tuple[float, float]:
    """Return first and last stamp at which the motion is known."""
    return float(trajectory.stamps[0]) + WINDOW / 2, float(trajectory.stamps[-1]) - WINDOW / 2


def _motion(trajectory: Trajectory, stamps: FloatArray) -> FloatArray:
    """Return (n, 2) distance and angle within a window around each stamp, meters and radians.

    Both are the same in any frame, also in that of a camera.
    """
    if len(trajectory) < 2:
        return np.empty((0, 2))
    ends = [np.clip(stamps + shift, *trajectory.stamps[[0, -1]]) for shift in (-WINDOW / 2, WINDOW / 2)]
    (before, turn), (after, turned) = (_poses_at(trajectory, t) for t in ends)
    return np.column_stack((np.linalg.norm(after - before, axis=1), (turn.inv() * turned).magnitude()))


def _poses_at(trajectory: Trajectory, stamps: FloatArray) -> tuple[FloatArray, Rotation]:
    """Return positions (n, 3) and attitudes, interpolated at stamps (n,) within the trajectory."""
    positions = [np.interp(stamps, trajectory.stamps, column) for column in trajectory.positions.T]
    turns = Slerp(trajectory.stamps, Rotation.from_quat(trajectory.quaternions, scalar_first=True))
    return np.column_stack(positions), turns(stamps)


def _difference(truth: Trajectory, estimate: Trajectory, offset: float) -> float:
    """Return the mean square of the motions' differences at an offset."""
    low, high = _span(truth)
    first, last = _span(estimate)
    stamps = np.arange(max(low, first + offset), min(high, last + offset), STEP / 2)
    difference = _motion(truth, stamps) - _motion(estimate, stamps - offset)
    return float(np.mean(difference**2))


def turn_upright(estimate: Trajectory, truth: Trajectory) -> tuple[Trajectory, str] | None:
    """Return an estimate turned to z up, and its axes; None if it is upright.

    The axes follow from the best fit in space, which a straight path does not have. Those of the body count
    as named like those of the frame, as in the trajectories of cameras.
    """
    i, j = associated(truth.stamps, estimate.stamps)
    true, found = (t.positions[k] - t.positions[k].mean(axis=0) for t, k in ((truth, i), (estimate, j)))
    spread = np.linalg.svd(found, compute_uv=False)
    width = np.ptp(found, axis=0)
    if len(i) < 3 or spread[1] < MIN_SPREAD * spread[0] or width[2] < MIN_SPREAD * width[:2].min():
        return None
    turn, _ = Rotation.align_vectors(true, found)
    up = turn.inv().apply((0.0, 0.0, 1.0))
    if up[2] > UPRIGHT_PART:
        return None
    z, heading = _main_axis(up), truth.pose2(int(i[0])).yaw
    x = _main_axis((1 - np.abs(z)) * turn.inv().apply((math.cos(heading), math.sin(heading), 0.0)))
    names = [f"{'-' if axis.sum() < 0 else ''}{'xyz'[int(np.argmax(np.abs(axis)))]}" for axis in (x, z)]
    body = Rotation.from_matrix(np.column_stack((x, np.cross(z, x), z)))
    turned = turn * Rotation.from_quat(estimate.quaternions, scalar_first=True) * body
    upright = Trajectory(estimate.stamps, turn.apply(estimate.positions), turned.as_quat(scalar_first=True))
    return upright, f"{names[0]} ahead, {names[1]} up"


def _main_axis(direction: FloatArray) -> FloatArray:
    """Return the coordinate axis nearest to a direction (3,), with its sign."""
    axis = np.zeros(3)
    k = int(np.argmax(np.abs(direction)))
    axis[k] = np.sign(direction[k])
    return axis
