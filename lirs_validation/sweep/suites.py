"""Suites: experiments that were published, as data. A new one is a new row of SUITES."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from lirs_validation.config import RunConfig
from lirs_validation.sweep.axes import Axes, Representation
from lirs_validation.sweep.collision_experiment import CollisionExperiment
from lirs_validation.sweep.experiment import Experiment
from lirs_validation.sweep.slam_experiment import SlamExperiment
from lirs_wct.errors import unknown_name

HEIGHTMAP_BASED = Representation(terrain="hfield", rays="mujoco")
SOLID_BASED = Representation(terrain="mesh", rays="mujoco")
OURS = Representation(terrain="hfield", rays="ours")
"""The paper's two representations of a terrain as MuJoCo has them, and ours."""


@dataclass(frozen=True, kw_only=True)
class Block:
    """Experiments that belong together: some axes, and the published tables that their metrics are for."""

    axes: Axes
    tables: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Suite:
    """A published experiment.

    Attributes:
        title: what it is.
        blocks: its runs; one that two blocks name is run once.
        collisions: the worlds and robots whose contacts are checked.
        seconds: simulated time of a run.
        seeds: of the runs.
        wall_limit: wall seconds after which a hopelessly slow drive is stopped and extrapolated.
    """

    title: str
    blocks: tuple[Block, ...]
    collisions: Axes | None = None
    seconds: float = 120.0
    seeds: tuple[int, ...] = (1,)
    wall_limit: float = 120.0

    def experiments(
        self,
        *,
        seconds: float | None = None,
        seeds: tuple[int, ...] | None = None,
        wall_limit: float | None = None,
        threads: tuple[int, ...] = (1,),
    ) -> tuple[Experiment, ...]:
        """Return the suite's experiments, world by world; what is given replaces the suite's own."""
        tables: dict[RunConfig, tuple[str, ...]] = {}
        for block in self.blocks:
            axes = replace(
                block.axes,
                seconds=self.seconds if seconds is None else seconds,
                seeds=self.seeds if seeds is None else seeds,
                wall_limit=self.wall_limit if wall_limit is None else wall_limit,
                threads=threads,
            )
            for config in (run.config for run in axes.experiments()):
                tables[config] = tuple(dict.fromkeys(tables.get(config, ()) + block.tables))
        runs = [SlamExperiment(config, names) for config, names in tables.items()]
        checks = [
            CollisionExperiment(source=config.source, robot=config.robot, seed=config.seed)
            for config in ([run.config for run in self.collisions.experiments()] if self.collisions else [])
        ]
        order = list(dict.fromkeys(run.config.source for run in runs))
        found: list[SlamExperiment | CollisionExperiment] = [*runs, *checks]
        return tuple(sorted(found, key=lambda each: order.index(each.world_config.source)))


MAPPERS = ("gmapping", "hector", "cartographer")
ROBOTS = ("husky", "turtlebot2", "jackal")
WORLDS = ("simple", "medium", "advanced")


def _terrain_construction(world: str, *tables: str) -> Block:
    """Return the runs behind one of the paper's Tables II to IV and its part of Fig. 13."""
    axes = Axes(sources=(world,), mappers=MAPPERS, representations=(OURS, SOLID_BASED, HEIGHTMAP_BASED))
    return Block(axes=axes, tables=tables)


SUITES: Mapping[str, Suite] = {
    "paper": Suite(
        title="LIRS-WCT (2021), Section V and III-D: terrain representations x SLAM methods x robots",
        blocks=(
            _terrain_construction("simple", "II", "fig13a"),
            _terrain_construction("medium", "III", "fig13b"),
            _terrain_construction("advanced", "IV", "fig13c"),
            Block(
                axes=Axes(
                    sources=WORLDS, robots=ROBOTS, mappers=MAPPERS, representations=(OURS, SOLID_BASED)
                ),
                tables=("robots",),
            ),
        ),
        collisions=Axes(sources=WORLDS, robots=ROBOTS),
    ),
}


def suite_named(name: str) -> Suite:
    """Return a suite.

    Raises:
        ConfigError: there is no such suite.
    """
    if name not in SUITES:
        raise unknown_name("suite", name, SUITES)
    return SUITES[name]
