"""Every robot against its figures: rest, speed, stopping, no tunnelling, cost of a step.

    python benchmarks/robots.py [SOURCE ...] [--robot NAME ...] [--terrain hfield,mesh,prisms]
                                [--seconds 60] [--quick] [--json FILE]

A robot is driven at random at full speed for a minute in each world and on each kind of contact terrain; when
it has tipped or left the world it is set down anew, elsewhere. Then the recorded controls go through MuJoCo's
step alone: microseconds a step and real-time factor (RTF), best of several. SOURCE is anything that `lirs-wct
build` takes; default: the bundled worlds.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from lirs_envs.drive import Twist
from lirs_envs.robots import ROBOTS, Robot, make_robot
from lirs_envs.simulation import Simulation
from lirs_wct.bundled import RECIPES
from lirs_wct.errors import WctError
from lirs_wct.heightfield import HeightField
from lirs_wct.pose import Pose2
from lirs_wct.starts import start_poses
from lirs_wct.world import World, build_world

LIDAR = "lms111"
"""The same for all: one tick is 40 ms."""
IMPACT = 0.010
"""Metres of penetration allowed a metre a second of impact."""


def flat() -> World:
    z = np.zeros((201, 201), np.float32)
    return World("flat", "terrain", HeightField.centred(z, (0.1, 0.1)), starts=(Pose2(),))


def figures(robot: Robot) -> dict[str, float]:
    """Drift at rest, and what is reached of full speed and full turn rate, on level ground."""
    sim = Simulation(flat(), robot, lidar=LIDAR)
    sim.reset()
    start = sim.T_world_base
    for _ in range(250):
        sim.advance(Twist())
    end = sim.T_world_base
    found = {
        "drift_mm": 1e3 * math.hypot(end.x - start.x, end.y - start.y),
        "height_error_mm": 1e3 * (end.z - robot.base_height),
    }
    for key, command in (("speed", Twist(robot.max_speed)), ("turn_rate", Twist(0.0, robot.max_turn_rate))):
        # The quickest needs the longer side of the plane.
        sim.reset(Pose2(-9.0 if key == "speed" else 0.0, 0.0))
        ramp = robot.max_speed / robot.max_acceleration if key == "speed" else 1.5
        for _ in range(math.ceil((ramp + (0.4 if robot.flies else 1.2)) / sim.period)):
            sim.advance(command)
        way = turned = 0.0
        for _ in range(10):
            before = sim.T_world_base.to_pose2()
            sim.advance(command)
            moved = before.inverse() @ sim.T_world_base.to_pose2()
            way, turned = way + moved.x, turned + moved.yaw
        reached, full = (way, robot.max_speed) if key == "speed" else (turned, robot.max_turn_rate)
        found[f"{key}_reached"] = reached / (10 * sim.period) / full
    return found


def wander(sim: Simulation, starts: list[Pose2], seconds: float) -> dict[str, Any]:
    """Drive at random; return penetrations of all legs, and the cost of the longest."""
    rng, robot = np.random.default_rng(0), sim.robot
    depths: list[float] = []
    best, driven, tips, left, sunk = math.inf, 0.0, 0, 0.0, 0
    ticks = math.ceil(seconds / sim.period)
    done = leg = 0
    while done < ticks and leg < 40:
        try:
            sim.reset(starts[leg % len(starts)])
        except WctError:
            leg += 1
            continue
        last = sim.T_world_base
        for k in range(ticks - done):
            if k % 40 == 0:
                ahead, turn = rng.choice((-1.0, 1.0, 1.0)), rng.uniform(-1, 1) * rng.integers(2)
            sim.advance(Twist(ahead * min(robot.max_speed, 3.0), turn * robot.max_turn_rate))
            done, here = done + 1, sim.T_world_base
            driven, last = driven + math.hypot(here.x - last.x, here.y - last.y), here
            ground = float(sim.world.surface.height_at(here.x, here.y))
            sunk += here.z + 0.05 < ground
            if sim.tipped or sim.off_world:
                tips += sim.tipped
                break
        depths += sim._watch.penetrations
        if sim.time > left and len(sim.controls):
            left = sim.time
            steps = sim.time / sim.body.timestep
            best = min(sim.replay().seconds for _ in range(3)) / steps
        leg += 1
    if not depths:
        raise WctError("nowhere to start")
    depth = np.array(depths)
    return {
        "us_per_step": 1e6 * best,
        "rtf": sim.body.timestep / best,
        "penetration_p999_mm": 1e3 * float(np.quantile(depth, 0.999)),
        "penetration_max_mm": 1e3 * float(depth.max()),
        "sunk": int(sunk),
        "tipped": tips,
        "metres": driven,
        "seconds": done * sim.period,
    }


def run(source: str, robot: Robot, terrain: str, seconds: float) -> dict[str, Any]:
    world = build_world(source)
    free = world.traversable(clearance=robot.radius + 0.1, max_slope=0.9 * robot.max_slope)
    begun = time.perf_counter()
    sim = Simulation(world, robot, lidar=LIDAR, terrain=terrain)  # type: ignore[arg-type]
    built = time.perf_counter() - begun
    found = wander(sim, list(start_poses(free)), seconds)
    top = min(robot.max_speed, 3.0)
    # A fall from a ledge of a metre comes to more than the fastest of them drives.
    within = found["penetration_p999_mm"] <= 10 and found["penetration_max_mm"] <= 1e3 * IMPACT * (top + 4.4)
    return {
        "world": world.name,
        "robot": robot.name,
        "terrain": terrain,
        "build_s": built,
        **found,
        "ok": bool(within and not found["sunk"] and found["us_per_step"] <= 60),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("sources", nargs="*", default=list(RECIPES))
    parser.add_argument("--robot", action="append", choices=list(ROBOTS))
    parser.add_argument("--terrain", default="hfield")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--quick", action="store_true", help="10 s instead of 60")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    seconds, console = (10.0 if options.quick else options.seconds), Console()
    robots = [make_robot(name) for name in options.robot or ROBOTS]
    facts = {robot.name: figures(robot) for robot in robots}
    table = Table("robot", "drift 10 s [mm]", "height [mm]", "speed", "turn rate", title="on level ground")
    for name, f in facts.items():
        shares = (f"{100 * f[key]:.1f} %" for key in ("speed_reached", "turn_rate_reached"))
        table.add_row(name, f"{f['drift_mm']:.3f}", f"{f['height_error_mm']:.2f}", *shares)
    console.print(table)
    columns = ("us_per_step", "rtf", "penetration_p999_mm", "penetration_max_mm", "sunk", "tipped", "metres")
    table = Table("robot", "world", "terrain", "us", "RTF", "p99.9 mm", "max mm", "sunk", "tips", "m", "ok")
    rows = []
    for robot in robots:
        for source in options.sources:
            for terrain in options.terrain.split(","):
                try:
                    row = run(source, robot, terrain, seconds)
                except WctError as error:
                    console.print(f"{robot.name}, {source}, {terrain}: {error}", highlight=False)
                    continue
                rows.append(row)
                cells = [f"{row[c]:.1f}" if isinstance(row[c], float) else str(row[c]) for c in columns]
                table.add_row(robot.name, row["world"], terrain, *cells, "yes" if row["ok"] else "no")
    console.print(table)
    if options.json:
        options.json.write_text(json.dumps({"figures": facts, "drives": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
