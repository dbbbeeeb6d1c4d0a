"""The command `collide`: collision validation of robots in worlds."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from click.exceptions import Exit

from lirs_validation.cli.progress import RUN_FAILED, err, out, progress_bar
from lirs_validation.cli.sources import World, map_logs, sources_argument
from lirs_validation.config import DRIVABLE, RunConfig
from lirs_wct.contact import ContactGeometry
from lirs_wct.errors import WctError
from lirs_wct.option import Options, option
from lirs_wct.sources.source import BuildOptions

if TYPE_CHECKING:
    from lirs_validation.collision.validation import CollisionVerdict


@dataclass(frozen=True, kw_only=True)
class CollideOptions(Options):
    """Worlds, robots and drives of `collide`."""

    sources: tuple[str, ...] = sources_argument()
    robot: tuple[str, ...] = option(("husky", "jackal", "turtlebot2"), "Robots.", metavar="R,R,...")
    terrain: tuple[ContactGeometry, ...] = option(
        ("hfield",), "Contact geometry: hfield, mesh, prisms, convex.", metavar="T,T,..."
    )
    seconds: float = option(60.0, "Simulated seconds to drive each.", check=DRIVABLE)
    seed: tuple[int, ...] = option((1,), "Seeds of the random drives.", metavar="N,N-M")
    output: Path = option(Path("out"), "Folder for collisions.json and collisions.csv.")


def collide(options: CollideOptions, build: World) -> None:
    """Drive robots at random into obstacles and evaluate contacts: penetration, energy, slopes.

    Examples:
    lirs-wct collide simple advanced --robot husky,turtlebot2 --seconds 60 -o out/
    """
    from lirs_validation.collision.validation import write_verdicts
    from lirs_validation.report.collision_tables import verdicts_table

    sources, build = map_logs(options.sources, build, options.output)
    verdicts: list[CollisionVerdict] = []
    refused: list[WctError] = []
    try:
        for found in _check(options, sources, build):
            if isinstance(found, WctError):
                refused.append(found)
            else:
                verdicts.append(found)
    finally:
        if verdicts:
            out.print(verdicts_table(verdicts))
            for path in write_verdicts(options.output, verdicts):
                out.print(f"{path}", soft_wrap=True, highlight=False)
    if not verdicts:
        raise refused[0]
    for error in refused:
        err.print(f"left out: {error}", markup=False, highlight=False, soft_wrap=True, style="yellow")
    if refused or not all(verdict.passed for verdict in verdicts):
        raise Exit(RUN_FAILED)


def _check(
    options: CollideOptions, sources: tuple[str, ...], build: BuildOptions
) -> Iterator[CollisionVerdict | WctError]:
    """Yield the verdict on each robot, terrain and seed in each world."""
    from lirs_envs.robots.robot import make_robot
    from lirs_validation.collision.validation import check_collisions
    from lirs_validation.experiment.scenario import build_scenario

    robots = [make_robot(name) for name in options.robot]
    checks = list(itertools.product(robots, options.terrain, options.seed))
    steps = len(sources) * len(checks)
    done = 0
    with progress_bar("collide", err) as progress:
        for source in sources:
            progress(f"building {source}", done / steps)
            config = RunConfig(source=source, seconds=options.seconds, build=build)
            try:
                world = build_scenario(config).world
            except WctError as error:
                yield error
                done += len(checks)
                continue
            for who, where, seed in checks:
                progress(f"{source}, {who.name} on {where}", done / steps)
                try:
                    yield check_collisions(world, who, terrain=where, seconds=options.seconds, seed=seed)
                except WctError as error:
                    yield error
                done += 1
