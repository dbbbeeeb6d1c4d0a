"""Walls seen again differ where a trajectory is wrong, and not where it is right."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from lirs_validation.metrics.mapped_log import ScanConsistency, scan_consistency
from lirs_validation.record.verdict import disagreement
from lirs_wct.geometry.pose import Pose2, Pose3, Trajectory
from lirs_wct.geometry.scan import Imu, LaserScan
from tests.slam_baselines.synthetic import ranges_to


def box(left: float, bottom: float, right: float, top: float) -> list[tuple[float, ...]]:
    """The four walls of a rectangle."""
    return [
        (left, bottom, right, bottom),
        (right, bottom, right, top),
        (right, top, left, top),
        (left, top, left, bottom),
    ]


CORRIDORS = np.array(box(0, 0, 24, 14) + box(4, 3, 20, 9))
"""Corridors around a block: 3 m wide on the near side, 5 m on the far side."""
CORNERS = ((2.0, 1.5), (22.0, 1.5), (22.0, 11.5), (2.0, 11.5), (2.0, 1.5))
LAP = [
    Pose2(*(a + (b - a) * t), math.atan2(*(b - a)[::-1]))
    for a, b in zip(np.array(CORNERS), np.array(CORNERS)[1:], strict=False)
    for t in np.linspace(0, 1, 40, endpoint=False)
]
BEAMS = np.radians(np.arange(-90, 91, 1.0))


def scans_at(poses: list[Pose2], mount: Pose3 | None = None) -> list[LaserScan]:
    """Scans of 180 deg, with noise of 2 cm."""
    rng, mount = np.random.default_rng(1), mount or Pose3()
    side = np.sign(mount.rotation[2, 2])
    return [
        LaserScan(
            (ranges_to(CORRIDORS, pose, side * BEAMS) + rng.normal(0, 0.02, len(BEAMS))).astype(np.float32),
            BEAMS[0], BEAMS[1] - BEAMS[0], 0.05, 30.0, float(k), mount,
        )
        for k, pose in enumerate(poses)
    ]  # fmt: skip


TRUE = LAP + LAP
SCANS = scans_at(TRUE)
UNKNOWN = [None] * len(SCANS)


def residual(poses: list[Pose2], scans: list[LaserScan] = SCANS) -> float | None:
    found = scan_consistency(scans, UNKNOWN, Trajectory.from_poses([s.stamp for s in scans], poses))
    return found and found.revisit_residual


def in_wrong_corridor(poses: list[Pose2]) -> list[Pose2]:
    """The second lap's near side is placed in the far corridor."""
    second = range(len(LAP), len(LAP) + 40)
    return [Pose2(p.x, p.y + 10.0, p.yaw) if k in second else p for k, p in enumerate(poses)]


def test_walls_agree_at_the_true_poses_and_with_small_errors() -> None:
    rng = np.random.default_rng(2)
    errors = rng.normal(0, (0.05, 0.05, math.radians(0.5)), (len(TRUE), 3))
    assert (residual(TRUE) or 1.0) < 0.1
    assert disagreement(residual([p @ Pose2(*e) for p, e in zip(TRUE, errors.tolist(), strict=True)])) is None


def test_walls_differ_where_a_lap_turns_too_far() -> None:
    bent = [Pose2(yaw=0.01 * max(0, k - 80)) @ p for k, p in enumerate(TRUE)]
    assert disagreement(residual(bent)) is not None


def test_one_pass_alone_has_no_residual() -> None:
    bent = [Pose2(yaw=0.02 * k) @ p for k, p in enumerate(LAP[:20])]  # 10 m of a corridor
    assert residual(bent, SCANS[:20]) is None
    assert scan_consistency(SCANS[:1], UNKNOWN[:1], Trajectory.from_poses([0.0], LAP[:1])) is None


@pytest.mark.parametrize("wrong", [False, True])
def test_the_mount_of_the_laser_does_not_matter(wrong: bool) -> None:
    upside_down = scans_at(TRUE, Pose3.from_rpy(0.0, 0.0, 0.3, math.pi, 0.0, 0.0))
    backwards = [
        replace(s, ranges=s.ranges[::-1].copy(), angle_min=BEAMS[-1], angle_increment=-s.angle_increment)
        for s in SCANS
    ]
    poses = in_wrong_corridor(TRUE) if wrong else TRUE
    assert residual(poses, backwards) == pytest.approx(residual(poses), abs=1e-3)
    assert residual(poses, upside_down) == pytest.approx(residual(poses), abs=0.02)


def test_a_robot_that_tilts_is_not_tested() -> None:
    trajectory = Trajectory.from_poses([s.stamp for s in SCANS], TRUE)
    for pitch, tested in ((0.02, True), (0.05, False)):
        readings = [Imu(pitch=pitch, stamp=s.stamp) for s in SCANS]
        assert (scan_consistency(SCANS, readings, trajectory) is not None) == tested


def quality(poses: list[Pose2]) -> ScanConsistency:
    trajectory = Trajectory.from_poses([s.stamp for s in SCANS], poses)
    found = scan_consistency(SCANS, UNKNOWN, trajectory)
    assert found is not None
    return found


@cache
def true_quality() -> ScanConsistency:
    return quality(TRUE)


def shifted(dx: float, dy: float) -> list[Pose2]:
    """The second lap lies beside the first."""
    return LAP + [Pose2(p.x + dx, p.y + dy, p.yaw) for p in LAP]


def test_walls_seen_again_lie_where_they_were() -> None:
    found = true_quality()
    assert found.revisit_residual == pytest.approx(found.pass_residual, abs=0.03)
    assert found.revisit_residual < 0.1
    assert found.revisited > 0.9


@pytest.mark.parametrize("shift", [0.3, 0.6])
def test_the_revisit_residual_is_the_distance_of_the_walls(shift: float) -> None:
    """A shift along both axes moves each wall by one of them; walls are nearly equally long."""
    still, found = true_quality(), quality(shifted(shift, shift))
    assert still.revisit_residual < found.revisit_residual < shift + still.revisit_residual
    assert found.revisit_residual == pytest.approx(shift, rel=0.35)
    assert found.pass_residual == pytest.approx(still.pass_residual, abs=0.02)


def test_walls_beyond_the_range_of_another_scan_are_not_counted() -> None:
    """A beam without return may have met nothing, or a wall too far away."""
    near = [replace(s, ranges=np.where(s.ranges < 2.5, s.ranges, np.inf), range_max=2.5) for s in SCANS]
    trajectory = Trajectory.from_poses([s.stamp for s in SCANS], TRUE)
    found = scan_consistency(near, UNKNOWN, trajectory)
    assert found.revisit_residual < 0.1


def test_one_pass_alone_has_no_revisit_residual() -> None:
    trajectory = Trajectory.from_poses([s.stamp for s in SCANS[:15]], LAP[:15])
    found = scan_consistency(SCANS[:15], UNKNOWN, trajectory)
    assert (found.revisit_residual, found.revisited) == (None, 0.0)
    assert found.pass_residual is not None


def test_the_longest_way_without_a_scan_is_measured() -> None:
    kept = [k for k in range(len(TRUE)) if not 10 < k < 30]
    trajectory = Trajectory.from_poses([SCANS[k].stamp for k in kept], [TRUE[k] for k in kept])
    found = scan_consistency([SCANS[k] for k in kept], UNKNOWN[: len(kept)], trajectory)
    assert found is not None
    assert found.longest_gap == pytest.approx(TRUE[10].distance(TRUE[30]), abs=0.5)
    assert true_quality().longest_gap < 0.2 * found.longest_gap


def test_distances_are_those_to_the_nearest_hit() -> None:
    """Two scans of one wall, checked by a search through all pairs of hits."""
    poses = [Pose2(0.0, 0.0, 0.0), Pose2(0.0, 0.5, 0.1)]
    wall = np.array([(5.0, -8.0, 5.0, 8.0)])
    scans = [
        LaserScan(
            ranges_to(wall, pose, BEAMS).astype(np.float32), BEAMS[0], BEAMS[1] - BEAMS[0], 0.05, 30.0, k
        )
        for k, pose in enumerate(poses)
    ]
    wrong = [poses[0], Pose2(0.2, 0.5, 0.15)]
    found = scan_consistency(scans, [None] * 2, Trajectory.from_poses([0.0, 1.0], wrong))
    ends = [
        pose.apply(np.column_stack((r * np.cos(BEAMS), r * np.sin(BEAMS)))[(r < 10.0) & scan.hits])
        for scan, pose in zip(scans, wrong, strict=True)
        for r in (scan.ranges.astype(np.float64),)
    ]
    between = np.linalg.norm(ends[0][::2, None] - ends[1][None], axis=2).min(axis=1)
    back = np.linalg.norm(ends[1][::2, None] - ends[0][None], axis=2).min(axis=1)
    assert found.pass_residual == pytest.approx(np.minimum(np.append(between, back), 1.0).mean(), rel=0.05)
