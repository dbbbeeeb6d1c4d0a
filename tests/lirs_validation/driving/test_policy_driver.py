"""A policy as driver: goals one after the other, its factors, and the end of a drive without progress."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from lirs_envs.robots.robot import Twist, make_robot
from lirs_validation.driving.choice import PATIENCE, REACHED, PolicyDriver
from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.scan import LaserScan

ROBOT = make_robot("jackal")
ODOMETRY = Pose2(1.0, 2.0, 0.5)
SCAN = LaserScan(np.array((1.0, np.inf, -np.inf, np.nan), np.float32), 0.0, 0.1, 0.1, 9.0, 0.0)
GOALS = np.array(((3.0, 0.0), (3.0, 3.0)))


class Recording:
    """A policy that always gives the same action, and keeps its observations."""

    def __init__(self, action: tuple[float, float] = (0.5, -0.25)) -> None:
        self.action, self.resets, self.seen = np.array(action), 0, list[Mapping[str, Any]]()

    def reset(self, info: Mapping[str, Any]) -> None:
        self.resets += 1

    def act(self, observation: Mapping[str, Any]) -> Any:
        self.seen.append(observation)
        return self.action


def driver_of(policy: Recording, factors: tuple[float, float] = (1.0, 1.0)) -> PolicyDriver:
    return PolicyDriver(policy, ROBOT, Pose2(), GOALS, factors)


def test_a_policy_observes_as_in_the_environments() -> None:
    policy = Recording()
    driver_of(policy).command(Pose2(0.0, 3.0, 0.0), 0.0, SCAN, ODOMETRY)
    (seen,) = policy.seen
    assert seen["scan"].tolist() == [1.0, 9.0, 0.0, 0.0]
    assert seen["odometry"].tolist() == [1.0, 2.0, 0.5]
    assert seen["goal"] == pytest.approx((math.hypot(3, 3), -math.pi / 4))
    assert not math.isfinite(SCAN.ranges[1]), "the mapper gets the same scan"


@pytest.mark.parametrize(("factors", "shares"), [((1.0, 1.0), (0.5, -0.25)), ((0.5, 8.0), (0.25, -1.0))])
def test_factors_change_the_command_within_the_limits_of_the_robot(
    factors: tuple[float, float], shares: tuple[float, float]
) -> None:
    command = driver_of(Recording(), factors).command(Pose2(), 0.0, SCAN, ODOMETRY)
    assert command == Twist(shares[0] * ROBOT.max_speed, shares[1] * ROBOT.max_turn_rate)


def test_goals_follow_each_other_and_end_the_drive() -> None:
    policy = Recording()
    driver = driver_of(policy)
    driver.command(Pose2(3.0 - 0.9 * REACHED, 0.0, 0.0), 1.0, SCAN, ODOMETRY)
    assert (policy.resets, driver.finished) == (2, "")
    assert policy.seen[-1]["goal"][0] == pytest.approx(math.hypot(3.0, 0.9 * REACHED))
    assert driver.command(Pose2(3.0, 3.0, 0.0), 2.0, SCAN, ODOMETRY) == Twist()
    assert driver.finished
    assert not driver.stuck


def test_a_policy_without_progress_is_stuck() -> None:
    driver = driver_of(Recording())
    driver.command(Pose2(1.0, 0.0, 0.0), 5.0, SCAN, ODOMETRY)
    driver.command(Pose2(1.3, 0.0, 0.0), 5.0 + 0.9 * PATIENCE, SCAN, ODOMETRY)
    assert not driver.stuck
    assert driver.command(Pose2(1.3, 0.0, 0.0), 5.1 + PATIENCE, SCAN, ODOMETRY) == Twist()
    assert driver.stuck
