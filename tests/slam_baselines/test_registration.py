"""Registration: gradients, offsets that the matcher finds, the wider search, what is rejected."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.typing import NDArray

from lirs_wct.geometry.pose import Pose2
from slam_baselines.cartographer.config import CartographerConfig
from slam_baselines.correlative_search import correlative_search
from slam_baselines.dead_reckoning import MotionConfig, PoseEstimate, moved_covariance
from slam_baselines.front_end import BuilderConfig, MapBuilder
from slam_baselines.leveling import ScanLeveler
from slam_baselines.monitors import MonitorConfig
from slam_baselines.registration import (
    MatchMonitor,
    ReckoningWindow,
    Registration,
    RegistrationConfig,
    ScanMatcher,
    invert3,
    linearize,
    solve3,
)
from tests.slam_baselines.synthetic import ranges_to, room_scan

Array = NDArray[np.float64]


def room_map(pose: Pose2) -> tuple[MapBuilder, Array]:
    """The map of one scan, and the scan's points."""
    level = ScanLeveler().level(room_scan(pose, 0.0, np.random.default_rng(0)), None)
    builder = MapBuilder(BuilderConfig())
    for _ in range(3):
        builder.enter(level, pose)
    return builder, level.hits


Array = NDArray[np.float64]
LOOSE = np.diag((1e6, 1e6, 1e6))


def cost(value: NDArray[np.uint8], frame: Array, points: Array, pose: Array) -> float:
    """Sum of (1 - M)^2 with M written out plainly."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    total = 0.0
    for x, y in points[:, :2]:
        u = (pose[0] + c * x - s * y) / frame[2] - 0.5 - frame[1]
        v = (pose[1] + s * x + c * y) / frame[2] - 0.5 - frame[0]
        i, j = math.floor(u), math.floor(v)
        du, dv = u - i, v - j
        m = value[j : j + 2, i : i + 2].astype(float) / 255
        total += (1 - np.array((1 - dv, dv)) @ m @ np.array((1 - du, du))) ** 2
    return total


def test_gradient_equals_finite_differences() -> None:
    builder, points = room_map(Pose2())
    level = builder.pyramid.maps[1]
    points = points[::7]
    pose = np.array((0.031, -0.017, 0.012))
    H, g = np.empty((3, 3)), np.empty(3)
    linearize(level.layers.value, level.frame, points, np.ones(len(points)), 1, pose, H, g)
    for k, h in enumerate((1e-7, 1e-7, 1e-8)):
        step = np.eye(3)[k] * h
        ahead, behind = (cost(level.layers.value, level.frame, points, pose + s) for s in (step, -step))
        assert -0.5 * (ahead - behind) / (2 * h) == pytest.approx(g[k], rel=1e-4, abs=1e-4)
    assert np.linalg.eigvalsh(H).min() >= -1e-9


@pytest.mark.parametrize(
    "offset", [(0.1, 0.0, 0.0), (-0.08, 0.12, 0.03), (0.0, 0.0, -0.06), (0.15, -0.1, 0.05)]
)
def test_known_offsets_are_found(offset: tuple[float, float, float]) -> None:
    true = Pose2(0.5, -0.3, 0.4)
    builder, points = room_map(true)
    start = true.as_array() + offset
    match = ScanMatcher((10, 6, 6)).match(
        builder.pyramid, points, None, PoseEstimate(Pose2(*start), LOOSE), levels=3
    )
    np.testing.assert_allclose(match.pose, true.as_array(), atol=0.02)
    assert match.score > 0.5


def test_in_a_corridor_the_odometry_holds_the_direction_along_it() -> None:
    corridor = np.array(((-50.0, -1.0, 50.0, -1.0), (-50.0, 1.0, 50.0, 1.0)))
    angles = np.linspace(-math.pi, math.pi, 361)
    r = ranges_to(corridor, Pose2(), angles, 8.0)
    angles, r = angles[np.isfinite(r)], r[np.isfinite(r)]
    points = np.stack((r * np.cos(angles), r * np.sin(angles), 0 * r), axis=-1)
    builder = MapBuilder(BuilderConfig())
    level = ScanLeveler().level(room_scan(Pose2(), 0.0, np.random.default_rng(0)), None)
    for shift in np.linspace(-3, 3, 13):
        moved = type(level)(
            level.origin, points + np.array((shift, 0, 0)), level.free, (0.0, 0.0), False, 0.0
        )
        builder.enter(moved, Pose2())
    prior = PoseEstimate(Pose2(0.2, 0.05, 0.02), np.diag((0.05**2, 0.05**2, 0.02**2)))
    match = ScanMatcher().match(builder.pyramid, points, None, prior, levels=3)
    # Cells are ragged, so even a straight wall seems to say something: less than across it, though.
    assert match.pose[0] == pytest.approx(0.2, abs=0.1)
    np.testing.assert_allclose(match.pose[1:], 0, atol=0.025)
    assert match.information[0, 0] < 0.5 * match.information[1, 1]


def test_open_ground_follows_the_odometry() -> None:
    builder, _ = room_map(Pose2())
    nothing = np.zeros((0, 3))
    prior = np.array((0.2, 0.05, 0.02))
    match = ScanMatcher().match(
        builder.pyramid, nothing, np.zeros(0), PoseEstimate(Pose2(*prior), np.eye(3)), levels=3
    )
    np.testing.assert_array_equal(match.pose, prior)
    assert not match.information.any()


def test_a_share_of_information_is_as_good_as_small_weights() -> None:
    """And the covariance is that of prior and scan; an inexact match differs by one last step."""
    true = Pose2(0.5, -0.3, 0.4)
    builder, points = room_map(true)
    share, covariance = 0.3, np.diag((0.05**2, 0.05**2, 0.02**2))
    prior = PoseEstimate(Pose2(0.55, -0.34, 0.42), covariance)
    exact = ScanMatcher((10, 6, 6), exact=True)
    whole = exact.match(builder.pyramid, points, np.full(len(points), share), prior)
    same = exact.match(builder.pyramid, points, None, prior, information_share=share)
    for name in ("pose", "information", "score", "known"):
        np.testing.assert_allclose(getattr(same, name), getattr(whole, name), rtol=1e-9)
    match = ScanMatcher((10, 6, 6)).match(builder.pyramid, points, None, prior, information_share=share)
    np.testing.assert_allclose(match.pose, whole.pose, atol=1e-9)
    np.testing.assert_allclose(match.information, whole.information, rtol=0.1, atol=30)
    np.testing.assert_allclose(
        match.covariance, np.linalg.inv(np.linalg.inv(covariance) + match.information), rtol=1e-6
    )
    assert match.score == pytest.approx(whole.score, abs=0.01)
    assert match.known == whole.known


def test_nothing_known_says_nothing() -> None:
    builder, points = room_map(Pose2())
    far = np.array((500.0, 500.0, 0.0))
    match = ScanMatcher().match(builder.pyramid, points, None, PoseEstimate(Pose2(*far), np.eye(3)), levels=3)
    assert (match.score, match.known) == (0.0, 0.0)
    np.testing.assert_allclose(match.pose, far)


def test_hits_without_weight_count_like_hits_left_out() -> None:
    """With a stride as well: every so many beams are counted before any is left out."""
    builder, points = room_map(Pose2())
    level, rng = builder.pyramid.maps[0], np.random.default_rng(1)
    weights = rng.uniform(0.1, 1.0, len(points)) * (rng.random(len(points)) < 0.6)
    for stride in (1, 2, 4):
        counted = np.zeros(len(points), bool)
        counted[::stride] = True
        counted &= weights > 0
        results = []
        for p, w, every in ((points, weights, stride), (points[counted], weights[counted], 1)):
            H, g = np.empty((3, 3)), np.empty(3)
            told = linearize(
                level.layers.value, level.frame, p, w, every, np.array((0.03, -0.02, 0.01)), H, g
            )
            results.append(np.array((*told, *H.ravel(), *g)))
        np.testing.assert_array_equal(*results)


TRUE = Pose2(0.5, -0.3, 0.4)
CONFIGS = [RegistrationConfig(), CartographerConfig()]


def at(pose: Pose2) -> PoseEstimate:
    return PoseEstimate(pose, np.zeros((3, 3)))


def near(dx: float, dy: float, dyaw: float, sigma: float = 0.05) -> PoseEstimate:
    pose = Pose2(TRUE.x + dx, TRUE.y + dy, TRUE.yaw + dyaw)
    return PoseEstimate(pose, np.diag((sigma**2, sigma**2, sigma**2)))


@pytest.mark.parametrize("config", CONFIGS)
def test_a_small_error_needs_no_search(config: RegistrationConfig) -> None:
    builder, points = room_map(TRUE)
    registration, expected = Registration(config, ScanMatcher()), near(0.04, -0.03, 0.02)
    estimate, match = registration.register(builder.pyramid, points, None, expected, expected)
    assert match is not None
    assert estimate.pose.distance(TRUE) < 0.02
    assert np.trace(estimate.covariance) < np.trace(expected.covariance)
    assert registration.searches == 0


def test_a_sharp_turn_is_searched_for() -> None:
    builder, points = room_map(TRUE)
    registration, expected = Registration(RegistrationConfig(), ScanMatcher()), near(0.4, -0.3, 0.42)
    estimate, _ = registration.register(builder.pyramid, points, None, expected, at(Pose2()))
    assert registration.searches == 1
    assert estimate.pose.distance(TRUE) < 0.03


@pytest.mark.parametrize("config", CONFIGS)
def test_fewest_beams_are_enough_however_small_their_share(config: RegistrationConfig) -> None:
    """Rounding errors of the beams' weights once refused exactly as many as are needed."""
    builder, points = room_map(TRUE)
    some = points[:: len(points) // config.min_beams]
    far = np.tile((300.0, 0.0, 0.0), (7, 1))
    for share in (0.0, 0.02, 0.05):
        before, expected = at(TRUE @ Pose2(share)), near(0, 0, 0)
        for beams in (config.min_beams - 1, config.min_beams):
            hits = np.concatenate((some[:beams], far))
            _, match = Registration(config, ScanMatcher()).register(
                builder.pyramid, hits, None, expected, before
            )
            assert (match is not None) == (beams == config.min_beams)


def test_on_uneven_ground_a_poor_match_is_rejected() -> None:
    builder, points = room_map(TRUE)
    noise = np.column_stack((np.random.default_rng(0).uniform(-2, 2, (len(points), 2)), points[:, 2]))
    expected = near(0, 0, 0)
    estimate, match = Registration(CONFIGS[0], ScanMatcher()).register(
        builder.pyramid, noise, np.ones(len(points)), expected, at(Pose2())
    )
    assert match is not None
    assert match.score < CONFIGS[0].search_threshold
    assert estimate is expected


def test_the_wider_search_survives_a_sharp_turn() -> None:
    true = Pose2(0.5, -0.3, 0.4)
    builder, points = room_map(true)
    start = true.as_array() + np.array((0.4, -0.3, 0.42))
    found = correlative_search(builder.pyramid.maps[2].grid, points, np.ones(len(points)), start, 0.7, 0.5)
    np.testing.assert_allclose(found[:2], true.as_array()[:2], atol=0.2)
    assert found[2] == pytest.approx(0.4, abs=0.04)


def test_small_matrices_equal_numpy() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        B = rng.standard_normal((3, 3))
        A, b = B @ B.T + 0.1 * np.eye(3), rng.standard_normal(3)
        np.testing.assert_allclose(invert3(A), np.linalg.inv(A), rtol=1e-9)
        np.testing.assert_allclose(solve3(A, b), np.linalg.solve(A, b), rtol=1e-9)
        dx, dy, shift, turn = rng.random(4).tolist()
        G = np.array(((1, 0, -dy), (0, 1, dx), (0, 0, 1)))
        np.testing.assert_allclose(
            moved_covariance(A, dx, dy, shift, turn), G @ A @ G.T + np.diag((shift, shift, turn)), rtol=1e-9
        )
    assert not invert3(np.zeros((3, 3))).any()


MOTION = MotionConfig()
FIRM, NONE = 1e6, 1e-6
"""Information of a direction that a scan constrains to a millimeter, and of one that it does not."""


def track(*pulls: tuple[float, float], yaw: float = 0.0, sees: tuple[float, float] = (FIRM, FIRM)) -> Pose2:
    """Pose of a robot that drives .1 m a scan ahead; matches pull by (dx, dy) from dead reckoning."""
    window, estimate = ReckoningWindow(MonitorConfig()), PoseEstimate(Pose2(yaw=yaw), np.zeros((3, 3)))
    for dx, dy in pulls:
        expected = MOTION.step(Pose2(0.1), 0.1, turned=0.0).after(estimate)
        window.move(estimate, expected)
        matched = expected.pose.as_array() + np.array((dx, dy, 0.0))
        start, information = expected.pose.as_array(), np.diag((*sees, FIRM))
        P = window.allowed(expected, matched, information)
        covariance = np.linalg.inv(np.linalg.inv(expected.covariance) + P.T @ information @ P)
        estimate = PoseEstimate(Pose2(*(start + P @ (matched - start)).tolist()), covariance)
    return estimate.pose


@given(st.floats(-3.0, 3.0), st.floats(-3e-3, 3e-3), st.floats(-3e-3, 3e-3))
def test_corrections_as_small_as_the_errors_of_dead_reckoning_enter(yaw: float, dx: float, dy: float) -> None:
    pose = track(*[(dx, dy)] * 50, yaw=yaw)
    expected = 5.0 * math.cos(yaw) + 50 * dx, 5.0 * math.sin(yaw) + 50 * dy
    np.testing.assert_allclose((pose.x, pose.y), expected, atol=1e-6)


def test_a_match_that_jumps_as_to_a_hillside_moves_the_robot_in_the_other_direction_alone() -> None:
    pose = track(*[(0.0, 0.0)] * 20, (0.6, 0.02))
    np.testing.assert_allclose((pose.x, pose.y), (2.1, 0.02), atol=1e-3)


def test_a_match_that_pulls_steadily_is_held_within_the_errors_of_dead_reckoning() -> None:
    """A climb makes each hillside recede a little; no single match looks wrong."""
    pull = 0.02
    pose = track(*[(0.0, pull)] * 300)
    deviation = MOTION.translation_per_meter * math.sqrt(30.0)
    assert abs(pose.y) < 5 * deviation < 300 * pull / 5
    assert abs(pose.x - 30.0) < 0.05


def test_a_direction_that_a_scan_does_not_constrain_follows_dead_reckoning() -> None:
    pose = track(*[(0.01, 0.01)] * 5, sees=(NONE, FIRM))
    np.testing.assert_allclose((pose.x, pose.y), (0.5, 0.05), atol=1e-6)


def agreements(errors: Array, yaw: float, *, seen: int = 1) -> list[bool]:
    """Which matches agree while wheels measure 3 cm a scan, `errors` (n, 2) away from the true step.

    Only every so many scans are matched.
    """
    monitor, estimate = MatchMonitor(RegistrationConfig()), PoseEstimate(Pose2(yaw=yaw), np.zeros((3, 3)))
    told, off = [], np.zeros(3)
    for k, error in enumerate(errors):
        expected = MOTION.step(Pose2(0.03), 0.04, turned=0.0).after(estimate)
        monitor.move(estimate, expected)
        off[:2] += error
        estimate = expected
        if k % seen == seen - 1:
            matched = expected.pose.as_array() + off
            told.append(monitor.agrees(expected, matched))
            estimate, off = PoseEstimate(Pose2(*matched.tolist()), expected.covariance), np.zeros(3)
    return told


@given(st.floats(-3.0, 3.0), st.floats(-0.12, 0.12), st.sampled_from((1, 13, 200)))
def test_matches_that_correct_a_steady_error_of_the_wheels_agree(yaw: float, share: float, seen: int) -> None:
    """Also over 40 cm, as between keyframes, and after 6 m without any wall in view."""
    error = 0.03 * share * np.array((math.cos(yaw), math.sin(yaw)))
    assert all(agreements(np.tile(error, (600, 1)), yaw, seen=seen))


def test_matches_agree_again_soon_after_wheels_begin_to_spin() -> None:
    errors = np.zeros((100, 2))
    errors[50:, 0] = -0.03
    told = agreements(errors, 0.0)
    assert all(told[:50])
    assert not told[50]
    assert all(told[66:])


@given(st.integers(0, 1000))
def test_matches_that_scatter_as_on_hillsides_do_not_agree(seed: int) -> None:
    places = np.random.default_rng(seed).normal(0.0, 0.03, (201, 2))
    assert sum(agreements(np.diff(places, axis=0), 0.0)) < 20
