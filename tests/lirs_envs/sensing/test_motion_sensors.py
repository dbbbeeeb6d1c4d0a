"""Gyro and wheels read in one kernel are those read one after the other."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest

from lirs_envs.robot_model import RobotModel
from lirs_envs.robots.catalog import make_robot
from lirs_envs.sensing.imu import ImuConfig, ImuSensor
from lirs_envs.sensing.motion_sensors import MotionSensors, WheelAndGyroSensors, motion_sensors
from lirs_envs.sensing.odometry import BLOCK, OdometryConfig, WheelOdometry
from lirs_wct.geometry.pose import Pose2
from lirs_wct.world import World

UPDATES = 2 * BLOCK + 20
"""More than the random numbers that are drawn at once."""


def readings_of(sensors: MotionSensors, body: RobotModel) -> list[Any]:
    """Move the body by chance; return what the sensors read after each update."""
    rng, read = np.random.default_rng(5), []
    for _ in range(UPDATES):
        body.qpos[7:] += rng.normal(0.05, 0.1, len(body.qpos) - 7)
        body.qvel[3:6] = rng.normal(0, 0.5, 3)
        roll, pitch = rng.normal(0, 0.1, 2).tolist()
        sensors.update((roll, pitch), 0.008)
        read.append((sensors.rates, sensors.yaw_rate, sensors.read()))
    return read


@pytest.mark.parametrize("name", ["husky", "turtlebot2"])
def test_one_kernel_reads_what_sensor_after_sensor_reads(name: str, plane: World) -> None:
    robot, read = make_robot(name), []
    for make in (MotionSensors, motion_sensors):
        body = RobotModel(plane, robot, 0.04)
        gyro = ImuSensor(ImuConfig(), np.random.default_rng(1))
        sensors = make(body, gyro, WheelOdometry(robot, OdometryConfig(), np.random.default_rng(2)))
        read.append(readings_of(sensors, body))
        assert sensors.odometry.read() == sensors.read() != Pose2()
    assert isinstance(sensors, WheelAndGyroSensors)
    assert read[0] == read[1]


def test_a_copy_draws_its_own_errors(plane: World) -> None:
    robot = make_robot("husky")
    body = RobotModel(plane, robot, 0.04)
    gyro = ImuSensor(ImuConfig(), np.random.default_rng(1))
    sensors = motion_sensors(body, gyro, WheelOdometry(robot, OdometryConfig(), np.random.default_rng(2)))
    twin = copy.deepcopy(sensors)
    # Beyond a block, so that both have drawn anew.
    assert readings_of(twin, twin._body) == readings_of(sensors, body)
