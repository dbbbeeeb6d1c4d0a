"""Elevation maps of points on surfaces that are known."""

from pathlib import Path

import numpy as np
import pytest

from lirs_validation.metrics.elevation import (
    MAX_CLOUDS,
    CloudSample,
    ElevationMap,
    elevation_map,
    elevation_scores,
    evaluate_elevation,
    read_elevation,
    write_elevation,
)
from lirs_wct.errors import SourceError
from lirs_wct.geometry import HeightField, WallGrid
from lirs_wct.geometry.pose import Pose2, Pose3, Trajectory
from lirs_wct.geometry.scan import PointCloud
from lirs_wct.ground import Terrain
from lirs_wct.world import World

BOUNDS = (-5.0, -4.0, 5.0, 4.0)


def hill() -> HeightField:
    x, y = np.meshgrid(np.linspace(-6, 6, 241), np.linspace(6, -6, 241))
    return HeightField.centered((0.1 * x + np.sin(x) * np.cos(y / 2)).astype(np.float32), (0.05, 0.05))


def on(surface: HeightField, n: int = 60_000, seed: int = 0) -> np.ndarray:
    xy = np.random.default_rng(seed).uniform((-5, -4), (5, 4), (n, 2))
    return np.column_stack((xy, surface.height_at(xy[:, 0], xy[:, 1])))


def test_a_cell_holds_the_mean_of_its_points() -> None:
    points = np.array([(0.01, 0.02, 1.0), (0.09, 0.09, 3.0), (0.11, 0.0, 7.0), (50.0, 0.0, 9.0)])
    grid = elevation_map([points[:2], points[2:]], (0.0, 0.0, 1.0, 0.5))
    assert grid.mean.shape == (5, 10)
    assert grid.mean[0, 0] == 2.0
    assert grid.mean[0, 1] == 7.0
    assert grid.seen.sum() == 2, "points beyond the map are left out"
    assert grid.centers[1].tolist() == pytest.approx([0.15, 0.05])


@pytest.mark.parametrize(("x", "y"), [(-0.05, 0.2), (1.05, 0.2), (0.5, -0.05), (0.5, 0.55)])
def test_points_in_the_cell_beyond_a_border_are_left_out(x: float, y: float) -> None:
    grid = elevation_map([np.array([(x, y, 1.0), (0.5, 0.2, 2.0)])], (0.0, 0.0, 1.0, 0.5))
    assert np.nansum(grid.mean) == 2.0


def test_what_is_not_seen_is_no_error_but_is_missed() -> None:
    surface = hill()
    points = on(surface)
    west = points[points[:, 0] < 0]
    reference, built = (elevation_map([p], BOUNDS) for p in (points, west))
    scores = elevation_scores(built, reference, built, surface=surface)
    assert scores.elevation_seen == pytest.approx(0.5, abs=0.01)
    assert scores.elevation_rmse < 0.03
    assert scores.elevation_rmse_aligned == scores.elevation_rmse
    nothing = elevation_scores(elevation_map([], BOUNDS), reference, None, surface=surface)
    assert (nothing.elevation_rmse, nothing.elevation_seen) == (None, 0.0)
    blind = elevation_scores(built, elevation_map([], BOUNDS), None, surface=surface)
    assert (blind.elevation_seen, blind.reference_elevation_rmse) == (None, None)


def test_walls_and_steep_faces_are_not_judged() -> None:
    flat = HeightField.centered(np.zeros((2, 2), np.float32), (20.0, 20.0))
    solid = np.zeros((40, 40), np.bool_)
    solid[20] = True
    walls = WallGrid(solid, 0.1, Pose2(-2.0, -2.0, 0.0), 2.0)
    y = np.linspace(-1, 1, 81)
    points = np.column_stack((np.zeros_like(y), y, np.where(np.abs(y - 0.05) < 0.15, 1.0, 0.0)))
    grid = elevation_map([points], BOUNDS)
    assert elevation_scores(grid, grid, None, surface=flat, walls=walls).elevation_rmse == 0.0
    assert elevation_scores(grid, grid, None, surface=flat).elevation_rmse > 0.3  # type: ignore[operator]
    z = np.zeros((41, 41), np.float32)
    z[:, 20:] = 3.0
    cliff = HeightField.centered(z, (0.25, 0.25))
    x = np.linspace(-2, 2, 161)
    face = np.column_stack(
        (x, np.zeros_like(x), np.where(np.abs(x + 0.125) < 0.2, 1.5, np.where(x < 0, 0, 3)))
    )
    grid = elevation_map([face], BOUNDS)
    assert elevation_scores(grid, grid, None, surface=cliff).elevation_rmse == pytest.approx(0, abs=1e-6)


def test_the_file_gives_the_maps_back(tmp_path: Path) -> None:
    first = elevation_map([on(hill(), 2000)], BOUNDS)
    second = ElevationMap(first.mean + 1, first.cell, first.origin)
    write_elevation(tmp_path / "elevation.npz", first, second)
    built, true_pose = read_elevation(tmp_path / "elevation.npz")
    np.testing.assert_allclose(built.mean, first.mean, rtol=1e-6)
    np.testing.assert_allclose(true_pose.mean, second.mean, rtol=1e-6)
    assert (built.cell, built.origin) == (first.cell, first.origin)


@pytest.mark.parametrize("content", [None, b"", b"PK\x03\x04 and no more", b"text"])
def test_a_damaged_file_is_named(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "elevation.npz"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(SourceError, match=r"elevation\.npz: no elevation maps, or damaged"):
        read_elevation(path)


def cloud(stamp: float, points: np.ndarray) -> PointCloud:
    ring, time = np.zeros(len(points), np.uint16), np.zeros(len(points), np.float32)
    return PointCloud(points.astype(np.float32), ring, time, stamp, Pose3())


def track(planar: list[tuple[float, float]]) -> Trajectory:
    """A trajectory of level poses at x, y, one a second."""
    poses = [Pose3(x, y) for x, y in planar]
    return Trajectory(
        np.arange(len(poses), dtype=float),
        np.array([pose.position for pose in poses]),
        np.array([pose.quaternion for pose in poses]),
    )


def driven(bend: float, points: np.ndarray) -> tuple[Trajectory, CloudSample]:
    """Four poses of which `bend` meters is the largest offset from a line; the same cloud at each."""
    sample = CloudSample()
    for k in range(4):
        sample.offer(k, cloud(float(k), points))
    return track([(0.0, 0.0), (1.0, bend), (2.0, 0.0), (3.0, 0.0)]), sample


def test_a_run_is_scored_within_the_reach_of_its_clouds() -> None:
    flat = World("flat", Terrain(HeightField.centered(np.zeros((2, 2), np.float32), (20.0, 30.0))))
    truth, sample = driven(1.0, np.array([(2.0, 0.0, 0.0), (0.0, -1.5, 0.0)]))
    shifted = truth.moved(Pose3(0.0, 0.0, 0.25))
    made, scores = evaluate_elevation(flat, sample, truth, shifted)
    assert made.true_pose.origin == pytest.approx((-2.0, -2.0))
    assert made.true_pose.mean.shape == (50, 70), "2 m around the path, which is 3 m long and 1 m wide"
    assert made.true_pose.seen.sum() == 7, "the eighth point lies on the eastern border"
    assert scores.elevation_rmse == pytest.approx(0.25)
    assert scores.elevation_rmse_aligned == pytest.approx(0.0, abs=1e-9)
    assert (scores.reference_elevation_rmse, scores.elevation_seen) == (0.0, 1.0)
    far = np.array([(40.0, 0.0, 0.0), (0.0, 1.0, 0.0)])
    made, _ = evaluate_elevation(flat, driven(1.0, far)[1], truth, truth)
    assert (made.built.origin, made.built.mean.shape) == ((-10.0, -15.0), (300, 200)), "the world's border"
    assert evaluate_elevation(flat, CloudSample(), truth, truth)[1].elevation_rmse is None


@pytest.mark.parametrize(("bend", "count", "aligned"), [(1.0, 3, True), (0.2, 4, False), (1.0, 2, False)])
def test_a_narrow_or_short_path_is_not_aligned(bend: float, count: int, aligned: bool) -> None:
    flat = World("flat", Terrain(HeightField.centered(np.zeros((2, 2), np.float32), (20.0, 20.0))))
    truth, sample = driven(bend, np.array([(2.0, 0.0, 0.0), (0.0, -1.5, 0.0)]))
    part = Trajectory(truth.stamps[:count], truth.positions[:count], truth.quaternions[:count])
    _, scores = evaluate_elevation(flat, sample, truth, part)
    assert (scores.elevation_rmse_aligned is not None) == aligned


def test_a_sample_keeps_a_cloud_a_second_and_fewer_of_longer_drives() -> None:
    sample, point = CloudSample(), np.zeros((2, 3))
    for k in range(2 * MAX_CLOUDS):
        sample.offer(k, cloud(k / 2, point), walkers=np.array([True, False]))
    assert sample.scans == list(range(0, 2 * MAX_CLOUDS, 2))
    assert sample.period == 1.0
    assert [kept.stamp for kept in sample.clouds] == list(range(MAX_CLOUDS))
    assert {len(kept) for kept in sample.clouds} == {1}, "points on walkers are left out"
    sample.offer(2 * MAX_CLOUDS, cloud(float(MAX_CLOUDS), point))
    assert sample.period == 2.0
    assert [kept.stamp for kept in sample.clouds] == list(range(0, MAX_CLOUDS + 1, 2))
    assert sample.scans == list(range(0, 2 * MAX_CLOUDS + 1, 4))
    sample.offer(2 * MAX_CLOUDS + 2, cloud(MAX_CLOUDS + 1.0, point))
    assert len(sample.clouds) == MAX_CLOUDS // 2 + 1, "not due: one every two seconds now"
