"""The first meters of gmapping on uneven ground: the gyro's bias found and taken out."""

import math

import numpy as np
import pytest

from lirs_validation import validate
from lirs_wct.geometry.pose import Pose2
from slam_baselines.gmapping.mapper import BiasedRegistration, GmappingKeyframe, GyroIncrement
from slam_baselines.gmapping.proposal import ProposalConfig, Proposer
from slam_baselines.mapping.ground_filter import GroundFilter
from slam_baselines.mapping.keyframe import Keyframe
from slam_baselines.motion.dead_reckoning import PoseEstimate
from slam_baselines.motion.gyro_bias import GyroBiasConfig
from slam_baselines.motion.increment import remove_bias
from slam_baselines.scan.leveling import LeveledScan

BIAS = math.radians(0.03)


@pytest.mark.parametrize("bias", [BIAS, -2 * BIAS, 0.0])
def test_the_bias_is_learnt_from_where_the_walls_put_the_scans(bias: float) -> None:
    rng = np.random.default_rng(2)
    nothing = np.empty((0, 3))
    scan = LeveledScan(np.zeros(3), nothing, nothing, (0.0, 0.0), 0.01, 0.0)

    def keyframe(step: Pose2, seconds: float) -> GmappingKeyframe:
        motion = GyroIncrement(PoseEstimate(step, np.eye(3)), seconds)
        return Keyframe(scan, Pose2(), 0.0, np.empty(0, np.uint8), motion)

    gyro = GyroBiasConfig(prior=2 * BIAS, walk=math.radians(0.01))
    registration, truth = BiasedRegistration(Proposer(ProposalConfig()), GroundFilter(), gyro), [Pose2()]
    keyframes = [keyframe(Pose2(), 0.0)]
    for _ in range(30):
        step = Pose2(1.0, 0, float(rng.normal(0, 0.3)))
        truth.append(truth[-1] @ step)
        keyframes.append(keyframe(remove_bias(step, -bias, 1.2), 1.2))
    noisy = [Pose2(p.x, p.y, p.yaw + float(rng.normal(0, math.radians(0.2)))) for p in truth]
    registration.learn(keyframes, noisy)
    assert registration.bias.value == pytest.approx(bias, abs=math.radians(0.008))


def test_the_map_of_a_hilly_world_is_not_turned() -> None:
    record = validate("simple", mapper="gmapping", seconds=60, seed=6).record
    assert record.trajectory["ate_rmse"] < 0.03
    assert record.map["false_occupied"] <= 0.03
    assert record.map["f1"] >= 0.98
