"""Lidar scans of N robots.

Robots that share a caster are scanned in one kernel call.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lirs_envs.lidar.lidar import BaseVelocity, Lidar, transform_rays
from lirs_envs.lidar.obstacle_rays import WallCells
from lirs_envs.lidar.presets import LidarNoise, NoiseParameters, measure
from lirs_envs.lidar.ray_casting import Caster, RayCaster, cast_rays
from lirs_envs.lidar.terrain_rays import TerrainMipmap
from lirs_envs.robots.body_state import BodyState
from lirs_envs.simulation_config import SimulationConfig
from lirs_wct.arrays import Float32Array, FloatArray, IntArray, njit
from lirs_wct.geometry import LaserScan, Pose3


class Lidars:
    """Lidars of N robots, each with its own noise and random stream.

    Only the planar scan of a lidar with rings is simulated (see `lidar.lidar.Lidar`).

    Attributes:
        ranges: (N, beams) float32 of the last scans (see `LaserScan`).
    """

    def __init__(self, config: SimulationConfig, count: int) -> None:
        preset, mount = config.preset, config.robot.T_base_laser
        self._config = config
        self._fan = mount.position[None], preset.directions @ mount.rotation.T
        self._limits = preset.range_min, preset.range_max
        self._lidars: dict[int, Lidar] = {}
        self._rngs = [np.random.default_rng(0) for _ in range(count)]
        self._normals = np.zeros((count, preset.beams))
        self._uniforms = np.zeros((count, 0, 2))
        self._parameters = np.zeros((count, len(NoiseParameters._fields)))
        self._rolling = False
        self.ranges: Float32Array = np.zeros((count, preset.beams), np.float32)

    def begin(self, i: int, caster: Caster, noise: LidarNoise, rng: np.random.Generator) -> None:
        """Start lidar `i` with its caster, noise and random stream."""
        config = self._config
        lidar = Lidar(
            config.preset.planar,
            caster,
            config.robot.T_base_laser,
            rng,
            noise,
            rolling_scan=config.noise.rolls(config.preset.planar),
        )
        self._lidars[i], self._rngs[i] = lidar, rng
        self._parameters[i], self._rolling = noise.parameters, bool(lidar.time_increment)
        if noise.draws_uniform and not self._uniforms.size:
            self._uniforms = np.zeros((*self.ranges.shape, 2))

    def scan(self, rows: IntArray, T_world_base: FloatArray, bodies: Sequence[BodyState]) -> None:
        """Scan from the poses (N, 7) of robots `rows`.

        Args:
            rows: indices of the robots.
            T_world_base: (N, 7) x, y, z, qw, qx, qy, qz.
            bodies: state of each robot; read for rolling scans only.
        """
        together: dict[RayCaster, list[int]] = {}
        for i in rows.tolist():
            lidar = self._lidars[i]
            if isinstance(lidar.caster, RayCaster) and not self._rolling:
                together.setdefault(lidar.caster, []).append(i)
                continue
            body = bodies[i]
            velocity = BaseVelocity(body.velocity(), body.rates()) if self._rolling else None
            self.ranges[i] = lidar.ranges(Pose3(*T_world_base[i].tolist()), velocity)
        for caster, group in together.items():
            self._scan_together(caster, np.array(group), T_world_base)

    def reading(self, i: int, stamp: float) -> LaserScan:
        """Return the last scan of lidar `i`."""
        return self._lidars[i].reading(self.ranges[i].copy(), stamp)

    def _scan_together(self, caster: RayCaster, rows: IntArray, T_world_base: FloatArray) -> None:
        for i in rows.tolist():
            rng = self._rngs[i]
            rng.standard_normal(out=self._normals[i])
            if self._uniforms.size:
                rng.random(out=self._uniforms[i])
        _scan_rows(
            rows,
            T_world_base,
            self._fan,
            (caster.terrain, caster.walls),
            (self._normals, self._uniforms, self._parameters),
            self._limits,
            self.ranges,
        )


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
