"""Control and odometry with one object per robot: flight, and the Kalman filter."""

from __future__ import annotations

import numpy as np

from lirs_envs.batch.bodies import Bodies, BodyView
from lirs_envs.robots.command import Twist
from lirs_envs.robots.flight import QuadrotorController
from lirs_envs.sensing.motion_sensors import add_motion
from lirs_envs.sensing.odometry import FlowOdometry, WheelOdometry
from lirs_envs.sensing.sensors import SensorNoise, make_odometry
from lirs_wct.arrays import FloatArray, IntArray
from lirs_wct.geometry.heightfield import HeightField


class FlightControllers:
    """Rotor thrusts of N quadrotors."""

    def __init__(self, bodies: Bodies, surfaces: list[HeightField]) -> None:
        self._bodies, self._surfaces = bodies, surfaces
        self._controllers: list[QuadrotorController | None] = [None] * bodies.count

    def begin(self, i: int) -> None:
        """Create the controller of quadrotor `i` at its present pose."""
        view = BodyView(self._bodies, i)
        self._controllers[i] = QuadrotorController(self._bodies.robot, view, self._surfaces[i])

    def update(
        self, ids: IntArray, commands: FloatArray, rates: FloatArray, dt: float, ctrl: FloatArray
    ) -> None:
        """Fill the controls (N, nu) to hold for `dt` seconds.

        Commands (N, 3) are speed, turn rate and climb.
        """
        for i in ids.tolist():
            controller = self._controllers[i]
            assert controller is not None, "begin comes first"
            v, omega, climb = commands[i].tolist()
            ctrl[i] = controller.update(Twist(v, omega, climb), float(rates[i, 2]), dt)


class Odometries:
    """Odometry `T_odom_base` of N robots with one odometry object each.

    Attributes:
        pose: (N, 3) x, y, yaw, meters and radians.
    """

    def __init__(self, bodies: Bodies, noise: SensorNoise) -> None:
        self._views = [BodyView(bodies, i) for i in range(bodies.count)]
        self._robot, self._noise = bodies.robot, noise
        self._odometries: list[WheelOdometry | FlowOdometry | None] = [None] * bodies.count
        self._angles = [(0.0, 0.0)] * bodies.count
        self.pose = np.zeros((bodies.count, 3))

    def begin(self, i: int, qpos: FloatArray, rng: np.random.Generator) -> None:
        """Begin the odometry of robot `i` where it stands."""
        self._odometries[i] = make_odometry(self._robot, self._noise, rng)
        self._angles[i] = self._views[i].wheel_angles()
        self.pose[i] = 0.0

    def integrate(
        self, ids: IntArray, qpos: FloatArray, rates: FloatArray, attitude: FloatArray, dt: float
    ) -> None:
        """Add the motion of the last `dt` seconds. `rates` (N, 3) and `attitude` (N, 2) are measured."""
        for i in ids.tolist():
            odometry = self._odometries[i]
            assert odometry is not None, "begin comes first"
            x, y, z = rates[i].tolist()
            roll, pitch = attitude[i].tolist()
            self._angles[i] = add_motion(
                odometry, self._views[i], ((x, y, z), roll, pitch), self._angles[i], dt
            )

    def read(self, ids: IntArray) -> None:
        """Update the poses of robots `ids`."""
        for i in ids.tolist():
            odometry = self._odometries[i]
            assert odometry is not None, "begin comes first"
            self.pose[i] = odometry.read().as_array()
