"""Cartographer in the plane with the original's defaults: what it takes from a scan, and what it leaves."""

from __future__ import annotations

import math

import numpy as np
import pytest

from lirs_wct import Imu, Pose2
from lirs_wct.errors import ConfigError
from lirs_wct.geometry.grid import OccupancyGrid
from slam_baselines.cartographer.original import CartographerOriginalConfig, CartographerOriginalMapper
from slam_baselines.mapper import make_mapper
from slam_baselines.matching.gauss_newton import MatchConfig
from slam_baselines.matching.registration import Registration, RegistrationConfig
from slam_baselines.motion.dead_reckoning import PoseEstimate
from tests.slam_baselines.synthetic import drive_room, loop, room_scan


def test_a_drive_through_a_room() -> None:
    mapper = CartographerOriginalMapper()
    errors = drive_room(mapper)
    assert np.hypot(errors[:, 0], errors[:, 1]).max() < 0.15
    assert mapper.map().occupied.sum() > 300
    assert (mapper.stats.received, len(mapper.trajectory()), mapper.lost) == (240, 240, False)


def test_attitude_changes_nothing() -> None:
    rng, path = np.random.default_rng(0), loop(40)
    scans = [room_scan(pose, 0.1 * k, rng) for k, pose in enumerate(path)]
    level, leaning = CartographerOriginalMapper(), CartographerOriginalMapper()
    for scan, pose in zip(scans, path, strict=True):
        assert level.update(scan, pose, None) == leaning.update(scan, pose, Imu(roll=0.2, pitch=-0.1))


def test_it_does_not_localize() -> None:
    known = OccupancyGrid.from_probability(np.ones((4, 4)), 0.05)
    with pytest.raises(ConfigError, match="cartographer_original only maps"):
        make_mapper("cartographer_original", map=known)


def test_the_published_defaults_are_set() -> None:
    c = CartographerOriginalConfig()
    local, graph = c.local, c.graph
    submaps = local.submaps
    assert (submaps.num_range_data, submaps.max_distance, submaps.resolution) == (90, math.inf, 0.05)
    motion = local.motion_filter
    assert (motion.max_time_seconds, motion.max_distance_meters) == (5.0, 0.2)
    assert motion.max_angle_radians == math.radians(1.0)
    assert (local.registration.translation_weight, local.registration.rotation_weight) == (10.0, 40.0)
    assert (graph.optimize_every_n_nodes, graph.candidates.sampling_ratio) == (90, 0.3)
    assert (graph.constraints.min_score, c.max_range, c.clear_range) == (0.55, 30.0, 5.0)


def test_fixed_weights_hold_the_pose_whatever_dead_reckoning_says() -> None:
    """Weights w beside the mean of n errors: variance sigma^2 / (n w^2)."""
    wide = PoseEstimate(Pose2(), np.diag((1.0, 1.0, 1.0)))
    fixed = Registration(
        RegistrationConfig(match=MatchConfig(sigma=0.3), translation_weight=10.0, rotation_weight=40.0)
    )
    np.testing.assert_allclose(
        np.diag(fixed._prior_covariance(wide, 100)), (9e-6, 9e-6, 9e-6 / 16), rtol=1e-12
    )
    free = Registration(RegistrationConfig())
    assert free._prior_covariance(wide, 100) is wide.covariance
