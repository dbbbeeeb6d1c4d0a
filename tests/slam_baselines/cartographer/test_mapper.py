"""Cartographer as a whole: a ring driven twice, a real log."""

import math
from pathlib import Path

import numpy as np
import pytest

from lirs_validation.logs.read_log import read_constraints
from lirs_validation.metrics.mapped_log import constraint_errors
from lirs_wct.formats.carmen_log import read_carmen
from lirs_wct.geometry.pose import Pose2, Trajectory
from slam_baselines.mapper import make_mapper
from tests.slam_baselines.cartographer.corridor import CORRIDOR, corridor_scan, ring


def drive(truth, seed=1, config=None):
    rng = np.random.default_rng(seed)
    mapper, odometry, answers = make_mapper("cartographer", **(config or {})), Pose2(3, 2, 1), []
    for i, pose in enumerate(truth):
        if i:
            d = truth[i - 1].inverse() @ pose
            odometry = odometry @ Pose2(d.x * 1.04, d.y, d.yaw * 0.96 + rng.normal(0.0015, 0.002))
        answers.append(mapper.update(corridor_scan(pose, 0.2 * i, rng), odometry, None))
    return mapper, answers


def aligned(trajectory, truth):
    """The pose T_world_map that brings the trajectory closest to the truth."""
    a, b = trajectory.xy, np.array([(p.x, p.y) for p in truth])
    A, B = a - a.mean(axis=0), b - b.mean(axis=0)
    cross = (A[:, 0] * B[:, 1] - A[:, 1] * B[:, 0]).sum()
    turn = Pose2(yaw=math.atan2(cross, (A * B).sum()))
    x, y = b.mean(axis=0) - turn.apply(a.mean(axis=0))
    return Pose2(float(x), float(y), turn.yaw)


def rmse(trajectory, truth):
    moved = trajectory.moved(aligned(trajectory, truth))
    return math.sqrt(np.mean((moved.xy - [(p.x, p.y) for p in truth]) ** 2) * 2)


def closure(trajectory, truth):
    """RMSE of where the robot is on its second round, as seen from where it was on the first, meters."""
    half = len(truth) // 2
    errors = [
        (trajectory.pose2(i).inverse() @ trajectory.pose2(i + half)).distance(
            truth[i].inverse() @ truth[i + half]
        )
        for i in range(half)
    ]
    return math.sqrt(np.mean(np.square(errors)))


@pytest.fixture(scope="module")
def twice_round():
    truth = ring(2.0)
    return (*drive(truth), truth)


def test_a_ring_driven_twice_closes(twice_round):
    mapper, _, truth = twice_round
    counts = mapper.stats.counts
    assert counts["loops"] >= 5
    assert counts["optimizations"] >= 1
    assert rmse(mapper.trajectory(), truth) < 0.06
    assert closure(mapper.trajectory(), truth) < 0.03
    assert len(mapper.trajectory()) == len(truth) == mapper.stats.received
    assert not mapper.lost


def test_without_loops_the_same_drive_is_worse(twice_round):
    mapper, _, truth = twice_round
    no_loops = {"min_refined_score": 1.0, "min_score": 1.0, "global_min_score": 1.0}
    alone, _ = drive(truth, config=no_loops)
    assert alone.stats.counts["loops"] == 0
    assert closure(alone.trajectory(), truth) > 2 * closure(mapper.trajectory(), truth)


def test_the_map_shows_single_walls(twice_round):
    mapper, _, truth = twice_round
    points = aligned(mapper.trajectory(), truth).apply(mapper.map().occupied_points())
    a, b = CORRIDOR[:, :2], CORRIDOR[:, 2:]
    along = np.einsum("nsk,sk->ns", points[:, None] - a, b - a) / ((b - a) ** 2).sum(axis=1)
    foot = a + np.clip(along, 0, 1)[..., None] * (b - a)
    off = np.linalg.norm(points[:, None] - foot, axis=2).min(axis=1)
    assert len(points) > 1000
    assert np.mean(off < 0.1) > 0.97


def test_asking_for_the_map_changes_nothing():
    truth = ring(0.4)
    rng = np.random.default_rng(0)
    scans = [corridor_scan(p, 0.2 * i, rng) for i, p in enumerate(truth)]
    quiet, asked = make_mapper("cartographer"), make_mapper("cartographer")
    for i, scan in enumerate(scans):
        if i % 25 == 0:
            asked.map()
            asked.trajectory()
        assert quiet.update(scan, truth[i], None) == asked.update(scan, truth[i], None)
    np.testing.assert_array_equal(quiet.map().log_odds, asked.map().log_odds)


def test_the_map_grows_as_if_drawn_at_once():
    """A kept map equals a new one of all nodes."""
    truth = ring(0.3)
    rng = np.random.default_rng(0)
    mapper = make_mapper("cartographer")
    for i, pose in enumerate(truth):
        mapper.update(corridor_scan(pose, 0.2 * i, rng), pose, None)
        if i == len(truth) // 2:
            mapper.map()
    again, _ = mapper.map(), mapper._map._clear()
    np.testing.assert_array_equal(again.log_odds, mapper.map().log_odds)


@pytest.mark.slow
@pytest.mark.shared
def test_a_slice_of_a_real_log(shared_data: Path):
    """1,500 scans; the floor of these relations is about .015 m."""
    folder = shared_data / "logs" / "intel"
    log, relations = read_carmen(folder / "intel.clf.gz"), read_constraints(folder / "intel.relations.gz")
    mapper = make_mapper("cartographer")
    for scan, odometry in zip(log.scans[:1500], log.odometry[:1500], strict=True):
        mapper.update(scan, odometry, None)
    estimate = mapper.trajectory()
    inside = tuple(r for r in relations if max(r.stamp_a, r.stamp_b) <= estimate.stamps[-1])
    errors = constraint_errors(estimate, inside, log.track)
    raw = constraint_errors(
        Trajectory.from_poses(log.stamps[:1500].tolist(), log.odometry[:1500]), inside, log.track
    )
    assert len(errors.translation) > 200
    assert errors.translation.mean() < 0.027
    assert np.median(errors.translation) < 0.022
    assert errors.translation.mean() < 0.01 * raw.translation.mean()
    assert mapper.stats.counts["loops"] > 20
