"""The lidar of one robot, planar or with rings, and the lidars of N robots."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from lirs_envs.lidar.noise import LidarNoise, NoiseParameters, lidar_noise, measure
from lirs_envs.lidar.obstacle_rays import WallCells, intensities
from lirs_envs.lidar.presets import LidarPreset
from lirs_envs.lidar.ray_casting import Caster, RayCaster, cast_rays
from lirs_envs.lidar.terrain_rays import TerrainMipmap
from lirs_envs.robots.control import BodyState
from lirs_wct import LaserScan, PointCloud, Pose3, SimulationError
from lirs_wct.arrays import BoolArray, Float32Array, FloatArray, IntArray, Vector3, njit

Velocity = tuple[Vector3, Vector3]
"""Velocity of base_link along the base's axes, m/s, and its rates about them, rad/s."""


class Lidar:
    """Lidar on a robot: `scan` of a planar one, `sweep` of one with rings.

    Attributes:
        returned: (rings * beams,) mask of the beams of the last sweep with a point in its cloud.

    Args:
        caster: Geometry that the beams hit.
        rng: Random generator of the noise.
        noise: Noise of the ranges; None = Gaussian with the preset's deviation.
        rolling_scan: Whether the beams are cast one after the other while the mirror turns, once a period;
            else all at once. The first beam is cast at the stamp, the others while the robot goes on at the
            velocity that it has then. The rings' beams of one angle, a column, are cast together.
    """

    def __init__(
        self,
        preset: LidarPreset,
        caster: Caster,
        T_base_laser: Pose3,
        rng: np.random.Generator,
        noise: LidarNoise | None = None,
        *,
        rolling_scan: bool = False,
    ) -> None:
        self.preset = preset
        self.caster = caster
        self.T_base_laser = T_base_laser
        self.noise = lidar_noise(preset) if noise is None else noise
        self.time_increment = preset.angle_increment / math.tau * preset.period if rolling_scan else 0.0
        self._rng = rng
        self._directions = preset.all_directions
        self._beams = self._directions @ T_base_laser.rotation.T
        self._times = np.tile(self.time_increment * np.arange(preset.beams), preset.rings)
        self.returned: BoolArray = np.zeros(0, np.bool_)
        self._ring = np.repeat(np.arange(preset.rings, dtype=np.uint16), preset.beams)
        self._column = np.tile(np.arange(preset.beams, dtype=np.uint16), preset.rings)
        self._mount = T_base_laser.position
        self._limits, self._noise = (preset.range_min, preset.range_max), self.noise.parameters
        self._normals = np.zeros(len(self._beams))
        self._uniforms = np.zeros((len(self._beams) if self.noise.draws_uniform else 0, 2))
        self._horizon = preset.horizon_beams
        self._fan = preset.angle_min, preset.angle_increment, *self._limits

    def scan(self, T_world_base: Pose3, stamp: float, velocity: Velocity | None = None) -> LaserScan:
        """Return the scan from a pose of the robot, with noise.

        Args:
            T_world_base: Pose of the robot at the first beam.
            stamp: Time of the first beam, seconds.
            velocity: Velocity of the base, for a rolling scan; None = at rest.
        """
        return self.planar_scan(self.ranges(T_world_base, velocity)[self._horizon], stamp)

    def sweep(
        self, T_world_base: Pose3, stamp: float, velocity: Velocity | None = None
    ) -> tuple[LaserScan, PointCloud]:
        """Return planar scan and cloud of one sweep (see `scan`). The scan is one ring of the cloud."""
        origin, directions = self._rays(T_world_base, velocity)
        self._draw_noise()
        exact, reflectances = self.caster.hits(origin, directions, self._limits[1])
        ranges = np.empty(len(exact), np.float32)
        measure(exact, self._normals, self._uniforms, self._limits, self._noise, ranges)
        met = self.returned = np.isfinite(ranges)
        cloud = PointCloud(
            (ranges[met, None] * self._directions[met]).astype(np.float32),
            self._ring[met],
            self._times[met].astype(np.float32),
            stamp,
            self.T_base_laser,
            intensities(ranges[met], reflectances[met]),
            self._column[met],
            (self.preset.rings, self.preset.beams),
        )
        return self.planar_scan(ranges[self._horizon], stamp), cloud

    def planar_scan(self, ranges: Float32Array, stamp: float) -> LaserScan:
        """Return the scan with ranges (beams,) of the ring nearest the horizon."""
        return LaserScan(ranges, *self._fan, stamp, self.T_base_laser, self.time_increment)

    def ranges(self, T_world_base: Pose3, velocity: Velocity | None = None) -> Float32Array:
        """Return (rings * beams,) ranges of a sweep, ring by ring from below (see `scan`)."""
        origin, directions = self._rays(T_world_base, velocity)
        self._draw_noise()
        exact = self.caster.ranges(origin, directions, self._limits[1])
        ranges = np.empty(len(exact), np.float32)
        measure(exact, self._normals, self._uniforms, self._limits, self._noise, ranges)
        return ranges

    def _draw_noise(self) -> None:
        """Draw the random numbers of a sweep."""
        self._rng.standard_normal(out=self._normals)
        if self._uniforms.size:
            self._rng.random(out=self._uniforms)

    def _rays(self, T_world_base: Pose3, velocity: Velocity | None) -> tuple[FloatArray, FloatArray]:
        """Return world origins, (3,) or (n, 3), and directions (n, 3) of the beams."""
        T = T_world_base
        if not math.isfinite(T.x + T.y + T.z + T.qw + T.qx + T.qy + T.qz):
            raise SimulationError(f"the lidar's pose must be finite, got {T_world_base}")
        quaternion, position = (T.qw, T.qx, T.qy, T.qz), (T.x, T.y, T.z)
        if self.time_increment == 0.0 or velocity is None:
            origin, directions = np.empty((1, 3)), np.empty_like(self._beams)
            transform_rays(quaternion, position, self._mount[None], self._beams, origin, directions)
            return origin[0], directions
        # The rings' beams of one angle have one frame.
        rings, columns = self.preset.rings, self.preset.beams
        R, p = moved_frames(self._times[:columns], *velocity)
        origins = np.tile(p + R @ self._mount, (rings, 1))
        directions = np.einsum("nij,rnj->rni", R, self._beams.reshape(rings, columns, 3)).reshape(-1, 3)
        transform_rays(quaternion, position, origins, directions, origins, directions)
        return origins, directions


class Lidars:
    """Lidars of N robots, each with its own noise and random stream.

    Robots that share a caster are scanned in one kernel call.

    Attributes:
        lidars: Lidar of each robot that has begun.
        ranges: (N, beams) float32 of the last planar scans (see `LaserScan`).
        clouds: Last cloud of each robot; None without rings.

    Args:
        rolling_scan: Whether scans are rolling (see `Lidar`).
    """

    def __init__(self, preset: LidarPreset, T_base_laser: Pose3, count: int, *, rolling_scan: bool) -> None:
        self._preset, self._mount, self._rolling = preset, T_base_laser, rolling_scan
        self._planar = preset.rings == 1
        self._fan = T_base_laser.position[None], preset.directions @ T_base_laser.rotation.T
        self.lidars: dict[int, Lidar] = {}
        self._rngs = [np.random.default_rng(0) for _ in range(count)]
        self._normals = np.zeros((count, preset.beams))
        self._uniforms = np.zeros((count, 0, 2))
        self._parameters = np.zeros((count, len(NoiseParameters._fields)))
        self.ranges: Float32Array = np.zeros((count, preset.beams), np.float32)
        self.clouds: list[PointCloud | None] = [None] * count

    def begin(self, i: int, caster: Caster, noise: LidarNoise, rng: np.random.Generator) -> None:
        """Start lidar `i` with its caster, noise and random stream."""
        self.lidars[i] = Lidar(self._preset, caster, self._mount, rng, noise, rolling_scan=self._rolling)
        self._rngs[i], self._parameters[i] = rng, noise.parameters
        if noise.draws_uniform and not self._uniforms.size:
            self._uniforms = np.zeros((*self.ranges.shape, 2))

    def scan(
        self, rows: IntArray, T_world_base: FloatArray, bodies: Sequence[BodyState], stamp: FloatArray
    ) -> None:
        """Scan from the poses (N, 7), x, y, z, qw, qx, qy, qz, of robots `rows` at stamps (N,), seconds."""
        together: dict[RayCaster, list[int]] = {}
        joins = len(self.ranges) > 1 and self._planar and not self._rolling
        for i in rows.tolist():
            lidar = self.lidars[i]
            if joins and isinstance(lidar.caster, RayCaster):
                together.setdefault(lidar.caster, []).append(i)
                self._rngs[i].standard_normal(out=self._normals[i])
                if self._uniforms.size:
                    self._rngs[i].random(out=self._uniforms[i])
                continue
            body, T = bodies[i], Pose3(*T_world_base[i].tolist())
            velocity = (body.velocity(), body.rates()) if self._rolling else None
            if self._planar:
                self.ranges[i] = lidar.ranges(T, velocity)
            else:
                planar, self.clouds[i] = lidar.sweep(T, float(stamp[i]), velocity)
                self.ranges[i] = planar.ranges
        for caster, group in together.items():
            _scan_rows(
                np.array(group),
                T_world_base,
                self._fan,
                (caster.terrain, caster.walls),
                (self._normals, self._uniforms, self._parameters),
                (self._preset.range_min, self._preset.range_max),
                self.ranges,
            )

    def reading(self, i: int, stamp: float) -> LaserScan:
        """Return the last planar scan of lidar `i`."""
        return self.lidars[i].planar_scan(self.ranges[i].copy(), stamp)


@njit
def _scan_rows(
    rows: IntArray,
    T_world_base: FloatArray,
    fan: tuple[FloatArray, FloatArray],
    world: tuple[TerrainMipmap, WallCells],
    noise: tuple[FloatArray, FloatArray, FloatArray],
    limits: tuple[float, float],
    ranges: Float32Array,
) -> None:
    mount, beams = fan
    normals, uniforms, parameters = noise
    origin, directions, exact = np.empty((1, 3)), np.empty_like(beams), np.empty(len(beams))
    for i in rows:
        T, p = T_world_base[i], parameters[i]
        transform_rays((T[3], T[4], T[5], T[6]), (T[0], T[1], T[2]), mount, beams, origin, directions)
        cast_rays(world[0], world[1], origin, directions, limits[1], exact)
        drawn = NoiseParameters(p[0], p[1], p[2], p[3], p[4], p[5])
        measure(exact, normals[i], uniforms[i], limits, drawn, ranges[i])


def moved_frames(times: ArrayLike, velocity: ArrayLike, rates: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return rotations (n, 3, 3) and positions (n, 3) of a moving frame since time 0.

    With constant velocity v and rates w in its own axes, the frame is at exp(t [v, w]) after a time t:
    rotation by Rodrigues' formula, translation by its integral (Lynch and Park, "Modern Robotics",
    eqs. 3.51 and 3.88).

    Args:
        times: (n,) seconds.
        velocity: (3,) constant velocity along the frame's own axes, m/s.
        rates: (3,) constant rates about the frame's own axes, rad/s.
    """
    t, v, w = (np.asarray(a, dtype=np.float64) for a in (times, velocity, rates))
    rate = float(np.linalg.norm(w))
    if rate < 1e-9:
        return np.broadcast_to(np.eye(3), (len(t), 3, 3)), t[:, None] * v
    x, y, z = w / rate
    K = np.array(((0, -z, y), (z, 0, -x), (-y, x, 0)))
    angle = (rate * t)[:, None, None]
    R = np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * (K @ K)
    G = angle * np.eye(3) + (1 - np.cos(angle)) * K + (angle - np.sin(angle)) * (K @ K)
    return R, (G @ v) / rate


@njit
def transform_rays(
    quaternion: tuple[float, float, float, float],
    position: tuple[float, float, float],
    starts: FloatArray,
    beams: FloatArray,
    origins: FloatArray,
    directions: FloatArray,
) -> None:
    """Transform ray starts and directions from the base to the world frame.

    Fills origins (m, 3) and directions (n, 3), in place if they are the same arrays.
    """
    w, x, y, z = quaternion
    a, b, c = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    d, e, f = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    g, h, i = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    for k in range(len(beams)):
        u, v, s = beams[k, 0], beams[k, 1], beams[k, 2]
        directions[k, 0], directions[k, 1] = a * u + b * v + c * s, d * u + e * v + f * s
        directions[k, 2] = g * u + h * v + i * s
    for k in range(len(starts)):
        u, v, s = starts[k, 0], starts[k, 1], starts[k, 2]
        origins[k, 0] = position[0] + (a * u + b * v + c * s)
        origins[k, 1] = position[1] + (d * u + e * v + f * s)
        origins[k, 2] = position[2] + (g * u + h * v + i * s)
