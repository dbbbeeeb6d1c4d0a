"""What a picture shows: a world, and where robot, props and walkers are at one moment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lirs_envs.simulation import Simulation
from lirs_envs.simulation_config import SimulationConfig
from lirs_wct.arrays import FloatArray
from lirs_wct.geometry.pose import Pose2, Pose3
from lirs_wct.world import World


@dataclass(frozen=True, kw_only=True)
class Snapshot:
    """A moment of a simulation.

    Attributes:
        world: around the robot.
        config: robot, props and number of walkers.
        qpos: (nq,) MuJoCo's positions of robot and props.
        walkers: (n, 3) middles of the walkers, meters.
        goal: that is marked; None = none.
    """

    world: World
    config: SimulationConfig
    qpos: FloatArray
    walkers: FloatArray
    goal: Pose2 | None = None

    @staticmethod
    def of(simulation: Simulation, goal: Pose2 | None = None) -> Snapshot:
        """Return what a simulation is like now."""
        walkers = simulation.walkers
        return Snapshot(
            world=simulation.world,
            config=simulation.config,
            qpos=simulation.body.data.qpos.copy(),
            walkers=np.zeros((0, 3)) if walkers is None else walkers.centers.copy(),
            goal=goal,
        )

    @property
    def T_world_base(self) -> Pose3:  # noqa: N802  a frame pair
        """Pose of base_link."""
        x, y, z, qw, qx, qy, qz = self.qpos[:7].tolist()
        return Pose3(x, y, z, qw, qx, qy, qz)
