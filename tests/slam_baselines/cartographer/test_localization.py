"""Localization in a known map: a room, a real map with simulated scans, a bundled world."""

import itertools
import math
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from lirs_validation import validate
from lirs_wct.errors import ConfigError, SourceError
from lirs_wct.formats.map_server import read_map, write_map
from lirs_wct.geometry import OccupancyGrid
from lirs_wct.geometry.pose import Pose2, wrap_angle
from lirs_wct.geometry.scan import LaserScan
from slam_baselines.cartographer.localization import KnownMap
from slam_baselines.mapper import Mapper, make_mapper
from tests.slam_baselines.synthetic import ROOM, loop, room_scan

BEAMS = 361
SEEN = 12.0


def room_map(cell: float = 0.05) -> OccupancyGrid:
    """The synthetic room as a map of which 1 m outside the walls is unknown."""
    x, y = np.arange(-5, 6, cell) + cell / 2, np.arange(-4, 5, cell) + cell / 2
    p = np.full((len(y), len(x)), np.nan)
    p[np.ix_((y > -3) & (y < 4), (x > -4) & (x < 5))] = 0.0
    for ax, ay, bx, by in ROOM:
        for t in np.linspace(0, 1, 400):
            p[int((ay + t * (by - ay) + 4) / cell), int((ax + t * (bx - ax) + 5) / cell)] = 1.0
    return OccupancyGrid.from_probability(p, cell, Pose2(-5, -4))


def scan_in(grid: OccupancyGrid, pose: Pose2, stamp: float, rng: np.random.Generator) -> LaserScan:
    """Cast the beams of a laser on the base among the occupied cells in small steps."""
    angles = np.linspace(-0.75 * math.pi, 0.75 * math.pi, BEAMS)
    r = np.arange(0.1, SEEN, grid.resolution / 4)
    directions = np.stack((np.cos(angles), np.sin(angles)), axis=-1)
    cells = grid.cells(pose.apply(directions[:, None] * r[None, :, None]))
    inside = ((cells >= 0) & (cells < grid.shape)).all(axis=-1)
    clipped = np.clip(cells, 0, np.array(grid.shape) - 1)
    hit = inside & grid.occupied[clipped[..., 0], clipped[..., 1]]
    first = hit.argmax(axis=1)
    ranges = np.where(hit.any(axis=1), r[first] + rng.normal(0, 0.01, BEAMS), np.inf)
    step = 1.5 * math.pi / (BEAMS - 1)
    return LaserScan(ranges.astype(np.float32), -0.75 * math.pi, step, 0.05, SEEN, stamp)


def odometry_of(truth: list[Pose2]) -> list[Pose2]:
    """Odometry in a frame of its own, 3 % too far and 5 % too little turn."""
    track = [Pose2(3, 1, -2)]
    for before, now in itertools.pairwise(truth):
        step = before.inverse() @ now
        track.append(track[-1] @ Pose2(1.03 * step.x, 1.03 * step.y, 0.95 * step.yaw))
    return track


def off(mapper: Mapper, truth: list[Pose2]) -> NDArray[np.float64]:
    """Return (n,) distances of the final trajectory from the truth, in the map's own frame."""
    path = mapper.trajectory()
    assert len(path) == len(truth)
    return np.array([path.pose2(i).distance(p) for i, p in enumerate(truth)])


@pytest.mark.parametrize("given", [True, False])
def test_a_robot_in_a_room_it_knows(given: bool) -> None:
    grid, truth, rng = (
        room_map(),
        [Pose2(0.6, -0.4, 0.3) @ p for p in loop(80, 1.0)],
        np.random.default_rng(1),
    )
    before = grid.log_odds.copy()
    mapper = make_mapper("cartographer", map=grid, start=truth[0] if given else None)
    answers = [
        mapper.update(room_scan(pose, 0.2 * i, rng), odometry, None)
        for i, (pose, odometry) in enumerate(zip(truth, odometry_of(truth), strict=True))
    ]
    assert not mapper.lost
    assert (mapper.stats.counts["global_searches"] == 0) == given
    assert mapper.map() is grid
    np.testing.assert_array_equal(grid.log_odds, before)
    assert off(mapper, truth).max() < 0.06
    assert max(abs(wrap_angle(a.yaw - p.yaw)) for a, p in zip(answers[1:], truth[1:], strict=True)) < 0.02


def test_scans_before_the_place_is_found_are_led_back_from_it() -> None:
    grid, rng = room_map(), np.random.default_rng(2)
    truth = [Pose2(0.6, -0.4, 0.3) @ p for p in loop(80, 1.0)]
    blind = LaserScan(np.full(BEAMS, np.inf, np.float32), -2.0, 0.011, 0.05, 12.0, 0.0)
    mapper = make_mapper("cartographer", map=grid)
    for i, (pose, odometry) in enumerate(zip(truth, odometry_of(truth), strict=True)):
        scan = room_scan(pose, 0.2 * i, rng)
        if i < 20:
            scan = LaserScan(blind.ranges, -2.0, 0.011, 0.05, 12.0, 0.2 * i)
        mapper.update(scan, odometry, None)
        assert mapper.lost == (i < 20)
    assert mapper.stats.lost == 20
    # The wheels' 3 % and 5 % over a quarter of the loop are in the first poses, no more.
    assert off(mapper, truth)[:20].max() < 0.15
    assert off(mapper, truth)[20:].max() < 0.06


def test_a_room_that_looks_the_same_both_ways_is_ambiguous() -> None:
    p = np.zeros((120, 200))
    p[[0, -1]] = p[:, [0, -1]] = 1.0
    grid = OccupancyGrid.from_probability(p, 0.05)
    mapper, rng = make_mapper("cartographer", map=grid), np.random.default_rng(3)
    for i in range(30):
        pose = Pose2(3.0 + 0.1 * i, 2.0, 0.2)
        mapper.update(scan_in(grid, pose, 0.2 * i, rng), pose, None)
    assert mapper.lost
    assert mapper.stats.counts["global_searches_ambiguous"] == mapper.stats.counts["global_searches"] > 1


def test_a_robot_carried_away_is_lost_and_found_again() -> None:
    grid, rng = room_map(), np.random.default_rng(4)
    first, second = Pose2(-2.5, 2.5, 0.0), Pose2(3.5, -1.5, 2.0)
    mapper, was_lost = make_mapper("cartographer", map=grid, start=first), False
    for i in range(60):
        pose = (first if i < 20 else second) @ Pose2(0.01 * i)
        mapper.update(room_scan(pose, 0.5 * i, rng), Pose2(0.01 * i), None)
        was_lost |= mapper.lost
    assert was_lost
    assert not mapper.lost
    assert off(mapper, [second @ Pose2(0.59)] * 60)[-1] < 0.05


@pytest.mark.slow
@pytest.mark.shared
@pytest.mark.parametrize("name", ["navigation2/depot.yaml", "turtlebot_apps/willow-2010-02-18-0.10.yaml"])
def test_a_real_map(shared_data: Path, name: str) -> None:
    path = shared_data / "maps" / name
    grid, rng = read_map(path), np.random.default_rng(5)
    starts, found = start_poses_in(grid), 0
    for start in starts:
        mapper = make_mapper("cartographer", map=path)
        truth = [start @ Pose2(0.05 * i) for i in range(12)]
        for i, pose in enumerate(truth):
            answer = mapper.update(scan_in(grid, pose, 0.2 * i, rng), pose, None)
        if not mapper.lost:
            found += 1
            # Never a wrong place: what is accepted is right.
            assert answer.distance(truth[-1]) < 1.5 * grid.resolution
            assert abs(wrap_angle(answer.yaw - truth[-1].yaw)) < 0.03
    assert found >= len(starts) - 2


@pytest.mark.slow
def test_a_bundled_world_with_hills() -> None:
    run = validate("simple", seconds=15, seed=3)
    mapper = make_mapper("cartographer", map=run.maps.true_pose)
    for observation in run.log.observations:
        mapper.update(observation.scan, observation.odometry, observation.imu)
    assert not mapper.lost
    assert off(mapper, [pose.to_pose2() for pose in run.log.truth]).max() < 0.08


def start_poses_in(grid: OccupancyGrid) -> list[Pose2]:
    """Return ten places with a meter of free floor around, spread over the map."""
    room = cv2.distanceTransform(grid.free.astype(np.uint8), cv2.DIST_L2, 5) * grid.resolution
    cells = np.argwhere(room > 1.0)
    chosen = cells[np.random.default_rng(6).choice(len(cells), 10, replace=False)]
    yaws = np.linspace(-3, 3, 10)
    return [Pose2(x, y, w) for (x, y), w in zip(grid.centers(chosen).tolist(), yaws.tolist(), strict=True)]


def test_a_map_written_and_read_is_the_same_place(tmp_path: Path) -> None:
    grid = room_map()
    write_map(tmp_path / "room", grid)
    of_file, of_grid = KnownMap.load(tmp_path / "room.yaml"), KnownMap.load(grid)
    for a, b in zip(of_file.pyramid.levels.values, of_grid.pyramid.levels.values, strict=True):
        np.testing.assert_array_equal(a, b)


def test_what_cannot_be_used_is_named(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match=r"nowhere\.yaml"):
        make_mapper("cartographer", map=tmp_path / "nowhere.yaml")
    with pytest.raises(ConfigError, match="map is needed"):
        make_mapper("cartographer", start=Pose2())
    empty = OccupancyGrid.from_probability(np.zeros((20, 20)), 0.05)
    with pytest.raises(ConfigError, match="no cell is occupied"):
        make_mapper("cartographer", map=empty)
