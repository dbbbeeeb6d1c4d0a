"""Loop closure: candidates, search, verification."""

import math

import numpy as np
import pytest

from lirs_wct.geometry.pose import Pose2
from slam_baselines.cartographer.config import CartographerConfig
from slam_baselines.cartographer.global_slam import GlobalSlam
from slam_baselines.cartographer.loop_closure import (
    CandidateQueue,
    ConstraintBuilder,
    LoopConstraint,
    LoopVerification,
)
from slam_baselines.cartographer.pose_graph import PoseConstraints
from slam_baselines.cartographer.submap import Submap
from slam_baselines.leveling import ScanPoints
from slam_baselines.mapper import make_mapper
from tests.slam_baselines.cartographer.corridor import corridor_scan, ring


def test_the_queue_takes_new_nodes_first_and_enough_is_enough():
    queue = CandidateQueue(CartographerConfig(loops_per_pair=2, searches_per_pair=3, max_num_candidates=5))
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


def test_a_scan_is_found_in_a_submap():
    rng = np.random.default_rng(0)
    submap = Submap(CartographerConfig(), Pose2())
    pose = Pose2(7.5, 0.0, math.pi / 2)
    scan = corridor_scan(pose, 0.0, rng)
    hits = ends(scan)
    for _ in range(4):
        placed = ScanPoints(np.zeros(3), lifted(pose.apply(hits)), np.empty((0, 3)))
        submap.draw_range_data(0, placed, np.zeros(len(hits), np.uint8), 0)
    builder = ConstraintBuilder(CartographerConfig())
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
    verification = LoopVerification(CartographerConfig())
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


def test_the_same_nodes_added_again_are_constrained_alike():
    """Also where the newest submap holds a single node: each submap hangs on the one before, once."""
    rng, mapper, truth = np.random.default_rng(2), make_mapper("cartographer"), ring(1)
    local = mapper.local
    for i, pose in enumerate(truth):
        mapper.update(corridor_scan(pose, 0.2 * i, rng), truth[0].inverse() @ pose, None)
        if len(local.submaps.all) == 2 and len(local.submaps.all[-1].nodes) == 1:
            break
    else:
        pytest.fail("the drive is too short for a second submap")
    again = GlobalSlam(mapper.config, local)
    for node in mapper._graph.nodes:
        again.add_node(node)
    now, before = (PoseConstraints.stack(graph._to_submaps) for graph in (again, mapper._graph))
    assert (now.a.tolist(), now.b.tolist()) == ([0], [1])
    np.testing.assert_allclose(now.z, before.z)
    np.testing.assert_allclose(now.information, before.information)


def test_the_path_is_that_after_all_waiting_searches_and_the_drive_goes_on_as_before():
    often = {"sampling_ratio": 1.0, "loops_per_pair": 99, "searches_per_pair": 99}
    rng, mapper, truth = np.random.default_rng(2), make_mapper("cartographer", **often), ring(1.4, 0.3)
    for i, pose in enumerate(truth):
        mapper.update(corridor_scan(pose, 0.2 * i, rng), truth[0].inverse() @ pose, None)
    graph = mapper._graph
    waiting, loops, poses = len(graph.candidates), len(graph.loops), list(graph.poses)
    assert waiting > 20
    end = graph._copy()
    end._finish()
    assert len(end.candidates) == 0
    assert len(end.loops) > loops
    assert graph.optimized_poses()[0] == end.poses
    assert (len(graph.candidates), len(graph.loops), graph.poses) == (waiting, loops, poses)
    assert graph.optimized_poses()[0] is graph.optimized_poses()[0], "searched again only after an update"
