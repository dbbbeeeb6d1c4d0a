"""A short drive of a Husky with a ring lidar, for the adapters' tests."""

from functools import cache

from lirs_envs.robots.robot import Twist, make_robot
from lirs_envs.sensing.sensors import Observation, SensorNoise
from lirs_envs.simulation import Simulation
from lirs_envs.simulation_config import SimulationConfig
from lirs_wct.geometry.pose import Pose3, Trajectory
from lirs_wct.sources.build import build_world


@cache
def drive(scans: int, *, rolling: bool = False) -> tuple[list[Observation], Trajectory]:
    """Return what was read on an arc through `medium`, and the true poses in the first base frame."""
    config = SimulationConfig(
        robot=make_robot("husky"), lidar="vlp16", noise=SensorNoise(rolling_scan=rolling)
    )
    sim = Simulation(build_world("medium"), config, seed=1)
    read, poses = [sim.reset()], [sim.pose()]
    for _ in range(scans - 1):
        read.append(sim.advance(Twist(0.6, 0.15)))
        poses.append(sim.pose())
    T_map_world: Pose3 = poses[0].inverse()
    return read, Trajectory.from_poses([o.scan.stamp for o in read], poses).moved(T_map_world)
