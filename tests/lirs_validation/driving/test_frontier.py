"""The explorer: it maps what can be reached, keeps to the known, and follows the mapper, right or wrong."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lirs_envs.robots.robot import make_robot
from lirs_envs.simulation import Simulation
from lirs_envs.simulation_config import SimulationConfig
from lirs_validation.config import RunConfig
from lirs_validation.driving.choice import make_driver
from lirs_validation.driving.frontier_route import FrontierRoute, distance_in_sight, exploration_map
from lirs_validation.driving.path_driver import DriverConfig, PathDriver
from lirs_validation.experiment.drive import DriveLog
from lirs_validation.experiment.mapper_under_test import LocalMapper
from lirs_wct.geometry import OccupancyGrid
from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.scan import Imu, LaserScan
from lirs_wct.sources.build import build_world
from lirs_wct.world import World
from slam_baselines.hector import HectorMapper
from tests.lirs_validation.driving.ride import ride
from tests.lirs_validation.experiment.puppets import drive_log

NOWHERE = np.zeros((0, 3))
FOOTPRINT, CLEARANCE = 0.3, 0.4


def rooms() -> np.ndarray:
    """Two rooms of 6 x 6 m at 0.1 m with a door of 1.6 m between them: probabilities."""
    p = np.zeros((62, 122))
    p[[0, -1]] = p[:, [0, 60, -1]] = 1.0
    p[23:39, 60] = 0.0
    return p


class Seer:
    """A mapper that is told the truth about all that lies in sight within 4 m, in a frame of its own."""

    def __init__(self, T_map_world: Pose2) -> None:
        self.truth = OccupancyGrid.from_probability(rooms(), 0.1)
        self.p = np.full(self.truth.shape, np.nan)
        self.T_map_world = T_map_world

    def look(self, T_world_base: Pose2) -> Pose2:
        for bearing in np.arange(0, math.tau, math.radians(0.5)):
            beam = T_world_base @ Pose2(0, 0, float(bearing))
            cells = self.truth.cells(beam.apply(np.column_stack((np.arange(0, 4, 0.05), np.zeros(80)))))
            cells = np.clip(cells, 0, np.array(self.truth.shape) - 1)
            values = self.truth.probability[cells[:, 0], cells[:, 1]]
            hit = int(np.argmax(values > 0.5)) if (values > 0.5).any() else 79
            self.p[cells[: hit + 1, 0], cells[: hit + 1, 1]] = values[: hit + 1]
        return self.T_map_world @ T_world_base

    def map(self) -> OccupancyGrid:
        grid = OccupancyGrid.from_probability(self.p, 0.1)
        return grid.moved(self.T_map_world)


def explored(T_map_world: Pose2, seconds: float = 80.0) -> tuple[Seer, np.ndarray, PathDriver]:
    seer, start = Seer(T_map_world), Pose2(1.5, 1.5, 0.3)
    seer.look(start)
    config = DriverConfig()
    driver = PathDriver(FrontierRoute(seer.map, FOOTPRINT, CLEARANCE, config), start, config)
    poses, at = [], start
    for _ in range(round(seconds / 1.0)):
        part = ride(Shifted(driver, T_map_world, len(poses) * 1.0), at, 1.0, slip=0.0)
        at = Pose2(*part.poses[-1])
        poses.append(part.poses)
        seer.look(at)
    return seer, np.concatenate(poses), driver


class Shifted:
    """Hands a driver the pose in the map frame, and goes on with its clock."""

    def __init__(self, driver: PathDriver, T_map_world: Pose2, since: float) -> None:
        self.driver, self.T_map_world, self.since = driver, T_map_world, since

    def command(self, pose: Pose2, time: float):
        return self.driver.command(self.T_map_world @ pose, self.since + time)


@pytest.mark.slow
def test_it_maps_both_rooms_and_stays_clear_of_walls() -> None:
    seer, poses, driver = explored(Pose2())
    known = ~np.isnan(seer.p)
    assert known.mean() > 0.97
    assert poses[:, 0].max() > 8.0, "through the door"
    cells = np.argwhere(rooms() > 0.5) * 0.1 + 0.05
    gap = np.linalg.norm(poses[:, None, 1::-1][::5] - cells[None], axis=2).min()
    assert gap > FOOTPRINT
    assert not driver.stuck


def test_beside_a_frontier_behind_it_the_robot_does_not_creep() -> None:
    """A path of a cell ended as it began: the next was planned at the next scan, and the next."""
    p = np.full((60, 90), 0.1)
    p[[0, -1]] = p[:, -1] = 0.9
    p[:, :10] = np.nan
    config = DriverConfig()
    route = FrontierRoute(lambda: OccupancyGrid.from_probability(p, 0.1), FOOTPRINT, CLEARANCE, config)
    route.path(Pose2(4.0, 3.0), 0.0, None)
    for k, x in enumerate((1.3, 1.4, 1.5, 1.6), start=1):
        path = route.path(Pose2(x, 3.0), float(k), 0.0)
        assert np.linalg.norm(np.diff(path.points, axis=0), axis=1).sum() > config.step


def test_only_the_known_is_driven_and_unknown_ground_is_no_way() -> None:
    p = np.full((80, 80), np.nan)
    p[10:70, 10:50] = 0.1
    chart = exploration_map(
        OccupancyGrid.from_probability(p, 0.1), np.zeros((0, 2)), NOWHERE, footprint=0.5, clearance=0.6
    )
    free = chart.grid.centers(np.argwhere(chart.grid.free))
    assert free.min() >= 1.0 + 0.5 - 0.06
    assert free[:, 0].max() <= 5.0 - 0.5 + 0.06
    edge = chart.grid.centers(np.argwhere(chart.frontier))
    assert np.minimum(np.abs(edge - (1.05, 1.05)), np.abs(edge - (4.95, 6.95))).min(axis=1).max() < 0.06


def test_gaps_between_rays_are_no_frontier_and_narrow_slits_neither() -> None:
    p = np.full((80, 80), 0.1)
    p[40, 40:44] = np.nan  # a hole
    p[[0, -1]] = p[:, [0, -1]] = 0.9
    p[0, 30:33] = np.nan  # a slit of 0.3 m
    chart = exploration_map(
        OccupancyGrid.from_probability(p, 0.1), np.zeros((0, 2)), NOWHERE, footprint=0.5, clearance=0.6
    )
    assert not chart.frontier.any()
    p[0, 20:50] = np.nan  # a gate of 3 m
    chart = exploration_map(
        OccupancyGrid.from_probability(p, 0.1), np.zeros((0, 2)), NOWHERE, footprint=0.5, clearance=0.6
    )
    assert chart.frontier.any()


@pytest.mark.parametrize(("resolution", "expected"), [(0.025, 0.1), (0.05, 0.1), (0.1, 0.1), (0.25, 0.25)])
def test_maps_of_any_resolution_keep_their_walls(resolution: float, expected: float) -> None:
    n = round(6.0 / resolution)
    p = np.full((n, n), 0.1)
    p[:, n // 2] = 0.9
    grid = OccupancyGrid.from_probability(p, resolution, Pose2(-1.0, 2.0, 0.5))
    chart = exploration_map(grid, np.zeros((0, 2)), NOWHERE, footprint=0.2, clearance=0.3)
    assert chart.grid.resolution == pytest.approx(expected)
    here, there = (Pose2(-1.0, 2.0, 0.5).apply((x, 3.0)) for x in (1.5, 4.5))
    assert all(chart.passable[tuple(chart.grid.cells(point))] for point in (here, there))
    wall = Pose2(-1.0, 2.0, 0.5).apply((n // 2 * resolution + resolution / 2, 3.0))
    assert not chart.passable[tuple(chart.grid.cells(wall))]


def test_walls_and_what_lies_behind_are_out_of_sight() -> None:
    chart = exploration_map(
        OccupancyGrid.from_probability(rooms(), 0.1), np.zeros((0, 2)), NOWHERE, footprint=0.2, clearance=0.3
    )
    points = np.array([(4.0, 1.0), (8.0, 1.0), (8.0, 3.1), (0.5, 3.1)])
    eye = Pose2(1.5, 3.1, 0.0)
    found = distance_in_sight(chart, eye, chart.grid.cells(points))
    assert found[0] == pytest.approx(math.dist((1.5, 3.1), (4.0, 1.0)), abs=0.1)
    assert found[2] == pytest.approx(6.5, abs=0.1), "through the door"
    assert np.isinf(found[[1, 3]]).all(), "behind the wall, behind the robot"


class Liar(HectorMapper):
    """A mapper whose heading drifts away from the truth while its map stays as it should be."""

    def __init__(self, drift: float) -> None:
        super().__init__()
        self.drift, self.told = drift, 0

    def update(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        pose = super().update(scan, odometry, imu)
        self.told += 1
        return replace(pose, yaw=pose.yaw + self.drift)


@pytest.fixture(scope="module")
def simple() -> World:
    return build_world("simple")


def driven(world: World, own: Any, seconds: float, kind: str = "frontier") -> DriveLog:
    mapper = LocalMapper(own, "own")
    robot, config = make_robot("husky"), RunConfig(source="simple", driver=kind, seconds=seconds)
    simulation = Simulation(world, SimulationConfig(robot=robot), seed=1)
    return drive_log(simulation, make_driver(world, robot, config, mapper.map), mapper, seconds)


@pytest.mark.slow
def test_a_wrong_pose_leads_the_explorer_astray_and_not_the_tour(simple: World) -> None:
    """Where the mapper is wrong, so is the drive: the truth would have corrected it."""
    honest, lying = (driven(simple, Liar(drift), 8.0).truth for drift in (0.0, 0.6))
    assert math.dist(honest[-1].position[:2], lying[-1].position[:2]) > 1.0
    honest, lying = (driven(simple, Liar(drift), 2.0, "tour").truth for drift in (0.0, 0.6))
    assert all(np.array_equal(a.position, b.position) for a, b in zip(honest, lying, strict=True))
