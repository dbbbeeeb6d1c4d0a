"""Cartographer as a whole and its parts: submaps, candidates, loops, a ring driven twice, a real log."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from lirs_validation.metrics.relative_pose_constraints import constraint_errors, read_constraints
from lirs_wct.errors import ConfigError
from lirs_wct.formats.carmen.log import read_carmen
from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.scan import LaserScan
from lirs_wct.geometry.trajectory import Trajectory
from slam_baselines.cartographer.constraints.builder import (
    ConstraintBuilder,
    ConstraintConfig,
    LoopConstraint,
)
from slam_baselines.cartographer.constraints.candidates import CandidateConfig, CandidateQueue
from slam_baselines.cartographer.constraints.verification import LoopVerification, LoopVerificationConfig
from slam_baselines.cartographer.global_slam import GlobalSlam
from slam_baselines.cartographer.node_trajectory import NodeTrajectory
from slam_baselines.cartographer.submap import Submap, SubmapConfig, Submaps
from slam_baselines.mapper import make_mapper
from slam_baselines.scan.leveling import ScanPoints
from tests.slam_baselines.synthetic import ranges_to

OUTER, INNER = 9.0, 6.0
"""Half edges of a corridor that leads around a block, metres."""


def box(half_x, half_y, x=0.0, y=0.0):
    c = [
        (x - half_x, y - half_y),
        (x + half_x, y - half_y),
        (x + half_x, y + half_y),
        (x - half_x, y + half_y),
    ]
    return [(*c[i], *c[(i + 1) % 4]) for i in range(4)]


CUPBOARDS = ((8.7, 3), (6.3, -4), (2, 8.6), (-5, 6.4), (-8.6, -1), (-3, -8.5), (4, -6.4))
CORRIDOR = np.array(
    box(OUTER, OUTER) + box(INNER, INNER) + [s for x, y in CUPBOARDS for s in box(0.3, 0.4, x, y)]
)
"""The corridor, with a cupboard here and there."""


def corridor_scan(pose, stamp, rng, beams=181):
    start, step = -0.75 * math.pi, 1.5 * math.pi / (beams - 1)
    r = ranges_to(CORRIDOR, pose, start + step * np.arange(beams), 6.0) + rng.normal(0, 0.01, beams)
    return LaserScan(r.astype(np.float32), start, step, 0.05, 6.0, stamp)


def ring(rounds, step=0.15):
    """Along the middle of the corridor with rounded corners, from the middle of the east side."""
    half, radius = (OUTER + INNER) / 2, 1.0
    side, corner = 2 * (half - radius), radius * math.pi / 2
    poses = []
    for s in np.arange(0, rounds * 4 * (side + corner), step) + side / 2:
        k, rest = divmod(s, side + corner)
        along, angle = min(rest, side), max(0.0, rest - side) / radius
        local = Pose2(half, along - side / 2, math.pi / 2) @ Pose2(
            radius * math.sin(angle), radius * (1 - math.cos(angle)), angle
        )
        poses.append(Pose2(0, 0, k % 4 * math.pi / 2) @ local)
    return poses


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
    """RMSE of where the robot is on its second round, as seen from where it was on the first, metres."""
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
    alone, _ = drive(truth, config={"graph": no_loops()})
    assert alone.stats.counts["loops"] == 0
    assert closure(alone.trajectory(), truth) > 2 * closure(mapper.trajectory(), truth)


def no_loops():
    from slam_baselines.cartographer.config import GlobalConfig

    return GlobalConfig(
        constraints=ConstraintConfig(min_refined_score=1.0, min_score=1.0, global_min_score=1.0)
    )


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
    """What was drawn is kept while nodes stay; the result is the same as drawing all anew."""
    truth = ring(0.3)
    rng = np.random.default_rng(0)
    mapper = make_mapper("cartographer")
    for i, pose in enumerate(truth):
        mapper.update(corridor_scan(pose, 0.2 * i, rng), pose, None)
        if i == len(truth) // 2:
            mapper.map()
    again, _ = mapper.map(), mapper._map._clear()
    np.testing.assert_array_equal(again.log_odds, mapper.map().log_odds)


def test_submaps_overlap_and_finish():
    submaps = Submaps(SubmapConfig(num_range_data=3))
    scan = ScanPoints(np.zeros(3), np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), np.empty((0, 3)))
    entered = [
        list(submaps.insert_range_data(i, Pose2(i, 0), scan, np.zeros(2, np.uint8), 0)) for i in range(10)
    ]
    assert entered == [[0]] * 3 + [[0, 1]] * 3 + [[1, 2]] * 3 + [[2, 3]]
    assert [s.finished for s in submaps.all] == [True, True, False, False]
    assert submaps.all[1].nodes == [3, 4, 5, 6, 7, 8]
    assert submaps.all[1].pose == Pose2(3, 0)
    assert submaps.matching_submap is submaps.all[2]


def test_a_scan_is_found_in_a_submap():
    rng = np.random.default_rng(0)
    submap = Submap(SubmapConfig(), Pose2())
    pose = Pose2(7.5, 0.0, math.pi / 2)
    scan = corridor_scan(pose, 0.0, rng)
    hits = ends(scan)
    for _ in range(4):
        placed = ScanPoints(np.zeros(3), lifted(pose.apply(hits)), np.empty((0, 3)))
        submap.draw_range_data(0, placed, np.zeros(len(hits), np.uint8), 0)
    builder = ConstraintBuilder(ConstraintConfig())
    for distance_traveled, shift in ((0.0, Pose2(0.1, -0.1, 0.02)), (100.0, Pose2(0.9, 0.6, -0.2))):
        found = builder.compute_constraint(submap, lifted(hits), pose @ shift, distance_traveled)
        assert found is not None
        assert found.pose.distance(pose) < 0.05
        assert found.score > 0.4
    assert builder.compute_constraint(submap, lifted(hits[:5]), pose, 0.0) is None
    assert builder.compute_constraint(submap, lifted(rng.uniform(-5, 5, (150, 2))), pose, 100.0) is None
    assert builder.counts.found == 2


def ends(scan):
    r, a = scan.ranges[scan.hits], scan.angles[scan.hits]
    return np.stack((r * np.cos(a), r * np.sin(a)), axis=-1)


def lifted(points):
    return np.column_stack((points, np.zeros(len(points))))


def test_one_loop_that_moves_far_waits_for_a_second():
    verification = LoopVerification(LoopVerificationConfig())
    submaps, nodes = [Pose2()], [Pose2(i, 0.0) for i in range(4)]
    moved = Pose2(0.0, 2.0, 0.1)
    loops = [LoopConstraint(0, i, moved @ nodes[i], np.eye(3)) for i in range(4)]
    near = LoopConstraint(0, 3, Pose2(3.1, 0.0), np.eye(3))
    odd = LoopConstraint(0, 1, Pose2(4.0, -2.0), np.eye(3))
    assert verification.verify_loop(near, 3.0, submaps, nodes) == [near]
    assert verification.verify_loop(loops[0], 0.0, submaps, nodes) == []
    assert verification.verify_loop(odd, 1.0, submaps, nodes) == []
    assert verification.verify_loop(loops[2], 2.0, submaps, nodes) == [loops[0], loops[2]]
    assert len(verification) == 1  # the odd one


def test_the_queue_takes_new_nodes_first_and_enough_is_enough():
    queue = CandidateQueue(CandidateConfig(found_per_pair=2, tries_per_pair=3, max_num_candidates=5))
    queue.add_candidate(1, 0, 7, new_node=False)
    queue.add_candidate(20, 5, 7, new_node=True)
    queue.add_candidate(21, 5, 7, new_node=True)
    assert [
        queue.next_candidate(),
        queue.next_candidate(),
        queue.next_candidate(),
        queue.next_candidate(),
    ] == [(21, 7), (20, 7), (1, 7), None]
    queue.record_result(20, 7, found=True)
    queue.record_result(21, 7, found=True)
    queue.add_candidate(22, 5, 7, new_node=True)
    assert queue.next_candidate() is None
    for i in range(8):
        queue.add_candidate(i, 9, 3, new_node=False)
    assert (len(queue), queue.dropped) == (5, 3)


def test_scans_between_nodes_follow_both():
    track = NodeTrajectory()
    local = [Pose2(0, 0), Pose2(1, 0)]
    for stamp, x in ((0.0, 0.0), (0.5, 0.5)):
        track.add(stamp, Pose2(x, 0), 1, local[0])
    track.add(1.0, Pose2(1, 0), 2, local[1])
    track.add(1.5, Pose2(1.5, 0), 2, local[1])
    poses = track.trajectory(local, [Pose2(0, 0), Pose2(1, 0.4)], Pose2())
    np.testing.assert_allclose(poses.xy, [[0, 0], [0.5, 0.2], [1, 0.4], [1.5, 0.4]], atol=1e-9)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: SubmapConfig(search_level=3), "search_level"),
        (lambda: CandidateConfig(sampling_ratio=1.5), "sampling_ratio"),
        (lambda: ConstraintConfig(min_score=0.9), "global_min_score"),
        (lambda: make_mapper("cartographer", map_resolution=0.0), "map_resolution"),
        (lambda: make_mapper("cartographer", nonsense=1), "nonsense"),
    ],
)
def test_illegal_settings_are_refused(make, message):
    with pytest.raises(ConfigError, match=message):
        make()


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


def test_no_odometry_is_said_so():
    mapper = make_mapper("cartographer")
    with pytest.raises(ConfigError, match=r"needs odometry, the scan at 0\.5 s has none"):
        mapper.update(corridor_scan(Pose2(7.5, 0, 1.5), 0.5, np.random.default_rng(1)), None, None)
    assert mapper.stats.received == 0


def test_the_same_nodes_added_again_are_constrained_alike():
    """Also where the newest submap holds a single node: each submap hangs on the one before, once."""
    rng, mapper, truth = np.random.default_rng(2), make_mapper("cartographer"), ring(1)
    local = mapper._local
    for i, pose in enumerate(truth):
        mapper.update(corridor_scan(pose, 0.2 * i, rng), truth[0].inverse() @ pose, None)
        if len(local.submaps.all) == 2 and len(local.submaps.all[-1].nodes) == 1:
            break
    else:
        pytest.fail("the drive is too short for a second submap")
    again = GlobalSlam(mapper.config.graph, local)
    for node in mapper._graph.nodes:
        again.add_node(node)
    assert [(constraint.a, constraint.b) for constraint in again._to_submaps] == [(0, 1)]
    for now, before in zip(again._to_submaps, mapper._graph._to_submaps, strict=True):
        np.testing.assert_allclose(now.z, before.z)
        np.testing.assert_allclose(now.information, before.information)
