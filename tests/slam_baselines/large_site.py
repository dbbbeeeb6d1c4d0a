"""A large site: streets between buildings, seen from afar and driven through with a scan almost a meter."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.scan import LaserScan
from tests.slam_baselines.synthetic import ranges_to

Array = NDArray[np.float64]
BLOCK, SETBACK = (100.0, 80.0), (12.0, 28.0)
"""Edges of the blocks between the streets' middles; least and most from there to a building, meters."""
BLOCKS = range(-1, 5), range(-1, 4)
"""Columns and rows of blocks; the streets that are driven run between them."""
CORNERS = ((0, 0), (4, 0), (4, 3), (0, 3), (0, 0), (2, 0), (2, 2), (1, 2), (1, 0))
"""Crossings that are passed, columns and rows of streets: once around, then through the middle."""
RADIUS = 6.0
"""Of the turn at a crossing, meters."""
BEAMS, RANGE = 181, 80.0
"""Beams over 180 deg, and their range, meters."""


@dataclass(frozen=True)
class SiteDrive:
    """A drive over the site.

    Attributes:
        scans: from a laser at the base's own origin.
        odometry: `T_odom_base` at each.
        truth: `T_world_base` at each.
    """

    scans: list[LaserScan]
    odometry: list[Pose2]
    truth: list[Pose2]


def drive_site(seed: int = 1, scans: int = 2000, step: float = 0.875) -> SiteDrive:
    """Drive with a scan every `step` meters, at 1 m/s; at the defaults 2,000 scans over 1,750 m."""
    rng = np.random.default_rng(seed)
    walls, truth = site(rng), street_path(step)[:scans]
    angles = np.linspace(-math.pi / 2, math.pi / 2, BEAMS)
    drive, odometry = SiteDrive([], [], truth), Pose2()
    for k, pose in enumerate(truth):
        if k:
            d = truth[k - 1].inverse() @ pose
            turn = d.yaw * (1 + rng.normal(0.01, 0.02)) + rng.normal(0, 0.002 * math.sqrt(step))
            odometry = odometry @ Pose2(d.x * (1.01 + rng.normal(0, 0.01)), d.y + rng.normal(0, 0.005), turn)
        ranges = ranges_to(_near(walls, pose), pose, angles, RANGE) + rng.normal(0, 0.02, BEAMS)
        increment = math.pi / (BEAMS - 1)
        drive.scans.append(
            LaserScan(ranges.astype(np.float32), -math.pi / 2, increment, 0.1, RANGE, k * step)
        )
        drive.odometry.append(odometry)
    return drive


def site(rng: np.random.Generator) -> Array:
    """Return (n, 4) segments x0, y0, x1, y1 of buildings, two to a block, and of trees along the streets."""
    boxes = []
    for column in BLOCKS[0]:
        for row in BLOCKS[1]:
            west, south = column * BLOCK[0], row * BLOCK[1]
            for share in ((0.0, 0.55), (0.45, 1.0)):
                w, s, e, n = rng.uniform(*SETBACK, 4) * (1, 1, -1, -1)
                w, e = west + w + share[0] * 40, west + BLOCK[0] + e - (1 - share[1]) * 40
                boxes.append((w, south + s, e, south + BLOCK[1] + n))
            for x, y in rng.uniform(7.0, 10.0, (3, 2)):
                x, y = west + rng.choice((x, BLOCK[0] - x)), south + y + rng.uniform(0, BLOCK[1] - 2 * y)
                boxes.append((x - 0.2, y - 0.2, x + 0.2, y + 0.2))
    w, s, e, n = np.array(boxes).T
    sides = ((w, s, e, s), (e, s, e, n), (e, n, w, n), (w, n, w, s))
    return np.concatenate([np.stack(side, axis=1) for side in sides])


def street_path(step: float) -> list[Pose2]:
    """Return poses every `step` meters along the streets, with rounded corners."""
    points = np.array(CORNERS) * BLOCK
    poses: list[Pose2] = []
    at = 0.0
    for k in range(len(points) - 1):
        leg = points[k + 1] - points[k]
        yaw = math.atan2(leg[1], leg[0])
        crossing = Pose2(*points[k].tolist(), yaw)
        start = RADIUS if k else 0.0
        straight = float(np.hypot(*leg)) - start - RADIUS
        while at < straight:
            poses.append(crossing @ Pose2(start + at))
            at += step
        at -= straight
        if k + 2 == len(points):
            break
        after = points[k + 2] - points[k + 1]
        turn = math.remainder(math.atan2(after[1], after[0]) - yaw, math.tau)
        corner = crossing @ Pose2(start + straight)
        side = math.copysign(1.0, turn)
        while at < RADIUS * abs(turn):
            a = at / RADIUS
            poses.append(corner @ Pose2(RADIUS * math.sin(a), side * RADIUS * (1 - math.cos(a)), side * a))
            at += step
        at -= RADIUS * abs(turn)
    return poses


def _near(walls: Array, pose: Pose2) -> Array:
    """Return the segments of which the bounding box comes within range."""
    x, y = walls[:, 0::2], walls[:, 1::2]
    dx = np.maximum(0, np.maximum(x.min(axis=1) - pose.x, pose.x - x.max(axis=1)))
    dy = np.maximum(0, np.maximum(y.min(axis=1) - pose.y, pose.y - y.max(axis=1)))
    return walls[np.hypot(dx, dy) <= RANGE]
