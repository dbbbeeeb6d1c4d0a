"""Loops that move far wait for a second one."""

from __future__ import annotations

import numpy as np

from lirs_wct.geometry.pose import Pose2
from slam_baselines.cartographer.loop_closure.constraint_builder import LoopConstraint
from slam_baselines.cartographer.loop_closure.verification import LoopVerification
from slam_baselines.cartographer.loop_closure_config import LoopVerificationConfig


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
