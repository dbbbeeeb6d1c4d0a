"""Cost of every robot's step: commands of a random drive go through MuJoCo's step alone, best of several.

    python benchmarks/robots.py [SOURCE ...] [--robot NAME ...] [--terrain hfield,mesh,prisms]

SOURCE is anything that `lirs-wct build` takes; default: the bundled worlds.
"""

from __future__ import annotations

import math

import numpy as np

from benchmarks.steps import arguments, print_rows
from lirs_envs.robots.robot import ROBOTS, Robot, Twist, make_robot
from lirs_envs.simulation import Simulation
from lirs_envs.simulation_config import SimulationConfig
from lirs_validation.config import RunConfig
from lirs_validation.experiment.scenario import build_scenario
from lirs_wct.errors import WctError
from lirs_wct.sources.bundled import RECIPES
from lirs_wct.world import World

SECONDS = 20.0
"""Simulated seconds of a drive."""
LIDAR = "lms111"
"""The same for all: one tick is 40 ms."""

DEAREST = 60.0
"""Microseconds that a step may cost."""


def cost(world: World, robot: Robot, terrain: str) -> tuple[float, float]:
    """Microseconds a step and real-time factor of MuJoCo's stepping alone."""
    sim = Simulation(world, SimulationConfig(robot=robot, lidar=LIDAR, contact_geometry=terrain))  # type: ignore[arg-type]
    rng, command = np.random.default_rng(0), Twist()
    sim.reset()
    for k in range(math.ceil(SECONDS / sim.period)):
        if k % 40 == 0:
            ahead, turn = rng.choice((-1.0, 1.0, 1.0)), rng.uniform(-1, 1) * rng.integers(2)
            command = Twist(ahead * min(robot.max_speed, 3.0), turn * robot.max_turn_rate)
        sim.advance(command)
        if sim.find_tipped()[0] or sim.off_world()[0]:
            break
    replays = [sim.replay() for _ in range(5)]
    best = min(r.seconds for r in replays) / replays[0].simulated
    return 1e6 * best * sim.body.timestep, 1 / best


def main() -> None:
    """Measure and print."""
    options = arguments(__doc__, "sources", sources=list(RECIPES), robot=list(ROBOTS), terrain="hfield")
    robots = [make_robot(name) for name in options.robot]
    rows = []
    for source in options.sources:
        world = build_scenario(RunConfig(source=source)).world
        for terrain in options.terrain.split(","):
            for robot in robots:
                try:
                    us, rtf = cost(world, robot, terrain)
                except WctError as error:
                    print(f"{robot.name}, {terrain}: {error}")
                    continue
                row = {"world": world.name, "terrain": terrain, "robot": robot.name}
                rows.append(row | {f"us a step, at most {DEAREST:g}": us, "RTF": rtf})
    print_rows(rows, "MuJoCo's step alone")


if __name__ == "__main__":
    main()
