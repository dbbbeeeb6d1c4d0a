"""A robot without physics, and places to drive it in."""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from lirs_validation.experiment.drive import Driver
from lirs_wct.geometry import OccupancyGrid
from lirs_wct.geometry.pose import Pose2

ROBOT, MARGIN = 0.61, 0.15
DT = 0.04
"""Seconds a tick."""


@dataclass(frozen=True)
class Ride:
    """What a ride left behind: (n, 3) poses and the meters driven."""

    poses: np.ndarray
    length: float

    def on_free(self, grid: OccupancyGrid) -> np.ndarray:
        """(n,) whether the robot's center was in a free cell."""
        cells = np.clip(grid.cells(self.poses[:, :2]), 0, np.array(grid.shape) - 1)
        return grid.free[cells[:, 0], cells[:, 1]]


def ride(
    driver: Driver,
    start: Pose2,
    seconds: float,
    *,
    yaw_gain: float = 1.0,
    slip: float = 0.03,
    seed: int = 0,
    blocked: Callable[[Pose2], bool] = lambda pose: False,
) -> Ride:
    """Drive a Husky without physics: 3 m/s^2, 6 rad/s^2, a yaw gain, random slip; it stops where blocked."""
    rng = np.random.default_rng(seed)
    pose, v, w, length = start, 0.0, 0.0, 0.0
    poses = [start.as_array()]
    for tick in range(round(seconds / DT)):
        twist = driver.command(pose, tick * DT)
        assert abs(twist.v) <= 1.0
        assert abs(twist.omega) <= 2.0
        v += float(np.clip(twist.v - v, -3.0 * DT, 3.0 * DT))
        w += float(np.clip(yaw_gain * twist.omega - w, -6.0 * DT, 6.0 * DT))
        noise = rng.normal(1.0, slip, 2)
        moved = pose @ Pose2(v * DT * float(noise[0]), 0.0, w * DT * float(noise[1]))
        if blocked(moved):
            moved, v = Pose2(pose.x, pose.y, moved.yaw), 0.0
        length += pose.distance(moved)
        pose = moved
        poses.append(pose.as_array())
    return Ride(np.array(poses), length)


def field(seed: int, obstacles: int = 100, side: float = 50.0) -> tuple[OccupancyGrid, OccupancyGrid]:
    """Random obstacles: where the center may be with margin, and where the robot touches nothing."""
    rng = np.random.default_rng(seed)
    n = int(side / 0.1)
    solid = np.zeros((n, n), np.uint8)
    for _ in range(obstacles):
        corner = rng.uniform(0, side, 2) / 0.1
        size, angle = rng.uniform(4, 20, 2), float(rng.uniform(0, 180))
        box = cv2.boxPoints(((corner[0], corner[1]), (size[0], size[1]), angle))
        cv2.fillPoly(solid, [box.astype(np.int32)], 1)
    distance = (
        cv2.distanceTransform(1 - np.pad(solid, 1, constant_values=1), cv2.DIST_L2, 5)[1:-1, 1:-1] * 0.1
    )
    origin = Pose2(-side / 2, -side / 2)
    near, far = (np.where(distance > c, 0.0, 1.0) for c in (ROBOT, ROBOT + MARGIN))
    return tuple(OccupancyGrid.from_probability(p, 0.1, origin) for p in (far, near))  # type: ignore[return-value]


def corridor(length: float = 20.0, width: float = 1.0) -> OccupancyGrid:
    p = np.ones((int(width / 0.1) + 2, int(length / 0.1) + 2))
    p[1:-1, 1:-1] = 0.0
    return OccupancyGrid.from_probability(p, 0.1)
