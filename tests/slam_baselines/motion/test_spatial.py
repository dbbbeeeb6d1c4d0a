"""Dead reckoning in space by planar odometry and attitude."""

import math

import numpy as np
import pytest

from lirs_wct.geometry import Imu, Pose2
from slam_baselines.dead_reckoning import climb, spatial_odometry


def test_a_circle_on_an_incline_returns_to_its_height() -> None:
    slope, radius = 0.2, 5.0
    yaws = np.linspace(0.0, math.tau, 401)
    normal = np.array((-math.sin(slope), 0.0, math.cos(slope)))  # rises along x
    odometry, imus = [], []
    for yaw in yaws:
        odometry.append(Pose2(radius * math.sin(yaw), radius * (1 - math.cos(yaw)), yaw))
        ahead = np.array((math.cos(yaw), math.sin(yaw), 0.0))
        ahead[2] = -(normal[:2] @ ahead[:2]) / normal[2]
        ahead /= np.linalg.norm(ahead)
        left = np.cross(normal, ahead)
        imus.append(Imu(roll=math.atan2(left[2], normal[2]), pitch=-math.asin(ahead[2])))
    poses = spatial_odometry(odometry, imus)
    rises = [pose.z - math.tan(slope) * pose.x for pose in poses]
    np.testing.assert_allclose(rises, 0.0, atol=1e-4)
    assert max(pose.z for pose in poses) == pytest.approx(radius * math.tan(slope), abs=1e-3)


def test_without_inertial_readings_the_ground_is_level() -> None:
    odometry = [Pose2(0.1 * k, 0.02 * k, 0.05 * k) for k in range(20)]
    poses = spatial_odometry(odometry, [None] * 20)
    found = np.array([pose.to_pose2().as_array() for pose in poses])
    np.testing.assert_allclose(found, [p.as_array() for p in odometry], atol=1e-12)
    assert {pose.z for pose in poses} == {0.0}


def test_a_step_stays_in_the_plane_of_the_wheels() -> None:
    up = np.array((0.1, -0.2, 0.9))
    step = np.array((0.3, 0.1, climb(0.3, 0.1, up)))
    assert step @ up == pytest.approx(0.0, abs=1e-12)
