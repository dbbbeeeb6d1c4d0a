"""Cost of moving obstacles: processor time of a step with walkers over one without.

    python benchmarks/actors.py [--world medium] [--robot husky] [--actors 50] [--quick]

A step is one period of the lidar: physics, odometry, scan. Both simulations are driven alike from the same
pose, by turns in rounds of a simulated second, and the ratio is the median over the rounds.
"""

from __future__ import annotations

import time

import numpy as np

from benchmarks.steps import arguments
from lirs_envs.robots.robot import Twist, make_robot
from lirs_envs.simulation import Simulation
from lirs_envs.simulation_config import SimulationConfig
from lirs_wct.sources.build import build_world


def main() -> None:
    """Measure and print."""
    options = arguments(__doc__, world="medium", robot="husky", actors=50, quick=False)
    world, robot = build_world(options.world), make_robot(options.robot)
    pair = [Simulation(world, SimulationConfig(robot=robot, actors=n)) for n in (0, options.actors)]
    times = np.array([[drive(s, k) for s in pair] for k in range(-1, 10 if options.quick else 60)])[1:]
    without, with_walkers = 1e6 * np.median(times, axis=0) * pair[0].period
    ratio = np.median(times[:, 1] / times[:, 0])
    print(
        f"{options.actors} walkers on {options.world}: a step takes {ratio:.3f} x the time "
        f"({without:.0f} -> {with_walkers:.0f} us)"
    )


def drive(simulation: Simulation, number: int) -> float:
    """Drive a round of a second; return seconds of processor time."""
    rng, starts = np.random.default_rng(number + 1), simulation.worlds[0].spawn_poses
    simulation.reset(starts[number % len(starts)], seed=number + 1)
    command = Twist(rng.uniform(0.3, 0.8), rng.uniform(-1, 1))
    begun = time.process_time()
    for _ in range(round(1 / simulation.period)):
        simulation.advance(command)
    return time.process_time() - begun


if __name__ == "__main__":
    main()
