"""The pose graph as it grows."""

import numpy as np
import pytest

from slam_baselines.cartographer.config import CandidateConfig, GlobalConfig
from slam_baselines.cartographer.global_slam import GlobalSlam
from slam_baselines.mapper import make_mapper
from tests.slam_baselines.cartographer.corridor import corridor_scan, ring


def test_the_same_nodes_added_again_are_constrained_alike():
    """Also where the newest submap holds a single node: each submap hangs on the one before, once."""
    rng, mapper, truth = np.random.default_rng(2), make_mapper("cartographer"), ring(1)
    local = mapper
    for i, pose in enumerate(truth):
        mapper.update(corridor_scan(pose, 0.2 * i, rng), truth[0].inverse() @ pose, None)
        if len(local.submaps.all) == 2 and len(local.submaps.all[-1].nodes) == 1:
            break
    else:
        pytest.fail("the drive is too short for a second submap")
    again = GlobalSlam(mapper.config.graph, local)
    for node in mapper._graph.nodes:
        again.add_node(node)
    now, before = again._to_submaps.constraints(), mapper._graph._to_submaps.constraints()
    assert (now.a.tolist(), now.b.tolist()) == ([0], [1])
    np.testing.assert_allclose(now.z, before.z)
    np.testing.assert_allclose(now.information, before.information)


def test_the_path_is_that_after_all_waiting_searches_and_the_drive_goes_on_as_before():
    often = GlobalConfig(candidates=CandidateConfig(sampling_ratio=1.0, found_per_pair=99, tries_per_pair=99))
    rng, mapper, truth = np.random.default_rng(2), make_mapper("cartographer", graph=often), ring(1.4, 0.3)
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
