"""LIRS/Mapping-v0, deprecated: its reward counts sky, and driving straight on earns the most."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from lirs_envs.coverage import CoverageGrid
from lirs_envs.episodes.config import TIMESTEPS
from lirs_envs.lidar.casters import resolve_rays
from lirs_envs.lidar.noise import NoiseLevel
from lirs_envs.rendering.snapshot import Snapshot
from lirs_envs.rendering.views import RENDER_MODES, Views, check_render_mode
from lirs_envs.robots.catalog import make_robot
from lirs_envs.robots.command import Twist
from lirs_envs.sensing.odometry import Method, OdometryConfig
from lirs_envs.sensing.sensors import Observation, SensorNoise
from lirs_envs.simulation import Simulation
from lirs_envs.simulation_config import SimulationConfig
from lirs_wct.arrays import ByteArray, Float32Array
from lirs_wct.contact.contact_geometry import ContactGeometry
from lirs_wct.errors import SimulationError
from lirs_wct.world import World, build_world

Observed = dict[str, Any]


class MappingEnv(gym.Env[Observed, Float32Array]):
    """One robot that maps one world; a step is one period of its lidar. Deprecated: take `LIRS/Mapping-v1`.

    Observation:
        scan: (beams,) float32 metres. The space is a finite box: nothing in range (+inf in the LaserScan) is
            `range_max`, too near or invalid (-inf, NaN) is 0. `simulation.advance` returns it unabridged.
        odometry: (3,) float64 x, y, yaw of `T_odom_base`; metres, radians.
        attitude: (2,) float64 roll and pitch as the IMU says, radians.

    Action: (2,) in [-1, 1]: speed ahead and turn rate, of the robot's largest.

    Reward: square metres of a 0.25 m grid that a beam passed over for the first time; from true poses, and
    without regard to what a mapper makes of it.

    Terminated: the robot tipped over, left the world, or the simulation diverged: `info["reason"]`.

    Args:
        world: a bundled name, any other source's path, or a `World`.
        robot: name of the robot.
        lidar: name of a lidar preset; default: the robot's own.
        terrain: contact geometry: `hfield`, `mesh`, `prisms` or `convex` (see `SimulationConfig`).
        odometry: `gyro` or `ekf` (see `OdometryConfig`).
        noise: of the lidar: `none`, `simulated` or `datasheet`.
        sweep: whether scans are rolling (see `SensorNoise.rolling_scan`).
        rays: whose rays meet the world: `builtin` (also `ours`) or `mujoco` (see `SimulationConfig`).
        render_mode: `human`, `rgb_array`, `depth_array`, `map` (see `lirs_envs.rendering.views`) or None.

    A reset sets the robot on one of the world's start poses, drawn at random.
    """

    metadata = {"render_modes": list(RENDER_MODES), "render_fps": 25}  # noqa: RUF012  Gymnasium's contract

    def __init__(
        self,
        world: str | World = "simple",
        robot: str = "husky",
        *,
        lidar: str | None = None,
        terrain: ContactGeometry = "hfield",
        odometry: Method = "gyro",
        noise: NoiseLevel = "simulated",
        sweep: bool = False,
        rays: str = "builtin",
        render_mode: str | None = None,
    ) -> None:
        check_render_mode(render_mode)
        self.render_mode = render_mode
        place = world if isinstance(world, World) else _built(str(world), _stamp(str(world)))
        config = SimulationConfig(
            robot=make_robot(robot),
            lidar=lidar,
            noise=SensorNoise(odometry=OdometryConfig(method=odometry), lidar=noise, rolling_scan=sweep),
            contact_geometry=terrain,
            rays=resolve_rays(rays),
            longest_timestep=TIMESTEPS.get(robot),
        )
        self.simulation = Simulation(place, config)
        preset, limit = self.simulation.preset, np.inf
        self.metadata = self.metadata | {"render_fps": round(preset.rate)}
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.observation_space = spaces.Dict(
            {
                "scan": spaces.Box(0.0, preset.range_max, (preset.beams,), np.float32),
                "odometry": spaces.Box(-limit, limit, (3,), np.float64),
                "attitude": spaces.Box(-np.pi, np.pi, (2,), np.float64),
            }
        )
        self._views = Views()
        self._last: Observation | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observed, dict[str, Any]]:
        """Set the robot down; `options["start"]` may hold a Pose2."""
        super().reset(seed=seed)
        start = (options or {}).get("start")
        starts = self.simulation.world.spawn_poses
        if start is None and starts:
            start = starts[int(self.np_random.integers(len(starts)))]
        observation = self.simulation.reset(start, seed=int(self.np_random.integers(2**31)))
        self._coverage = CoverageGrid(self.simulation.world.surface)
        self._coverage.add(observation.scan, self.simulation.T_world_base)
        self._last = observation
        return _arrays(observation), self._info()

    def step(self, action: Float32Array) -> tuple[Observed, float, bool, bool, dict[str, Any]]:
        """Drive for one lidar period.

        Raises:
            SimulationError: `reset` was never called.
        """
        if self._last is None:
            raise SimulationError("an environment must be reset before its first step")
        robot = self.simulation.robot
        ahead, turn = np.clip(np.asarray(action, dtype=np.float64), -1.0, 1.0).tolist()
        command = Twist(ahead * robot.max_speed, turn * robot.max_turn_rate)
        try:
            observation = self.simulation.advance(command)
        except SimulationError as error:
            # The last sane observation: a diverged state has none.
            return _arrays(self._last), 0.0, True, False, self._info(str(error))
        reward = self._coverage.add(observation.scan, self.simulation.T_world_base)
        reason = self._reason()
        self._last = observation
        return _arrays(observation), reward, bool(reason), False, self._info(reason)

    def render(self) -> ByteArray | Float32Array | None:
        """Return what the render mode shows (see `lirs_envs.rendering.views.Views.render`)."""
        if self.render_mode is None:
            return None
        scan = None if self._last is None else self._last.scan
        return self._views.render(self.render_mode, Snapshot.of(self.simulation), scan=scan)

    def close(self) -> None:
        """Free what OpenGL holds, and close the window."""
        self._views.close()

    def _reason(self) -> str:
        if self.simulation.tipped:
            return "tipped over"
        return "left the world" if self.simulation.off_world else ""

    def _info(self, reason: str = "") -> dict[str, Any]:
        T = self.simulation.T_world_base.to_pose2()
        return {"T_world_base": T.as_array(), "seen_area": self._coverage.area, "reason": reason}


def _arrays(observation: Observation) -> Observed:
    scan, imu = observation.scan, observation.imu
    ranges = np.nan_to_num(scan.ranges, nan=0.0, posinf=scan.range_max, neginf=0.0)
    return {
        "scan": np.clip(ranges, 0.0, np.float32(scan.range_max)).astype(np.float32),
        "odometry": observation.odometry.as_array(),
        "attitude": np.array((imu.roll, imu.pitch)),
    }


def _stamp(source: str) -> int:
    """Return when a source was written, so that a changed file is built again."""
    path = Path(source)
    return path.stat().st_mtime_ns if path.exists() else 0


@lru_cache(maxsize=4)
def _built(source: str, stamp: int) -> World:
    """Build a source once for all environments of a process."""
    return build_world(source)
