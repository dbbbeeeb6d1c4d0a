"""Cost of MuJoCo's stepping alone: microseconds a step and real-time factor (RTF), world by world.

    python benchmarks/physics.py [SOURCE ...] [--robot husky] [--quick] [--json FILE]

A robot wanders at full speed, turns away from what it runs into; the recorded wheel speeds then go through
MuJoCo's step alone. Best of several, since other programs on the machine only ever slow one down. SOURCE is
anything that `lirs-wct build` takes.
"""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from lirs_envs.robots.robot import Twist, make_robot
from lirs_envs.simulation import Simulation
from lirs_envs.simulation_config import SimulationConfig
from lirs_wct.export.mjcf import TERRAIN_GROUP
from lirs_wct.sources.build import build_world
from lirs_wct.sources.bundled import RECIPES


def wander(sim: Simulation, seconds: float, seed: int = 0) -> float:
    """Drive at random; return the meters driven."""
    rng = np.random.default_rng(seed)
    sim.reset()
    ahead, driven, last, since = 1.0, 0.0, sim.T_world_base, 0.0
    command = Twist(1.0)
    for k in range(math.ceil(seconds / sim.period)):
        if k % 50 == 0:
            ahead = -ahead if k and since < 0.3 else ahead
            command, since = Twist(ahead * rng.uniform(0.5, 1.0), rng.uniform(-1, 1)), 0.0
        sim.advance(command)
        here = sim.T_world_base
        step = math.hypot(here.x - last.x, here.y - last.y)
        driven, since, last = driven + step, since + step, here
        if sim.tipped or sim.off_world:
            break
    return driven


def measure(source: str, robot: str, seconds: float, repeats: int) -> dict[str, Any]:
    world = build_world(source)
    sim = Simulation(world, SimulationConfig(robot=make_robot(robot)), seed=1)
    driven = wander(sim, seconds)
    replays = [sim.replay() for _ in range(repeats)]
    best = min(r.seconds for r in replays)
    simulated = replays[0].simulated
    steps = simulated / sim.body.timestep
    per_second = 1000 / sim.period
    return {
        "world": world.name,
        "contact": asdict(sim.contact),
        "boxes": int((sim.body.model.geom_group == TERRAIN_GROUP).sum()) - 1,
        "us_per_step": 1e6 * best / steps,
        "rtf": simulated / best,
        "meters": driven,
        "simulated": simulated,
        "physics_ms": per_second * float(np.median(sim.timing.physics)),
        "sensors_ms": per_second * float(np.median(sim.timing.sensors)),
        "collisions": asdict(sim.collisions),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("sources", nargs="*", default=list(RECIPES))
    parser.add_argument("--robot", default="husky")
    parser.add_argument("--quick", action="store_true", help="10 s instead of 60")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    seconds, repeats = (10.0, 3) if options.quick else (60.0, 7)
    rows = [measure(source, options.robot, seconds, repeats) for source in options.sources]
    table = Table(
        "world", "contact cell [m]", "boxes", "us a step", "RTF", "pen. 99.9 % [mm]", "max [mm]", "m"
    )
    for row in rows:
        contact, found = row["contact"], row["collisions"]
        table.add_row(
            str(row["world"]),
            f"{max(contact['cell']):.3f}",
            str(row["boxes"]),
            f"{row['us_per_step']:.1f}",
            f"{row['rtf']:.0f}",
            f"{1e3 * found['penetration_p999']:.1f}",
            f"{1e3 * found['max_penetration']:.1f}",
            f"{row['meters']:.0f}",
        )
    Console().print(table)
    if options.json:
        options.json.write_text(json.dumps({"robot": options.robot, "physics": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
