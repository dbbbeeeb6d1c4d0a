"""Warm-up of a mapper: a short synthetic drive that compiles its kernels.

The robot circles a room, tilting a little, until it comes back to a known place. Then it is displaced, so
that the rarely used parts (wider search, loop closure) are compiled too.
"""

from __future__ import annotations

import math
from importlib import import_module
from typing import Any

import numpy as np

from lirs_wct.errors import unknown_name
from lirs_wct.geometry import FloatArray, Imu, LaserScan, Pose2, Pose3
from slam_baselines.mapper import MAPPERS, make_mapper

BEAMS, FOV, RANGE = 541, math.radians(270), 20.0
CORNERS = np.array(
    ((-6, -4), (6, -4), (6, 4), (1, 4), (1, 2.5), (0, 2.5), (0, 4), (-6, 4), (-6, -4)), dtype=np.float64
)
"""The room's outline, with a pillar in its northern wall, meters."""
MOUNT = Pose3(0.2, 0.0, 0.3)
RADIUS, STEP = 2.2, 0.12
"""Of the circle that is driven, and between scans, meters."""


def warm_up(name: str, **config: Any) -> None:
    """Run a new mapper through the warm-up, on a floor and on uneven ground.

    A method's module may name in `WARM_UP` the configuration with which the warm-up reaches all kernels.

    Args:
        name: one of MAPPERS.
        **config: fields of the method's configuration, to make the warm-up shorter.

    Raises:
        ConfigError: no mapper has that name, or its configuration no such field.
    """
    if name not in MAPPERS:
        raise unknown_name("mapper", name, MAPPERS)
    config = {**getattr(import_module(MAPPERS[name].module), "WARM_UP", {}), **config}
    for uneven in (False, True):
        mapper = make_mapper(name, **config)
        start = _on_circle(0.0)
        laps = np.arange(0.0, 2.6 * math.pi, STEP / RADIUS)
        for k, angle in enumerate(laps):
            pose = _on_circle(angle)
            jump = Pose2(0.4, 0.3, 0.5) if k == len(laps) - 3 else Pose2()
            tilt = 0.03 * math.sin(3 * angle) if uneven else 0.0
            stamp = 0.2 * k
            imu = Imu(pitch=tilt, stamp=stamp) if uneven else None
            mapper.update(_scan(pose @ jump, stamp), start.inverse() @ pose, imu)
        mapper.map()
        mapper.trajectory()


def _on_circle(angle: float) -> Pose2:
    return Pose2(RADIUS * math.cos(angle) - 1, RADIUS * math.sin(angle) - 1, angle + math.pi / 2)


def _scan(T_room_base: Pose2, stamp: float) -> LaserScan:
    """Return the scan of the room's outline by a scanner on the base."""
    T_room_laser = T_room_base @ Pose2(MOUNT.x, MOUNT.y)
    angles = -FOV / 2 + FOV / (BEAMS - 1) * np.arange(BEAMS)
    heading = T_room_laser.yaw + angles
    direction = np.stack((np.cos(heading), np.sin(heading)), axis=-1)[:, None]
    a, b = CORNERS[:-1] - (T_room_laser.x, T_room_laser.y), CORNERS[1:] - (T_room_laser.x, T_room_laser.y)
    edge = b - a
    across = _cross(direction, edge)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance, along = _cross(a, edge) / across, _cross(a, direction) / across
    hit = (distance > 0) & (along >= 0) & (along <= 1)
    ranges = np.where(hit, distance, np.inf).min(axis=1).astype(np.float32)
    return LaserScan(ranges, -FOV / 2, FOV / (BEAMS - 1), 0.1, RANGE, stamp, MOUNT)


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    z: FloatArray = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return z
