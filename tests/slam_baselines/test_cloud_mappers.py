"""Other people's systems behind the protocol `CloudMapper`."""

import math
import re
from dataclasses import replace
from functools import cache
from importlib.util import find_spec
from types import SimpleNamespace

import numpy as np
import pytest

from lirs_envs.robots.robot import Twist, make_robot
from lirs_envs.sensing.sensors import Observation, SensorNoise
from lirs_envs.simulation import Simulation
from lirs_envs.simulation_config import SimulationConfig
from lirs_validation.metrics.trajectory import spatial_errors
from lirs_wct.arrays import FloatArray
from lirs_wct.errors import ConfigError
from lirs_wct.geometry.pose import Pose3, Trajectory
from lirs_wct.geometry.scan import PointCloud
from lirs_wct.sources.build import build_world
from slam_baselines import mapper as mappers
from slam_baselines.kiss_icp import CloudOdometry, pose_at_start
from slam_baselines.mapper import CLOUD_MAPPERS, CloudMapper, make_cloud_mapper, make_mapper, reads_clouds

INSTALLED = [name for name, method in CLOUD_MAPPERS.items() if method.installed and not method.needs]
SCANS = 80
BOUNDS = {"kiss-icp": 0.20, "genz-icp": 0.08, "small-gicp": 0.02}
"""Meters over a drive of 4.6 m, which standing still would miss by 1.4."""


@cache
def drive(scans: int, *, rolling: bool = False) -> tuple[list[Observation], Trajectory]:
    """Return what was read on an arc through `medium`, and the true poses in the first base frame."""
    config = SimulationConfig(
        robot=make_robot("husky"), lidar="vlp16", noise=SensorNoise(rolling_scan=rolling)
    )
    sim = Simulation(build_world("medium"), config, seed=1)
    read, poses = [sim.reset()], [sim.pose()]
    for _ in range(scans - 1):
        read.append(sim.advance(Twist(0.6, 0.15)))
        poses.append(sim.pose())
    T_map_world: Pose3 = poses[0].inverse()
    return read, Trajectory.from_poses([o.scan.stamp for o in read], poses).moved(T_map_world)


def driven(mapper: CloudMapper, *, rolling: bool = False) -> CloudMapper:
    for observation in drive(SCANS, rolling=rolling)[0]:
        assert observation.cloud is not None
        mapper.update(observation.cloud, observation.imu)
    return mapper


def cloud(xyz: FloatArray, stamp: float = 0.0, mount: Pose3 | None = None) -> PointCloud:
    n = len(xyz)
    return PointCloud(
        xyz.astype(np.float32), np.zeros(n, np.uint16), np.zeros(n, np.float32), stamp, mount or Pose3()
    )


@pytest.mark.parametrize("name", INSTALLED)
@pytest.mark.slow
def test_a_short_drive_is_followed_in_space(name: str) -> None:
    mapper = driven(make_cloud_mapper(name, seed=1))
    truth = drive(SCANS)[1]
    errors = spatial_errors(truth, mapper.trajectory())
    assert truth.length > 4.0
    assert errors.ate_rmse_3d_unaligned < BOUNDS[name]
    assert errors.rotation_rmse_3d < math.radians(3)
    assert reads_clouds(mapper)
    assert (mapper.stats.received, mapper.stats.used, mapper.lost) == (SCANS, SCANS, False)
    assert mapper.stats.ms_p50 > 0


def test_a_pose_of_the_sweeps_end_is_taken_back_to_its_stamp() -> None:
    pose, motion = np.eye(4), np.eye(4)
    pose[:3, 3], motion[0, 3] = (1.0, 2.0, 0.0), 0.25
    pose[:2, :2] = ((0, -1), (1, 0))
    odometry = SimpleNamespace(last_pose=pose, last_delta=motion)
    assert pose_at_start(odometry, np.array([0.0, 0.1]))[:3, 3].tolist() == [1.0, 1.75, 0.0]
    np.testing.assert_array_equal(pose_at_start(odometry, np.empty(0)), pose)


@pytest.mark.skipif(find_spec("kiss_icp") is None, reason="needs kiss-icp")
@pytest.mark.slow
def test_kiss_icp_uses_the_times_of_a_rolling_sweep() -> None:
    mapper = driven(make_cloud_mapper("kiss-icp"), rolling=True)
    truth = drive(SCANS, rolling=True)[1]
    assert spatial_errors(truth, mapper.trajectory()).ate_rmse_3d_unaligned < BOUNDS["kiss-icp"]


@pytest.mark.skipif(find_spec("kiss_icp") is None, reason="needs kiss-icp")
def test_points_of_one_time_do_not_end_the_process() -> None:
    """KISS-ICP divides by the span of the times, and aborts where it is 0."""
    mapper, points = make_cloud_mapper("kiss-icp"), np.random.default_rng(1).uniform(-5, 5, (500, 3))
    late = replace(cloud(points), time=np.full(500, 0.05, np.float32))
    assert mapper.update(late, None) == Pose3()


def test_the_pose_is_that_of_the_base() -> None:
    """The sensor's motion is seen from the sensor, the answer is of the base: both ends count."""
    mount = Pose3.from_rpy(0.3, -0.1, 0.5, 0.1, -0.2, 1.2)
    T_map_base = Pose3.from_rpy(1.0, 2.0, 0.5, 0.05, 0.1, -0.7)
    T_first_sensor = mount.inverse() @ T_map_base @ mount
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = T_first_sensor.rotation, T_first_sensor.position
    mapper = CloudOdometry(lambda points, times: matrix)
    found = mapper.update(cloud(np.ones((5, 3)), mount=mount), None)
    np.testing.assert_allclose(found.position, T_map_base.position, atol=1e-9)
    np.testing.assert_allclose(found.rotation, T_map_base.rotation, atol=1e-9)


def test_a_sweep_without_returns_leaves_the_pose() -> None:
    given: list[int] = []

    def register(points: FloatArray, times: FloatArray) -> FloatArray:
        given.append(len(points))
        matrix = np.eye(4)
        matrix[0, 3] = len(given)
        return matrix

    mapper = CloudOdometry(register)
    for k, points in enumerate((np.empty((0, 3)), np.ones((4, 3)), np.empty((0, 3)))):
        pose = mapper.update(cloud(points, stamp=float(k)), None)
    assert given == [4]
    assert pose.x == 1.0
    assert mapper.trajectory().positions[:, 0].tolist() == [0.0, 1.0, 1.0]
    assert (mapper.stats.received, mapper.stats.used, dict(mapper.stats.skipped)) == (3, 1, {"empty": 2})


@pytest.mark.parametrize("name", list(CLOUD_MAPPERS))
def test_what_is_not_installed_is_said_with_the_line_that_installs_it(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mappers, "find_spec", lambda package: None)
    method = CLOUD_MAPPERS[name]
    by_extra = f"pip install 'lirs-wct[{method.extra}]'"
    elsewhere = f"pip install --no-deps {method.distribution}"
    install = by_extra if method.extra else elsewhere
    message = f"mapper {name} needs the package {method.distribution}: {install}"
    with pytest.raises(ConfigError, match=f"^{re.escape(message)}$"):
        make_cloud_mapper(name)


def test_planar_and_cloud_mappers_are_not_taken_for_each_other() -> None:
    with pytest.raises(ConfigError, match="kiss-icp reads point clouds, planar mappers are hector"):
        make_mapper("kiss-icp")
    with pytest.raises(
        ConfigError, match=r"unknown mapper of point clouds 'hector'; legal: .*genz-icp, kiss-icp"
    ):
        make_cloud_mapper("hector")
    assert not reads_clouds(make_mapper("hector"))
