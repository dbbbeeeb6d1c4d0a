"""A new terrain per episode: milliseconds of processor time to make it, to put it in, and to reset.

    python benchmarks/terrain.py [--robot husky] [--difficulty 0.5] [--quick] [--json FILE]

The terrains have 257 x 257 nodes. `heights` is their way into the model that wheels touch, `mipmap` into what
the lidar sees, `replace` both with all checks, `reset` the robot let go and settled, first scan included;
`episode` = replace + reset. Medians over the repetitions.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from lirs_envs.generators.terrain import HEIGHT_RANGE, KINDS, GeneratedTerrain, generate
from lirs_envs.lidar.ray_casting import RayCaster
from lirs_envs.robots.robot import make_robot
from lirs_envs.simulation import Simulation
from lirs_envs.simulation_config import SimulationConfig

SHARES = "generate", "heights", "mipmap", "replace", "reset", "episode"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--robot", default="husky")
    parser.add_argument("--difficulty", type=float, default=0.5)
    parser.add_argument("--quick", action="store_true", help="5 repetitions instead of 30")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    repeats = 5 if options.quick else 30
    rows = {kind: measure(kind, options.difficulty, options.robot, repeats) for kind in KINDS}
    shown = Table("kind", *SHARES, title=f"a new terrain under a {options.robot} (ms of processor time)")
    for kind, row in rows.items():
        shown.add_row(kind, *(f"{row[share]:.2f}" for share in SHARES))
    Console().print(shown)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


def measure(kind: str, difficulty: float, robot: str, repeats: int) -> dict[str, float]:
    """Return the median milliseconds of each share."""
    rng = np.random.default_rng(1)
    first = generate(kind, difficulty, rng)
    config = SimulationConfig(robot=make_robot(robot), height_range=HEIGHT_RANGE)
    simulation = Simulation(first.world(), config)
    samples = [_episode(simulation, kind, difficulty, rng) for _ in range(repeats + 1)][1:]
    row = dict(zip(SHARES, 1e3 * np.median(samples, axis=0), strict=False))
    return row | {"episode": row["replace"] + row["reset"]}


def _episode(
    simulation: Simulation, kind: str, difficulty: float, rng: np.random.Generator
) -> tuple[float, ...]:
    terrain: GeneratedTerrain | None = None

    def make() -> None:
        nonlocal terrain
        terrain = generate(kind, difficulty, rng)

    made = _seconds(make)
    assert terrain is not None
    surface, heights, start = terrain.surface, terrain.heights, terrain.start
    return (
        made,
        _seconds(lambda: simulation.body.replace_surface(surface)),
        _seconds(lambda: RayCaster(surface)),
        _seconds(lambda: simulation.replace_terrain(heights, (start,))),
        _seconds(simulation.reset),
    )


def _seconds(work: Callable[[], object]) -> float:
    begun = time.process_time()
    work()
    return time.process_time() - begun


if __name__ == "__main__":
    main()
