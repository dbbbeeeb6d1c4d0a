"""The improved proposal in a room that is known: offsets are recovered, corridors keep the odometry."""

import numpy as np
import pytest

from lirs_wct.geometry.pose import Pose2
from slam_baselines.gmapping.config import GmappingConfig
from slam_baselines.gmapping.copy_on_write_map import PatchMaps
from slam_baselines.gmapping.motion import PoseDistributions
from slam_baselines.gmapping.particles import effective_number, normalize, systematic_resample
from slam_baselines.gmapping.proposal import Proposal, Proposer
from slam_baselines.gmapping.scan_matching import ScanBeams, log_likelihood, near_beams
from slam_baselines.leveling import ScanPoints


def ends(
    pose: Pose2, west: float, east: float, south: float, north: float, beams: int = 360, most: float = 12
) -> np.ndarray:
    """Return the ends of beams from `pose` at the walls of a rectangle, in the base frame, up to `most`."""
    angle = np.linspace(-np.pi, np.pi, beams, endpoint=False)
    c, s = np.cos(angle + pose.yaw), np.sin(angle + pose.yaw)
    with np.errstate(divide="ignore"):
        x = np.where(c >= 0, (east - pose.x) / c, (west - pose.x) / c)
        y = np.where(s >= 0, (north - pose.y) / s, (south - pose.y) / s)
    r = np.minimum(x, y)
    near = r < most
    r, angle = r[near], angle[near]
    return np.stack((r * np.cos(angle), r * np.sin(angle), np.zeros(len(r))), axis=-1)


def mapped(particles: int, *box: float, beams: int = 360, most: float = 12) -> PatchMaps:
    maps = PatchMaps(particles, 0.05)
    for x, y, yaw in ((0, 0, 0), (0.5, 0.3, 0.7), (-0.6, -0.2, 2.0), (0.1, -0.4, -1.1)):
        hits = ends(Pose2(x, y, yaw), *box, beams=beams, most=most)
        maps.draw_scan(
            np.tile((x, y, yaw), (particles, 1)), ScanPoints(np.zeros(3), hits, np.zeros((0, 3))),
            np.zeros(len(hits), np.uint8), 0,
        )  # fmt: skip
    return maps


def proposed(
    maps: PatchMaps,
    points: np.ndarray,
    expected: np.ndarray,
    seed: int = 0,
    first: int = 0,
    wide: bool = False,
) -> Proposal:
    odometry = PoseDistributions(expected, np.tile(np.diag((0.01, 0.01, 0.01)), (len(expected), 1, 1)))
    beams = ScanBeams(points, np.ones(len(points)))
    rng = np.random.default_rng(seed)
    return Proposer(GmappingConfig()).propose(maps, beams, 0, odometry, first, rng, wide=wide)


@pytest.mark.parametrize(
    "offset", [(0.12, -0.1, 0.08), (-0.15, 0.05, -0.1), (0.0, 0.0, 0.15), (0.02, 0.01, -0.01)]
)
def test_a_known_offset_is_recovered(offset: tuple[float, float, float]) -> None:
    room = (-3.0, 4.0, -2.5, 2.0)
    maps, truth = mapped(3, *room), np.array((0.2, 0.1, 0.3))
    points = ends(Pose2(*truth), *room)
    got = proposed(maps, points, np.tile(truth + offset, (3, 1)))
    np.testing.assert_allclose(got.means[:, :2], np.tile(truth[:2], (3, 1)), atol=0.01)
    np.testing.assert_allclose(got.means[:, 2], truth[2], atol=0.004)
    np.testing.assert_allclose(got.poses, got.means, atol=0.03)
    assert np.all(got.hit_ratio > 0.95)


def test_a_corridor_keeps_the_odometry_along_and_the_walls_across() -> None:
    corridor = (-500.0, 500.0, -1.0, 1.2)
    # So many beams that the walls are drawn without gaps: single cells would hold on to the scan.
    maps = mapped(1, *corridor, beams=3600, most=5)
    truth = Pose2(0.2, 0.1, 0.0)
    got = proposed(maps, ends(truth, *corridor, most=4), np.array([[0.28, 0.18, 0.05]]))
    x, y, yaw = got.means[0]
    assert x == pytest.approx(0.28, abs=0.04)
    assert (y, yaw) == (pytest.approx(0.1, abs=0.01), pytest.approx(0.0, abs=0.005))
    spread = np.sqrt(np.diag(got.covariances[0]))
    assert spread[0] > 3 * spread[1]


@pytest.mark.parametrize(("wide", "error"), [(False, 0.4), (True, 0.0)])
def test_side_walls_that_fit_do_not_hide_end_walls_that_do_not(wide: bool, error: float) -> None:
    """Wheels slipped by .4 m along a short corridor; most beams meet its sides, so the fit is not poor."""
    corridor, truth = (-3.0, 4.0, -1.0, 1.2), np.array((0.2, 0.1, 0.0))
    maps = mapped(3, *corridor, beams=1440)
    points = ends(Pose2(*truth), *corridor)
    got = proposed(maps, points, np.tile(truth, (3, 1)) + np.array((0.4, 0.0, 0.0)), first=1, wide=wide)
    np.testing.assert_allclose(got.means[:, 0] - truth[0], error, atol=0.05)
    np.testing.assert_allclose(got.means[:, 1:], np.tile(truth[1:], (3, 1)), atol=0.02)
    assert np.all(got.hit_ratio > 0.5)


def test_a_scan_that_fits_better_weighs_more() -> None:
    room = (-3.0, 4.0, -2.5, 2.0)
    maps = mapped(2, *room)
    points = ends(Pose2(), *room)
    fits = proposed(maps, points, np.zeros((2, 3)))
    off = proposed(maps, points + np.random.default_rng(1).normal(0, 0.1, points.shape), np.zeros((2, 3)))
    assert np.all(fits.log_eta > off.log_eta)


def test_without_walls_the_odometry_is_drawn_from() -> None:
    maps = PatchMaps(2000, 0.05)
    scan = ScanPoints(np.zeros(3), np.array([[1.0, 0, 0]]), np.zeros((0, 3)))
    maps.draw_scan(np.zeros((2000, 3)), scan, np.zeros(1, np.uint8), 0)
    got = proposed(maps, np.array([[5.0, 0.0, 0.0]]), np.tile((1.0, 2.0, 0.5), (2000, 1)))
    np.testing.assert_allclose(got.poses.mean(axis=0), (1.0, 2.0, 0.5), atol=0.01)
    np.testing.assert_allclose(got.poses.std(axis=0), 0.1, rtol=0.08)


def test_copies_of_a_particle_get_what_each_would_get() -> None:
    """Of copies, one is matched for all; apart by a hair, each is."""
    room = (-3.0, 4.0, -2.5, 2.0)
    maps, truth = mapped(4, *room), np.array((0.2, 0.1, 0.3))
    maps.descend(np.zeros(4, np.int64))
    points, expected = ends(Pose2(*truth), *room), np.tile(truth + np.array((0.1, -0.1, 0.05)), (4, 1))
    copies = proposed(maps, points, expected)
    apart = proposed(maps, points, expected + np.arange(4)[:, None] * 1e-13)
    for name in ("poses", "means", "covariances", "log_eta", "hit_ratio", "known_ratio"):
        np.testing.assert_allclose(getattr(copies, name), getattr(apart, name), atol=1e-6, err_msg=name)
    assert np.array_equal(copies.means[1], copies.means[3])
    assert not np.array_equal(copies.poses[1], copies.poses[3])


def test_walls_that_were_looked_up_before_are_those_of_the_place() -> None:
    """Also where poses lie cells apart, and where beams that do not count stand between."""
    room, rng = (-3.0, 4.0, -2.5, 2.0), np.random.default_rng(4)
    view = mapped(1, *room).view(0, 0)
    points = ends(Pose2(0.2, 0.1, 0.3), *room)
    counted = rng.random(len(points)) < 0.5
    beams = ScanBeams(points, counted.astype(np.float64))
    few = ScanBeams(points[counted].copy(), np.ones(int(counted.sum())))
    near = near_beams(beams, 1)
    for pose in np.array((0.2, 0.1, 0.3)) + rng.normal(0.0, (0.06, 0.06, 0.02), (60, 3)):
        found = log_likelihood(view, near.fine, pose, 0.005, 1.0)
        assert found == log_likelihood(view, near_beams(few, 1).fine, pose, 0.005, 1.0)
        assert found[1] > 0


def test_weights_survive_huge_differences_of_logarithms() -> None:
    weights = normalize(np.array([-5000.0, -5001.0, -9000.0]))
    np.testing.assert_allclose(weights, [1 / (1 + np.exp(-1)), 1 / (1 + np.e), 0], atol=1e-12)


def test_weights_that_sum_a_little_below_one_are_no_error() -> None:
    weights = np.full(10, 0.1 - 1e-12)

    class Late:
        def random(self) -> float:
            return 1 - 1e-16

    assert systematic_resample(weights, Late()).tolist() == [*range(1, 10), 9]  # type: ignore[arg-type]


def test_posterior_of_a_line_is_that_of_the_kalman_filter() -> None:
    """A robot on a line, Gaussian motion and measurement: the exact posterior is a Gaussian."""
    rng = np.random.default_rng(2)
    n, q, r = 20_000, 0.5, 0.8
    x, log_weights = rng.normal(0, 1, n), np.zeros(n)
    mean, variance = 0.0, 1.0
    for z in (1.0, 2.5, 2.0, 4.2):
        x = x + 1 + rng.normal(0, q, n)
        log_weights -= 0.5 * ((z - x) / r) ** 2
        mean, variance = mean + 1, variance + q**2
        gain = variance / (variance + r**2)
        mean, variance = mean + gain * (z - mean), (1 - gain) * variance
        weights = normalize(log_weights)
        if effective_number(weights) < n / 2:
            x, log_weights = x[systematic_resample(weights, rng)], np.zeros(n)
    weights = normalize(log_weights)
    assert weights @ x == pytest.approx(mean, abs=0.02)
    assert weights @ (x - weights @ x) ** 2 == pytest.approx(variance, rel=0.05)
