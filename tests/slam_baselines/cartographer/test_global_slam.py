"""The pose graph as it grows."""

from __future__ import annotations

import numpy as np
import pytest

from slam_baselines.cartographer.global_slam import GlobalSlam
from slam_baselines.mapper import make_mapper
from tests.slam_baselines.cartographer.corridor import corridor_scan, ring


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
