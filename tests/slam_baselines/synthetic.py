"""Worlds that can be computed on paper, and what a laser sees in them."""

import math

import numpy as np
from numpy.typing import NDArray

from lirs_envs.lidar.ray_casting import RayCaster
from lirs_wct.geometry import HeightField
from lirs_wct.geometry.pose import Pose2, Pose3
from lirs_wct.geometry.scan import Imu, LaserScan
from slam_baselines.mapper import Mapper

Array = NDArray[np.float64]
ROOM = np.array(((-4.0, -3.0, 5.0, -3.0), (5.0, -3.0, 5.0, 4.0), (5.0, 4.0, -4.0, 4.0),
                 (-4.0, 4.0, -4.0, -3.0), (1.0, 1.5, 2.5, 1.5), (2.5, 1.5, 2.5, 2.2),
                 (-2.0, -1.5, -1.0, -2.0)))  # fmt: skip
"""A room of 9 x 7 m with two things in it: (n, 4) segments x0, y0, x1, y1, meters."""
MOUNT = Pose3.from_rpy(0.22, 0.0, 0.32, 0.0, 0.0, 0.0)
BASE_HEIGHT = 0.13
BLOCKS = (
    (5.0, 1.0, 0.6, 2.0),
    (-4.5, 1.0, 0.5, 3.0),
    (3.5, 6.0, 2.0, 0.5),
    (-6.0, 6.0, 0.6, 2.5),
    (1.0, -4.5, 2.5, 0.4),
    (0.5, 11.0, 3.0, 0.5),
    (8.0, -3.0, 0.5, 3.0),
)
"""Center and size of what stands on the hills, away from the drive, meters."""


def ranges_to(segments: Array, pose: Pose2, angles: Array, most: float = 30.0) -> Array:
    """Distances from a pose along beams to the nearest segment; inf beyond `most`."""
    d = np.stack((np.cos(angles + pose.yaw), np.sin(angles + pose.yaw)), axis=-1)[:, None]
    a, e = segments[None, :, :2] - (pose.x, pose.y), segments[None, :, 2:] - segments[None, :, :2]
    cross = d[..., 0] * e[..., 1] - d[..., 1] * e[..., 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (a[..., 0] * e[..., 1] - a[..., 1] * e[..., 0]) / cross
        s = (a[..., 0] * d[..., 1] - a[..., 1] * d[..., 0]) / cross
    t = np.where((t > 0) & (s >= 0) & (s <= 1), t, np.inf).min(axis=1)
    return np.where(t <= most, t, np.inf)


def room_scan(pose: Pose2, stamp: float, rng: np.random.Generator, beams: int = 361) -> LaserScan:
    """A scan of 270 deg in the room, with noise of 1 cm, from a laser on the base's own origin."""
    start = -0.75 * math.pi
    step = 1.5 * math.pi / (beams - 1)
    r = ranges_to(ROOM, pose, start + step * np.arange(beams)) + rng.normal(0, 0.01, beams)
    return LaserScan(r.astype(np.float32), start, step, 0.05, 30.0, stamp)


def loop(n: int, radius: float = 1.5) -> list[Pose2]:
    """A closed drive of n poses through the room, from the origin of the map frame."""
    turn = np.linspace(0, 2 * math.pi, n)
    return [Pose2(radius * math.sin(a), radius * (1 - math.cos(a)) - 0.5, float(a)) for a in turn]


def drive_room(mapper: Mapper, *, odometry: bool = True, n: int = 240) -> Array:
    """Drive a mapper round the loop; return errors (n, 3) in the map frame."""
    rng = np.random.default_rng(0)
    path = loop(n)
    errors, walked = [], Pose2()
    for k, pose in enumerate(path):
        if k:
            step = path[k - 1].inverse() @ pose
            walked = walked @ Pose2(step.x * 1.05, step.y, step.yaw * 1.03)
        estimate = mapper.update(room_scan(pose, 0.1 * k, rng), walked if odometry else None, None)
        error = (path[0].inverse() @ pose).inverse() @ estimate
        errors.append(error.as_array())
    return np.array(errors)


def wavy(relief: float, nodes: int = 601, cell: float = 0.05) -> HeightField:
    """Long hills of a given relief with blocks of 1.2 m on them, on a square of 30 m."""
    axis = (np.arange(nodes) - (nodes - 1) / 2) * cell
    x, y = np.meshgrid(axis, -axis)
    z = relief / 4 * (np.sin(0.45 * x + 0.3) + np.cos(0.5 * y)) + 0 * x
    for cx, cy, w, h in BLOCKS:
        block = (np.abs(x - cx) < w / 2) & (np.abs(y - cy) < h / 2)
        z = np.where(block, z[block].max() + 1.2, z)
    return HeightField.centered(z.astype(np.float32), (cell, cell))


def on_ground(surface: HeightField, pose: Pose2) -> Pose3:
    """The base's pose where it stands on the ground, leaning as the ground does under its wheels."""
    wheels = np.array(((0.25, 0.28), (0.25, -0.28), (-0.25, 0.28), (-0.25, -0.28)))
    at = pose.apply(wheels)
    A = np.column_stack((np.ones(4), wheels))
    height, along, across = np.linalg.lstsq(A, surface.height_at(at[:, 0], at[:, 1]), rcond=None)[0].tolist()
    pitch = -math.atan(along)
    roll = math.atan(across * math.cos(pitch))
    return Pose3.from_rpy(pose.x, pose.y, height + BASE_HEIGHT, roll, pitch, pose.yaw)


class Drive:
    """Scans, odometry, attitude and truth of a drive over hilly ground at 25 Hz.

    In a turn the robot slides downhill, by `slide` meters per radian and unit of slope; no wheel sees it.
    """

    def __init__(
        self, surface: HeightField, seconds: float, rng: np.random.Generator, slide: float = 0.0
    ) -> None:
        caster = RayCaster(surface)
        angles = -0.75 * math.pi + 1.5 * math.pi / 540 * np.arange(541)
        beams = np.stack((np.cos(angles), np.sin(angles), 0 * angles), axis=-1)
        self.scans: list[LaserScan] = []
        self.odometry: list[Pose2] = []
        self.imus: list[Imu] = []
        self.truth: list[Pose3] = []
        pose, odometry = Pose2(0.0, 0.0, 0.2), Pose2()
        for k in range(int(seconds / 0.04)):
            rate = 0.5 * math.sin(0.35 * k * 0.04)
            T = on_ground(surface, pose)
            ray = T @ MOUNT
            r = caster.cast(ray.position, beams @ ray.rotation.T, 20.0) + rng.normal(0, 0.012, 541)
            self.scans.append(
                LaserScan(
                    r.astype(np.float32), float(angles[0]), 1.5 * math.pi / 540, 0.5, 20.0, k * 0.04, MOUNT
                )
            )
            white = rng.normal(0, math.radians(0.1), 2)
            self.imus.append(
                Imu(T.roll + white[0], T.pitch + white[1] + 0.001, (0.0, 0.0, rate), stamp=k * 0.04)
            )
            self.odometry.append(odometry)
            self.truth.append(T)
            step = 0.8 * 0.04
            slid = slide * abs(rate) * 0.04
            pose = pose @ Pose2(
                step * math.cos(T.pitch) + slid * math.sin(T.pitch), -slid * math.sin(T.roll), rate * 0.04
            )
            noise = rng.normal(0, 1, 2)
            odometry = odometry @ Pose2(step * (1.02 + 0.03 * noise[0]), 0.0, rate * 0.04 + 1e-5 * noise[1])
