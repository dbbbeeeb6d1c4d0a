"""A corridor that leads around a block, and scans in it."""

import math

import numpy as np

from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.scan import LaserScan
from tests.slam_baselines.synthetic import ranges_to

OUTER, INNER = 9.0, 6.0
"""Half edges of a corridor that leads around a block, meters."""


def box(half_x, half_y, x=0.0, y=0.0):
    c = [
        (x - half_x, y - half_y),
        (x + half_x, y - half_y),
        (x + half_x, y + half_y),
        (x - half_x, y + half_y),
    ]
    return [(*c[i], *c[(i + 1) % 4]) for i in range(4)]


CUPBOARDS = ((8.7, 3), (6.3, -4), (2, 8.6), (-5, 6.4), (-8.6, -1), (-3, -8.5), (4, -6.4))
CORRIDOR = np.array(
    box(OUTER, OUTER) + box(INNER, INNER) + [s for x, y in CUPBOARDS for s in box(0.3, 0.4, x, y)]
)
"""The corridor, with a cupboard here and there."""


def corridor_scan(pose, stamp, rng, beams=181):
    start, step = -0.75 * math.pi, 1.5 * math.pi / (beams - 1)
    r = ranges_to(CORRIDOR, pose, start + step * np.arange(beams), 6.0) + rng.normal(0, 0.01, beams)
    return LaserScan(r.astype(np.float32), start, step, 0.05, 6.0, stamp)


def ring(rounds, step=0.15):
    """Along the middle of the corridor with rounded corners, from the middle of the east side."""
    half, radius = (OUTER + INNER) / 2, 1.0
    side, corner = 2 * (half - radius), radius * math.pi / 2
    poses = []
    for s in np.arange(0, rounds * 4 * (side + corner), step) + side / 2:
        k, rest = divmod(s, side + corner)
        along, angle = min(rest, side), max(0.0, rest - side) / radius
        local = Pose2(half, along - side / 2, math.pi / 2) @ Pose2(
            radius * math.sin(angle), radius * (1 - math.cos(angle)), angle
        )
        poses.append(Pose2(0, 0, k % 4 * math.pi / 2) @ local)
    return poses
