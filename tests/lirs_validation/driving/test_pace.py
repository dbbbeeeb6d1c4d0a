"""The driver asks of each robot what it can do."""

import pytest

from lirs_envs.robots.robot import ROBOTS
from lirs_validation.driving.path_driver import DriverConfig, driver_config


def test_a_husky_is_driven_as_ever() -> None:
    ours, usual = driver_config(ROBOTS["husky"]), DriverConfig()
    assert ours.pursuit.speed == pytest.approx(usual.pursuit.speed)
    assert ours.pursuit.turn_rate == pytest.approx(usual.pursuit.turn_rate)
    assert ours.pursuit.acceleration == pytest.approx(usual.pursuit.acceleration)
    assert (ours.patience, ours.back_off, ours.back_speed) == pytest.approx((8.0, 2.5, 0.3))


@pytest.mark.parametrize("name", list(ROBOTS))
def test_nobody_is_asked_for_more_than_he_has(name: str) -> None:
    robot, config = ROBOTS[name], driver_config(ROBOTS[name])
    assert config.pursuit.speed < robot.max_speed
    assert config.pursuit.turn_rate < robot.max_turn_rate
    assert config.pursuit.acceleration < robot.max_acceleration
    assert config.back_speed < robot.max_speed
    # It backs off equally far, and gives a robot the time that progress takes at its lowest speed.
    assert config.back_off * config.back_speed == pytest.approx(0.75)
    assert config.patience * 0.15 * config.pursuit.speed > config.step
