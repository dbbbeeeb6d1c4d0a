"""How fast a robot is driven: as a careful person would, within what it can do."""

from __future__ import annotations

from lirs_envs.robots.robot import Robot
from lirs_validation.driving.path_driver import DriverConfig
from lirs_validation.driving.pursuit import PursuitConfig

SPEED_SHARE, TURN_SHARE, ACCELERATION_SHARE = 0.8, 0.6, 0.2
"""Of the robot's largest; the rest is left to its own control."""


def driver_config(robot: Robot) -> DriverConfig:
    """Return the driver's usual speeds, less where the robot is slower, and patience to match."""
    usual, driver = PursuitConfig(), DriverConfig()
    pursuit = PursuitConfig(
        speed=min(usual.speed, SPEED_SHARE * robot.max_speed),
        turn_rate=min(usual.turn_rate, TURN_SHARE * robot.max_turn_rate),
        acceleration=min(usual.acceleration, ACCELERATION_SHARE * robot.max_acceleration),
    )
    slower = usual.speed / pursuit.speed
    return DriverConfig(
        pursuit=pursuit,
        patience=driver.patience * slower,
        back_off=driver.back_off * slower,
        back_speed=driver.back_speed / slower,
    )
