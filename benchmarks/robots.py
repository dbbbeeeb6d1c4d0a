"""Every robot against its figures: rest, speed, stopping, slopes, flight, no tunnelling, cost of a step.

    python benchmarks/robots.py [SOURCE ...] [--robot NAME ...] [--terrain hfield,mesh,prisms]
                                [--seconds 60] [--seed 1] [--quick] [--json FILE]

On made-up ground first, each figure beside its limit. Then collision validation (`lirs-wct collide`): a robot
is driven at random at full speed for a minute in each world and on each kind of contact terrain, and every
step is judged. Last the cost: commands recorded on a tour go through MuJoCo's step alone, best of several.
SOURCE is anything that `lirs-wct build` takes; default: the bundled worlds.
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.robot_figures import LIDAR, Row, figures
from lirs_envs.robots.robot import ROBOTS, Robot, Twist, make_robot
from lirs_envs.simulation import Simulation
from lirs_envs.simulation_config import SimulationConfig
from lirs_validation.collision.validation import CollisionVerdict, check_collisions
from lirs_validation.config import RunConfig
from lirs_validation.experiment.scenario import build_scenario
from lirs_validation.report.collision_tables import verdicts_table
from lirs_wct.errors import WctError
from lirs_wct.sources.bundled import RECIPES
from lirs_wct.world import World

DEAREST = 60.0
"""Microseconds that a step may cost."""


def cost(world: World, robot: Robot, terrain: str, seconds: float) -> tuple[float, float]:
    """Microseconds a step and real-time factor of MuJoCo's stepping alone."""
    sim = Simulation(world, SimulationConfig(robot=robot, lidar=LIDAR, contact_geometry=terrain))  # type: ignore[arg-type]
    rng, command = np.random.default_rng(0), Twist()
    sim.reset()
    for k in range(math.ceil(seconds / sim.period)):
        if k % 40 == 0:
            ahead, turn = rng.choice((-1.0, 1.0, 1.0)), rng.uniform(-1, 1) * rng.integers(2)
            command = Twist(ahead * min(robot.max_speed, 3.0), turn * robot.max_turn_rate)
        sim.advance(command)
        if sim.tipped or sim.off_world:
            break
    replays = [sim.replay() for _ in range(5)]
    best = min(r.seconds for r in replays) / replays[0].simulated
    return 1e6 * best * sim.body.timestep, 1 / best


def print_figures(console: Console, robots: list[Robot]) -> dict[str, list[Row]]:
    table, found = Table("robot", "figure", "is", "legal", "", title="on made-up ground"), {}
    for robot in robots:
        found[robot.name] = figures(robot)
        for what, value, legal, kept in found[robot.name]:
            table.add_row(robot.name, what, f"{value:.2f}", legal, "yes" if kept else "NO")
    console.print(table)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("sources", nargs="*", default=list(RECIPES))
    parser.add_argument("--robot", action="append", choices=list(ROBOTS))
    parser.add_argument("--terrain", default="hfield")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--quick", action="store_true", help="10 s instead of 60")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    seconds, console = (10.0 if options.quick else options.seconds), Console()
    robots = [make_robot(name) for name in options.robot or ROBOTS]
    found_figures = print_figures(console, robots)
    verdicts: list[CollisionVerdict] = []
    costs: list[dict[str, Any]] = []
    table = Table("world", "terrain", "robot", "us a step", "legal", "RTF", title="MuJoCo's step alone")
    for source in options.sources:
        world = build_scenario(RunConfig(source=source)).world
        for terrain in options.terrain.split(","):
            for robot in robots:
                try:
                    found = check_collisions(
                        world, robot, terrain=terrain, seconds=seconds, seed=options.seed
                    )
                    us, rtf = cost(world, robot, terrain, min(seconds, 20.0))
                except WctError as error:
                    console.print(f"{robot.name}, {terrain}: {error}", highlight=False)
                    continue
                verdicts.append(found)
                costs.append(
                    {"world": world.name, "terrain": terrain, "robot": robot.name, "us": us, "rtf": rtf}
                )
                table.add_row(
                    world.name, terrain, robot.name, f"{us:.1f}", f"at most {DEAREST:g}", f"{rtf:.0f}"
                )
    console.print(verdicts_table(verdicts), table)
    if options.json:
        entry = {"figures": found_figures, "collisions": [v.as_dict() for v in verdicts], "costs": costs}
        options.json.write_text(json.dumps(entry, indent=1) + "\n")


if __name__ == "__main__":
    main()
