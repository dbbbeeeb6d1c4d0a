"""Features of a site along paths that its robot would drive: inputs of the forecast.

Noise-free scans are cast along tours of the coverage planner, with the robot standing as the ground lies.
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass, fields, replace
from typing import Any

import numpy as np

from lirs_envs.lidar.mesh_rays import MeshCaster
from lirs_envs.lidar.presets import LidarPreset, make_lidar_preset
from lirs_envs.lidar.ray_casting import Caster, RayCaster
from lirs_envs.robots.robot import Robot
from lirs_validation.config import RunConfig
from lirs_validation.driving.choice import plan_tour
from lirs_validation.metrics.near_obstacles import near_obstacle
from lirs_validation.metrics.scan_support import NEAR, standing_on
from lirs_wct.arrays import FloatArray
from lirs_wct.geometry.pose import Pose2
from lirs_wct.world import World

TOURS = 3
"""Tours along which scans are cast, each from another start."""
SPACING = 0.5
"""Meters between scans of a tour."""
MOST_SCANS = 120
"""Largest number of scans of a tour."""
NEIGHBORS = 0.5
"""Largest gap between neighboring hits of one surface, meters."""
LEAST_INFORMATION = 1e-4
"""Information per beam below which a scan tells nothing."""
REVISIT, AFTER = 1.0, 10.0
"""A tour revisits a place if it comes within REVISIT meters of it after AFTER meters of driving."""


@dataclass(frozen=True, kw_only=True)
class SiteFeatures:
    """Features of a site for a robot and a lidar; shares are of a scan's beams, quantiles over the scans.

    Attributes:
        walls: median share of hits on walls.
        walls_low: 10th percentile of that share.
        ground: median share of hits on ground, which looks like walls to a planar mapper.
        ground_high: 90th percentile of that share.
        tilt: root mean square of the angle between the robot's z and the vertical, degrees.
        position_information: 10th percentile of the logarithm (base 10) of the smallest eigenvalue of the
            scan's information in x and y per beam (Censi, ICRA 2007).
        yaw_information: the same of the information in yaw, given x and y, per beam and square meter.
        loops: share of the path that revisits places.
    """

    walls: float
    walls_low: float
    ground: float
    ground_high: float
    tilt: float
    position_information: float
    yaw_information: float
    loops: float

    @property
    def vector(self) -> FloatArray:
        """(8,) features in the order of FEATURES."""
        return np.array(astuple(self))


FEATURES = tuple(entry.name for entry in fields(SiteFeatures))


def site_features(world: World, robot: Robot, config: RunConfig) -> SiteFeatures:
    """Cast scans along tours of a site and return their features.

    Args:
        world: the site.
        robot: that drives, with its lidar's mount.
        config: lidar, seed and seconds of the drives.

    Raises:
        ConfigError: the robot fits nowhere in this world.
    """
    preset = make_lidar_preset(config.lidar or robot.lidar)
    caster: Caster = MeshCaster(world.mesh) if world.overhangs else RayCaster(world.surface, world.walls)
    tours = [plan_tour(world, robot, replace(config, seed=config.seed + k)).path for k in range(TOURS)]
    rows = [_scan_row(world, robot, preset, caster, pose) for tour in tours for pose in _poses(tour)]
    walls, ground, tilt, position, yaw = np.array(rows).T
    return SiteFeatures(
        walls=float(np.median(walls)),
        walls_low=float(np.percentile(walls, 10)),
        ground=float(np.median(ground)),
        ground_high=float(np.percentile(ground, 90)),
        tilt=float(np.sqrt(np.mean(tilt**2))),
        position_information=float(np.percentile(position, 10)),
        yaw_information=float(np.percentile(yaw, 10)),
        loops=float(np.mean([_revisited(tour) for tour in tours])),
    )


def _poses(path: FloatArray) -> list[Pose2]:
    """Return poses along a path, SPACING meters apart, facing ahead."""
    steps = np.hypot(*np.diff(path, axis=0).T)
    along = np.concatenate(([0.0], np.cumsum(steps)))
    at = np.linspace(0.0, along[-1], min(MOST_SCANS, 2 + int(along[-1] / SPACING)))
    x, y = np.interp(at, along, path[:, 0]), np.interp(at, along, path[:, 1])
    yaw = np.arctan2(np.gradient(y), np.gradient(x))
    return [Pose2(*values) for values in np.column_stack((x, y, yaw)).tolist()]


def _scan_row(
    world: World, robot: Robot, preset: LidarPreset, caster: Caster, pose: Pose2
) -> tuple[float, float, float, float, float]:
    """Return shares of walls and ground, tilt (deg), information in position and yaw of a scan."""
    T_world_base = standing_on(world, robot, pose)
    laser = T_world_base @ robot.T_base_laser
    directions = np.ascontiguousarray(preset.directions @ laser.rotation.T)
    ranges = caster.ranges(laser.position, directions, preset.range_max)
    hit = (ranges >= preset.range_min) & (ranges < preset.range_max)
    points = laser.position + ranges[hit, None] * directions[hit]
    near = near_obstacle(np.ascontiguousarray(points[:, :2]), world.surface, world.walls, NEAR)
    tilt = math.degrees(math.acos(min(1.0, float(T_world_base.rotation[2, 2]))))
    position, yaw = scan_information(points[:, :2] - laser.position[:2], preset.beams)
    return near.sum() / preset.beams, (~near).sum() / preset.beams, tilt, position, yaw


def scan_information(points: FloatArray, beams: int) -> tuple[float, float]:
    """Return logarithms of a scan's information in position and yaw, per beam.

    Fisher information of scan matching with unit noise (Censi, ICRA 2007): the sum of J^T J over hits, with
    J = (n, p x n) of a hit p with the normal n. The position's is the smallest eigenvalue in x and y; the
    yaw's is its Schur complement, in square meters.

    Args:
        points: (n, 2) hits in the order of the beams, relative to the sensor, meters.
        beams: in a scan.
    """
    along = np.diff(points, axis=0)
    length = np.hypot(*along.T)
    joined = (length > 0) & (length < NEIGHBORS)
    if joined.sum() < 3:
        return math.log10(LEAST_INFORMATION), math.log10(LEAST_INFORMATION)
    normals = np.column_stack((-along[joined, 1], along[joined, 0])) / length[joined, None]
    middle = (points[:-1][joined] + points[1:][joined]) / 2
    moment = middle[:, 0] * normals[:, 1] - middle[:, 1] * normals[:, 0]
    J = np.column_stack((normals, moment))
    A: Any = J.T @ J / beams
    smallest = float(np.linalg.eigvalsh(A[:2, :2])[0])
    schur = float(A[2, 2] - A[2, :2] @ np.linalg.pinv(A[:2, :2]) @ A[:2, 2])
    return math.log10(max(smallest, LEAST_INFORMATION)), math.log10(max(schur, LEAST_INFORMATION))


def _revisited(path: FloatArray) -> float:
    """Return the share of a path's points that revisit places."""
    steps = np.hypot(*np.diff(path, axis=0).T)
    along = np.concatenate(([0.0], np.cumsum(steps)))
    every = np.unique(np.searchsorted(along, np.arange(0.0, along[-1], SPACING)))
    points, at = path[every], along[every]
    near = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1)) < REVISIT
    earlier = at[None] < at[:, None] - AFTER
    return float((near & earlier).any(axis=1).mean())
