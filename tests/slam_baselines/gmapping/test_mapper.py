"""GMapping as a whole: a synthetic room with bad odometry, and a slice of a real log."""

import math
from pathlib import Path

import numpy as np
import pytest

from lirs_validation import validate
from lirs_validation.logs.read_log import read_constraints
from lirs_validation.metrics.mapped_log import constraint_errors
from lirs_wct.formats.carmen_log import read_carmen
from lirs_wct.geometry.pose import Pose2, Trajectory
from lirs_wct.geometry.scan import LaserScan
from slam_baselines.dead_reckoning import PoseEstimate
from slam_baselines.gmapping.mapper import (
    BiasedRegistration,
    GmappingConfig,
    GmappingKeyframe,
    GmappingMapper,
)
from slam_baselines.gmapping.motion import GyroBiasConfig, remove_bias
from slam_baselines.gmapping.particles import TrajectoryTree
from slam_baselines.gmapping.proposal import Proposer
from slam_baselines.ground_filter import GroundFilter
from slam_baselines.leveling import LeveledScan
from slam_baselines.mapper import Mapper, make_mapper
from tests.slam_baselines.synthetic import ranges_to

WALLS = np.array((
    (-4.0, -3.0, 5.0, -3.0), (5.0, -3.0, 5.0, 4.0), (5.0, 4.0, -4.0, 4.0), (-4.0, 4.0, -4.0, -3.0),
    (1.5, -0.5, 2.5, -0.5), (2.5, -0.5, 2.5, 1.0), (2.5, 1.0, 1.5, 1.0), (1.5, 1.0, 1.5, -0.5),
))  # fmt: skip
BEAMS = 181


def scan_at(pose: Pose2, stamp: float, rng: np.random.Generator) -> LaserScan:
    ranges = ranges_to(WALLS, pose, np.linspace(-np.pi / 2, np.pi / 2, BEAMS)) + rng.normal(0, 0.01, BEAMS)
    return LaserScan(ranges.astype(np.float32), -np.pi / 2, np.pi / (BEAMS - 1), 0.05, 20.0, stamp)


def circuit() -> list[Pose2]:
    """Twice around the block in the room, 10 cm a step, starting at the origin of nothing in particular."""
    angle = np.linspace(0, 4 * np.pi, 260)
    x, y = 2.0 + 2.0 * np.cos(angle), 0.25 + 2.2 * np.sin(angle)
    yaw = np.arctan2(np.gradient(y), np.gradient(x))
    return [Pose2(*p) for p in zip(x.tolist(), y.tolist(), yaw.tolist(), strict=True)]


def run(mapper: Mapper, truth: list[Pose2], seed: int) -> tuple[list[Pose2], list[Pose2]]:
    """Feed the mapper with a drifting odometry; return its answers and that odometry."""
    rng = np.random.default_rng(seed)
    odometry, answers, track = Pose2(7, -3, 1), [], []
    for i, pose in enumerate(truth):
        if i:
            step = truth[i - 1].inverse() @ pose
            # 3 % too far and 6 % too little turn, as a worn wheel does.
            odometry = odometry @ Pose2(step.x * 1.03, step.y, step.yaw * 0.94)
        answers.append(mapper.update(scan_at(pose, 0.2 * i, rng), odometry, None))
        track.append(odometry)
    return answers, track


def errors(poses: list[Pose2], truth: list[Pose2]) -> np.ndarray:
    return np.array([p.distance(truth[0].inverse() @ t) for p, t in zip(poses, truth, strict=True)])


def test_a_few_scans_with_slipping_wheels() -> None:
    """A scan every .7 m, and odometry that is 15 % too long or too short from one to the next."""
    truth = circuit()[::7]
    rng, odometry = np.random.default_rng(4), Pose2()
    mapper, answers = make_mapper("gmapping", particles=10, seed=3), []
    for i, pose in enumerate(truth):
        if i:
            step = truth[i - 1].inverse() @ pose
            odometry = odometry @ Pose2(step.x * rng.choice((0.85, 1.15)), step.y, step.yaw)
        answers.append(mapper.update(scan_at(pose, 2.0 * i, rng), odometry, None))
    assert errors(answers, truth).max() < 0.1
    assert mapper.stats.counts["searches"] >= len(truth) - 2


def test_a_room_with_bad_odometry() -> None:
    truth = circuit()
    mapper = make_mapper("gmapping", particles=10, seed=3)
    answers, track = run(mapper, truth, 1)
    assert errors([track[0].inverse() @ o for o in track], truth).max() > 0.5
    assert errors(answers, truth).max() < 0.06
    path = mapper.trajectory()
    assert len(path) == len(truth)
    final = errors([path.pose2(i) for i in range(len(path))], truth)
    assert np.sqrt((final**2).mean()) < 0.03
    stats = mapper.stats
    assert stats.received == len(truth) == stats.used + stats.skipped["not moved"]
    assert 20 < stats.used < 80
    assert not mapper.lost
    walls = mapper.map().moved(truth[0]).occupied_points()
    a, d = WALLS[:, :2], WALLS[:, 2:] - WALLS[:, :2]
    t = np.clip(((walls[:, None] - a) * d).sum(-1) / (d**2).sum(-1), 0, 1)
    off = np.linalg.norm(walls[:, None] - a - t[..., None] * d, axis=-1).min(axis=1)
    assert len(walls) > 500
    assert (off < 0.1).mean() > 0.99


def test_same_seed_same_bytes() -> None:
    truth = circuit()[:80]
    first, again, other = (make_mapper("gmapping", particles=5, seed=s) for s in (1, 1, 2))
    answers = [run(m, truth, 1)[0] for m in (first, again, other)]
    assert answers[0] == answers[1] != answers[2]
    np.testing.assert_array_equal(first.map().log_odds, again.map().log_odds)


def test_standing_still_processes_nothing() -> None:
    mapper = make_mapper("gmapping", particles=3)
    run(mapper, [Pose2(0, 0, 0)] * 20, 1)
    assert (mapper.stats.used, mapper.stats.skipped) == (1, {"not moved": 19})


def test_lost_after_being_carried_away_and_not_before() -> None:
    rng = np.random.default_rng(1)
    mapper = make_mapper("gmapping", particles=5)
    _, track = run(mapper, circuit()[:130], 1)
    assert not mapper.lost
    for i in range(60):
        noise = LaserScan(rng.uniform(0.1, 0.9, BEAMS).astype(np.float32), -1.57, 0.0174, 0.05, 20.0, 100 + i)
        mapper.update(noise, track[-1] @ Pose2(0.2 * (i % 2), 0, 0), None)
    assert mapper.lost
    assert mapper.stats.lost > 0


def test_the_tree_follows_the_survivors_and_forgets_the_dead() -> None:
    rng = np.random.default_rng(4)
    tree, plain = TrajectoryTree(), []
    parents = np.arange(6)
    for _ in range(40):
        poses = rng.normal(size=(6, 3))
        tree.add_generation(poses, parents, Pose2(1, 0, 0))
        plain.append((poses, parents))
        parents = np.sort(rng.integers(0, 6, 6))
    k, expected = 2, []
    for poses, parents in reversed(plain):
        expected.append(poses[k])
        k = parents[k]
    np.testing.assert_array_equal(tree.path(2), np.array(expected[::-1]))
    assert sum(len(p) for p in tree._poses) < 40 * 6 / 2


def test_between_processed_scans_the_error_is_spread() -> None:
    tree = TrajectoryTree()
    tree.add_generation(np.zeros((1, 3)), np.zeros(1, np.int64), Pose2())
    for i in range(4):
        tree.add_scan(float(i), Pose2(0.25 * i, 0, 0))
    tree.add_generation(np.array([[1.0, 0.4, 0.0]]), np.zeros(1, np.int64), Pose2(1, 0, 0))
    tree.add_scan(4.0, Pose2())
    np.testing.assert_allclose(tree.trajectory(0).xy[:, 1], (0, 0.1, 0.2, 0.3, 0.4), atol=1e-12)


def test_a_match_far_from_dead_reckoning_is_not_believed(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a slope with few walls one scan was matched 1.6 m away, and the map went on from there."""
    rng, mapper = np.random.default_rng(3), GmappingMapper(GmappingConfig(particles=3, seed=1))
    poses = [Pose2(0.05 * k) for k in range(40)]
    for k, pose in enumerate(poses[:30]):
        mapper.update(scan_at(pose, 0.1 * k, rng), pose, None)
    monkeypatch.setattr(mapper._filter, "match_best", lambda *_, **__: Pose2(-1.6))
    for k, pose in enumerate(poses[30:], 30):
        found = mapper.update(scan_at(pose, 0.1 * k, rng), pose, None)
        assert found.distance(pose) < 0.1


@pytest.mark.slow
@pytest.mark.shared
def test_first_part_of_the_intel_log(shared_data: Path) -> None:
    """Fifty times as exact as the odometry: the log's first 900 scans, 10 particles."""
    log = read_carmen(shared_data / "logs" / "intel" / "intel.clf.gz")
    relations = read_constraints(shared_data / "logs" / "intel" / "intel.relations.gz")
    mapper = make_mapper("gmapping", particles=10, seed=1)
    for scan, odometry in zip(log.scans[:900], log.odometry[:900], strict=True):
        mapper.update(scan, odometry, None)
    error = constraint_errors(mapper.trajectory(), relations, log.track)
    raw = Trajectory.from_poses(log.stamps[:900].tolist(), list(log.odometry[:900]))
    by_odometry = constraint_errors(raw, relations, log.track)
    assert len(error.translation) > 100
    assert error.translation.mean() < 0.025
    assert np.degrees(error.rotation.mean()) < 0.75
    assert by_odometry.translation.mean() > 50 * error.translation.mean()


BIAS = math.radians(0.03)


@pytest.mark.parametrize("bias", [BIAS, -2 * BIAS, 0.0])
def test_the_bias_is_learnt_from_where_the_walls_put_the_scans(bias: float) -> None:
    rng = np.random.default_rng(2)
    nothing = np.empty((0, 3))
    scan = LeveledScan(np.zeros(3), nothing, nothing, (0.0, 0.0), True, 0.0)

    def keyframe(step: Pose2, seconds: float) -> GmappingKeyframe:
        reckoned = PoseEstimate(step, np.eye(3))
        return GmappingKeyframe(scan, Pose2(), 0.0, np.empty(0, np.uint8), reckoned, seconds)

    gyro = GyroBiasConfig(gyro_bias_prior=2 * BIAS, heading_walk=math.radians(0.01))
    registration, truth = BiasedRegistration(Proposer(GmappingConfig()), GroundFilter(), gyro), [Pose2()]
    keyframes = [keyframe(Pose2(), 0.0)]
    for _ in range(30):
        step = Pose2(1.0, 0, float(rng.normal(0, 0.3)))
        truth.append(truth[-1] @ step)
        keyframes.append(keyframe(remove_bias(step, -bias, 1.2), 1.2))
    noisy = [Pose2(p.x, p.y, p.yaw + float(rng.normal(0, math.radians(0.2)))) for p in truth]
    registration.learn(keyframes, noisy)
    assert registration.bias.value == pytest.approx(bias, abs=math.radians(0.008))


@pytest.mark.slow
def test_the_map_of_a_hilly_world_is_not_turned() -> None:
    record = validate("simple", mapper="gmapping", seconds=60, seed=6).record
    assert record.trajectory["ate_rmse"] < 0.03
    assert record.map["false_occupied"] <= 0.03
    assert record.map["f1"] >= 0.98
