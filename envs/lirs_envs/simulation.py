"""One robot in one world, stepped from laser scan to laser scan. No Gymnasium in here."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence

import numpy as np

from lirs_envs.checks import check_arguments, check_command, check_seed, check_start
from lirs_envs.collisions import Collisions, ContactMonitor, check_divergence
from lirs_envs.lidar.casters import Rays, check_rays, make_casters
from lirs_envs.lidar.presets import make_lidar_preset
from lirs_envs.model import RobotModel
from lirs_envs.placement import resolve_start, standing_pose
from lirs_envs.props import Prop, StaticRobot
from lirs_envs.robots.command import Twist, Waypoint
from lirs_envs.robots.drive import Drive
from lirs_envs.robots.flight import QuadrotorController
from lirs_envs.robots.robot import Robot
from lirs_envs.sensing.sensors import Observation, SensorNoise, Sensors
from lirs_envs.timing import Replay, Timing
from lirs_wct.arrays import FloatArray
from lirs_wct.contact.contact_geometry import ContactGeometry
from lirs_wct.contact.contact_grid import ContactGrid
from lirs_wct.errors import SimulationError
from lirs_wct.geometry.pose import Pose2, Pose3
from lirs_wct.world import World

CONTROL_PERIOD = 0.008
"""Longest time between two updates of the wheel speeds, seconds."""
SETTLING = 0.6
"""Time that a robot is given to come to rest after it was set down, seconds."""
STAYS = 0.1
"""A robot that moves farther than this while it settles cannot stand there, metres."""


class Simulation:
    """A robot with its sensors in a world; `reset` comes first.

    Attributes:
        period: time between two scans, seconds; one `advance`.
        preset: figures of the LRF.
        terrain: what MuJoCo touches.
        body: MuJoCo's model of robot and world.
        casters: what the LRF sees of the world, and of what else stands there; for sensors of your own.
        timing: wall-clock seconds since the reset.

    Args:
        world: where.
        robot: who.
        lidar: name of an LRF preset; default: the robot's own.
        seed: of every random number; same seed and same commands, same bytes.
        noise: of all sensors.
        props: things and parked robots that stand in the world; touched, and seen by the LRF.
        terrain: what MuJoCo touches: `hfield`, `mesh` (the same, and the mesh is seen), `prisms` or `convex`.
        rays: whose rays meet the world: `ours`, or `mujoco` for comparison: those of its hfield, or with
            terrain `mesh` those of its mesh. Noise and all else are the same.

    Raises:
        ConfigError: no LRF or rays of that name, a negative seed, or a terrain that does not fit the world.
    """

    def __init__(
        self,
        world: World,
        robot: Robot,
        *,
        lidar: str | None = None,
        seed: int = 0,
        noise: SensorNoise | None = None,
        props: Sequence[Prop | StaticRobot] = (),
        terrain: ContactGeometry = "hfield",
        rays: Rays = "ours",
    ) -> None:
        self._noise = SensorNoise() if noise is None else noise
        check_arguments(world, robot, seed, self._noise)
        check_rays(rays)
        self.world = world
        self.robot = robot
        self.preset = make_lidar_preset(lidar or robot.lidar)
        self.period = self.preset.period
        self.terrain = terrain
        self.body = body = RobotModel(
            world, robot, self.period, CONTROL_PERIOD, props, terrain, rays == "mujoco"
        )
        self.casters = make_casters(world, rays, bool(props), body.model, body.data)
        self._seed = seed
        self._start_over(None)

    def _start_over(self, seed: int | None) -> None:
        """Forget all that was recorded; draw noise anew."""
        self._seed = self._seed if seed is None else seed
        self._sensors = Sensors(self.robot, self.body, self.preset, self.casters, self._noise, self._seed)
        robot, body = self.robot, self.body
        self._drive = QuadrotorController(robot, body, self.world.surface) if robot.flies else Drive(robot)
        self._watch = ContactMonitor(self.body.wheel_geoms, self.body.own_geoms)
        self._controls: list[tuple[float, ...]] = []
        self._initial: FloatArray | None = None
        self.timing = Timing()

    def reset(self, start: Pose2 | None = None, *, seed: int | None = None) -> Observation:
        """Set the robot at rest on the ground; time, records and odometry begin anew.

        Args:
            start: where; None = the world's first start pose.
            seed: of the noise; None = as before, so that the same run comes again.

        Raises:
            ConfigError: the pose is not finite, or the seed no whole number from 0 up.
            SimulationError: the robot cannot stand there.
        """
        self._initial = None
        check_start(start)
        check_seed(self._seed if seed is None else seed)
        start = resolve_start(self.world, start)
        self.body.settle(standing_pose(self.world, self.robot, start), SETTLING)
        there = self.body.pose()
        check_divergence(self.body.data)
        if math.hypot(there.x - start.x, there.y - start.y) > STAYS or self.tipped:
            raise SimulationError(
                f"{self.robot.name} does not stay at ({start.x:.2f}, {start.y:.2f}): "
                f"it slid or tipped to ({there.x:.2f}, {there.y:.2f})"
            )
        self._start_over(seed)
        self._initial = self.body.state()
        return self._sensors.observe(0.0, self.period)

    def advance(self, command: Twist | Waypoint) -> Observation:
        """Drive for one LRF period; return what the robot then knows.

        Raises:
            ConfigError: the command is not finite.
            SimulationError: the simulation diverged, or was never reset.
        """
        if self._initial is None:
            raise SimulationError("a simulation must be reset before it is advanced")
        check_command(self.robot, command)
        body, clock, physics, sensors = self.body, time.perf_counter, 0.0, 0.0
        for steps in body.substeps:
            dt = steps * body.timestep
            control = self._drive.update(command, self._sensors.yaw_rate, dt)
            self._controls.append(control)
            begun = clock()
            body.step(control, steps)
            stepped = clock()
            self._watch.look(body.data, dt)
            watched = clock()
            self._sensors.dead_reckon(dt)
            physics += stepped - begun
            sensors += clock() - watched
        check_divergence(body.data)
        begun = clock()
        observation = self._sensors.observe(self.time, self.period)
        self.timing.physics.append(physics)
        self.timing.sensors.append(sensors + clock() - begun)
        return observation

    @property
    def T_world_base(self) -> Pose3:  # noqa: N802  a frame pair
        """True pose of base_link."""
        return self.body.pose()

    @property
    def time(self) -> float:
        """Seconds since the reset."""
        return len(self._controls) // len(self.body.substeps) * self.period

    @property
    def tipped(self) -> bool:
        """Whether the robot leans by more than 60 deg or lies on its back."""
        p = self.body.pose()
        return 1 - 2 * (p.qx * p.qx + p.qy * p.qy) < 0.5

    @property
    def off_world(self) -> bool:
        """Whether base_link is beyond the world's border."""
        p = self.body.pose()
        west, south, east, north = self.world.surface.bounds
        return not (west <= p.x <= east and south <= p.y <= north)

    @property
    def contact(self) -> ContactGrid:
        """The grid that wheels touch, and by how much it differs from the surface that the LRF sees."""
        return self.body.contact

    @property
    def collisions(self) -> Collisions:
        """Contacts since the reset."""
        return self._watch.summary()

    @property
    def controls(self) -> FloatArray:
        """(n, 2) speeds of left and right wheels, rad/s, or (n, rotors) thrusts, newtons; a row an update."""
        width = len(self.robot.rotors) or 2
        return np.array(self._controls, dtype=np.float64).reshape(-1, width)

    def replay(self) -> Replay:
        """Send the recorded controls through MuJoCo's step alone; the simulation stays as it is.

        Raises:
            SimulationError: nothing was driven since the reset.
        """
        if self._initial is None or not self._controls:
            raise SimulationError("nothing was driven since the reset: there is nothing to replay")
        seconds, pose = self.body.replay(self._initial, self._controls)
        return Replay(seconds, self.time, pose)

    def replay_rtf(self) -> float:
        """Return simulated seconds over wall-clock seconds of the replay."""
        replay = self.replay()
        return replay.simulated / replay.seconds
