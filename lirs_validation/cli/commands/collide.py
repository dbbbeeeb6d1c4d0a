"""The command `collide`: collision validation of robots in worlds."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lirs_validation.cli.progress import RUN_FAILED, err, out, progress_bar
from lirs_validation.cli.typer_options import Sources, mujoco_terrain
from lirs_validation.config import RunConfig, SourceOptions
from lirs_wct.errors import WctError
from lirs_wct.option import read_names, read_numbers

if TYPE_CHECKING:
    from lirs_envs.robots.robot import Robot
    from lirs_validation.collision.validation import CollisionVerdict
    from lirs_wct.contact.contact_geometry import ContactGeometry


def collide(
    sources: Sources,
    robot: Annotated[str, typer.Option(metavar="R,R,...", help="Robots.")] = "husky,jackal,turtlebot2",
    terrain: Annotated[
        str, typer.Option(metavar="T,T,...", help="Contact geometry: hfield, mesh, prisms, convex.")
    ] = "hfield",
    seconds: Annotated[float, typer.Option(help="Simulated seconds to drive each.")] = 60.0,
    seeds: Annotated[str, typer.Option(metavar="N,N-M", help="Seeds of the random drives.")] = "1",
    output: Annotated[
        Path, typer.Option("-o", "--output", help="Folder for collisions.json and collisions.csv.")
    ] = Path("out"),
    *,
    options: SourceOptions,
) -> None:
    """Drive robots at random into obstacles and evaluate contacts: penetration, energy, slopes."""
    from lirs_envs.robots.robot import make_robot
    from lirs_validation.collision.validation import write_verdicts
    from lirs_validation.report.collision_tables import verdicts_table

    robots = [make_robot(name) for name in read_names(robot, "--robot")]
    terrains = [mujoco_terrain(name) for name in read_names(terrain, "--terrain")]
    verdicts: list[CollisionVerdict] = []
    refused: list[WctError] = []
    try:
        for found in _make_experiments(
            sources, options, robots, terrains, seconds, read_numbers(seeds, "--seeds")
        ):
            if isinstance(found, WctError):
                refused.append(found)
            else:
                verdicts.append(found)
    finally:
        if verdicts:
            out.print(verdicts_table(verdicts))
            for path in write_verdicts(output, verdicts):
                out.print(f"{path}", soft_wrap=True, highlight=False)
    if not verdicts:
        raise refused[0]
    for error in refused:
        err.print(f"left out: {error}", markup=False, highlight=False, soft_wrap=True, style="yellow")
    if refused or not all(verdict.passed for verdict in verdicts):
        raise typer.Exit(RUN_FAILED)


def _make_experiments(
    sources: list[str],
    options: SourceOptions,
    robots: list[Robot],
    terrains: list[ContactGeometry],
    seconds: float,
    seeds: tuple[int, ...],
) -> Iterator[CollisionVerdict | WctError]:
    """Yield an experiment for each robot, terrain and seed in each world."""
    from lirs_validation.collision.validation import check_collisions
    from lirs_validation.experiment.scenario import build_scenario

    checks = list(itertools.product(robots, terrains, seeds))
    steps = len(sources) * len(checks)
    done = 0
    with progress_bar("collide", err) as progress:
        for source in sources:
            progress(f"building {source}", done / steps)
            config = RunConfig(source=source, seconds=seconds, build=options)
            try:
                world = build_scenario(config).world
            except WctError as error:
                yield error
                done += len(checks)
                continue
            for who, where, seed in checks:
                progress(f"{source}, {who.name} on {where}", done / steps)
                try:
                    yield check_collisions(world, who, terrain=where, seconds=seconds, seed=seed)
                except WctError as error:
                    yield error
                done += 1
