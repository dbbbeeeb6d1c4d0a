"""Registration: when it searches, and what it rejects."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from lirs_wct.geometry.pose import Pose2
from slam_baselines.cartographer.config import CartographerConfig
from slam_baselines.dead_reckoning import PoseEstimate
from slam_baselines.registration import Registration, RegistrationConfig, ScanMatcher, correlative_search
from tests.slam_baselines.matching.room import room_map

TRUE = Pose2(0.5, -0.3, 0.4)
CONFIGS = [RegistrationConfig(), CartographerConfig()]


def near(dx: float, dy: float, dyaw: float, sigma: float = 0.05) -> PoseEstimate:
    pose = Pose2(TRUE.x + dx, TRUE.y + dy, TRUE.yaw + dyaw)
    return PoseEstimate(pose, np.diag((sigma**2, sigma**2, sigma**2)))


@pytest.mark.parametrize("config", CONFIGS)
def test_a_small_error_needs_no_search(config: RegistrationConfig) -> None:
    builder, points = room_map(TRUE)
    registration, expected = Registration(config, ScanMatcher()), near(0.04, -0.03, 0.02)
    estimate, match = registration.register(builder.pyramid, points, None, expected, expected.pose)
    assert match is not None
    assert estimate.pose.distance(TRUE) < 0.02
    assert np.trace(estimate.covariance) < np.trace(expected.covariance)
    assert registration.searches == 0


def test_a_sharp_turn_is_searched_for() -> None:
    builder, points = room_map(TRUE)
    registration, expected = Registration(RegistrationConfig(), ScanMatcher()), near(0.4, -0.3, 0.42)
    estimate, _ = registration.register(builder.pyramid, points, None, expected, Pose2())
    assert registration.searches == 1
    assert estimate.pose.distance(TRUE) < 0.03


@pytest.mark.parametrize("config", CONFIGS)
def test_fewest_beams_are_enough_however_small_their_share(config: RegistrationConfig) -> None:
    """Rounding errors of the beams' weights once refused exactly as many as are needed."""
    builder, points = room_map(TRUE)
    some = points[:: len(points) // config.min_beams]
    far = np.tile((300.0, 0.0, 0.0), (7, 1))
    for share in (0.0, 0.02, 0.05):
        before, expected = TRUE @ Pose2(share), near(0, 0, 0)
        for beams in (config.min_beams - 1, config.min_beams):
            hits = np.concatenate((some[:beams], far))
            _, match = Registration(config, ScanMatcher()).register(
                builder.pyramid, hits, None, expected, before
            )
            assert (match is not None) == (beams == config.min_beams)


def test_on_uneven_ground_a_poor_match_is_rejected_where_that_is_configured() -> None:
    builder, points = room_map(TRUE)
    noise = np.column_stack((np.random.default_rng(0).uniform(-2, 2, (len(points), 2)), points[:, 2]))
    weights: NDArray[np.float64] = np.ones(len(points))
    expected = near(0, 0, 0)
    estimate, match = Registration(CONFIGS[0], ScanMatcher()).register(
        builder.pyramid, noise, weights, expected, Pose2()
    )
    assert match is not None
    assert match.score < CONFIGS[0].search_threshold
    assert estimate is expected
    forced = replace(CONFIGS[0], reject_poor=False, mahalanobis_gate=math.inf)
    assert (
        Registration(forced, ScanMatcher()).register(builder.pyramid, noise, weights, expected, Pose2())[0]
        is not expected
    )


def test_the_wider_search_survives_a_sharp_turn() -> None:
    true = Pose2(0.5, -0.3, 0.4)
    builder, points = room_map(true)
    start = true.as_array() + np.array((0.4, -0.3, 0.42))
    found = correlative_search(builder.pyramid.maps[2].grid, points, np.ones(len(points)), start, 0.7, 0.5)
    np.testing.assert_allclose(found[:2], true.as_array()[:2], atol=0.2)
    assert found[2] == pytest.approx(0.4, abs=0.04)
