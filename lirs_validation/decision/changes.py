"""Changes of a run that may change its verdict: attitude, lidar, odometry."""

from __future__ import annotations

from dataclasses import dataclass, replace

from lirs_envs.lidar.presets import LIDARS, LidarPreset, make_lidar_preset
from lirs_envs.robots.catalog import make_robot
from lirs_validation.analysis.as_published import SUFFIX
from lirs_validation.config import RunConfig
from slam_baselines.mapper import MAPPERS

LESS, MORE = 0.5, 2.0
"""Factors of the odometry's noise."""


@dataclass(frozen=True)
class Change:
    """A changed run.

    Attributes:
        label: the change in words.
        config: with the change.
    """

    label: str
    config: RunConfig


def changes(config: RunConfig, *, works: bool) -> tuple[Change, ...]:
    """Return changes that may make a method work; of one that works, those that may make it fail."""
    found = [_attitude_change(config), _lidar_change(config, works=works)]
    factor = MORE if works else LESS
    odometry = replace(config, odometry_noise=config.odometry_noise * factor)
    found.append(Change("twice the odometry noise" if works else "half the odometry noise", odometry))
    return tuple(change for change in found if change is not None)


def _attitude_change(config: RunConfig) -> Change | None:
    """Return the run with the IMU's attitude, or without it.

    Methods as published do not use it: their terrain-aware version does. Mappers of clouds do not need it.
    """
    aware = config.mapper.removesuffix(SUFFIX)
    if aware != config.mapper and aware in MAPPERS:
        return Change(f"terrain-aware {aware}", replace(config, mapper=aware, attitude="imu"))
    if config.mapper not in MAPPERS:
        return None
    if config.attitude == "imu":
        return Change("without IMU attitude", replace(config, attitude="none"))
    return Change("with IMU attitude", replace(config, attitude="imu"))


def _lidar_change(config: RunConfig, *, works: bool) -> Change | None:
    """Return the run with the lidar of the next longer range; for a method that works, the next shorter."""
    own = make_lidar_preset(config.lidar or make_robot(config.robot).lidar)
    others = [preset for preset in map(make_lidar_preset, LIDARS) if preset.rings == own.rings]
    if works:
        shorter = [preset for preset in others if preset.range_max < own.range_max]
        chosen = max(shorter, key=_range, default=None)
    else:
        longer = [preset for preset in others if preset.range_max > own.range_max]
        chosen = min(longer, key=_range, default=None)
    if chosen is None:
        return None
    return Change(f"lidar {chosen.name} ({chosen.range_max:g} m)", replace(config, lidar=chosen.name))


def _range(preset: LidarPreset) -> float:
    return preset.range_max
