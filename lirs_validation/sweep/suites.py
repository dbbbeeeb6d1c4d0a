"""Suites: published experiments. A new one is a function and a row of SUITES."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from lirs_validation.config import RunConfig
from lirs_validation.sweep.axes import cross
from lirs_validation.sweep.collision_experiment import CollisionExperiment
from lirs_validation.sweep.experiment import Experiment
from lirs_validation.sweep.slam_experiment import SlamExperiment
from lirs_wct.errors import unknown_name

HEIGHTMAP_BASED: dict[str, Any] = {"terrain": "hfield", "rays": "mujoco"}
SOLID_BASED: dict[str, Any] = {"terrain": "mesh", "rays": "mujoco"}
OURS: dict[str, Any] = {"terrain": "hfield", "rays": "builtin"}
"""The paper's two representations of a terrain as MuJoCo has them, and ours."""
MAPPERS = ("gmapping", "hector", "cartographer")
ROBOTS = ("husky", "turtlebot2", "jackal")
TABLES = {"simple": ("II", "fig13a"), "medium": ("III", "fig13b"), "advanced": ("IV", "fig13c")}
"""Published tables and figures, by world."""
WALL_LIMIT = 120.0
"""Wall seconds after which a hopelessly slow drive of the paper's suite is stopped and extrapolated."""


def make_paper_suite(**options: Any) -> tuple[Experiment, ...]:
    """Return the experiments of the paper's Sections V and III-D, world by world.

    Args:
        **options: of every run, in place of the suite's own (`seconds`, `seed`, `wall_limit`, `threads`).
    """
    options = {"wall_limit": WALL_LIMIT} | options
    tables: dict[RunConfig, tuple[str, ...]] = {}
    for world, names in TABLES.items():
        for view in (OURS, SOLID_BASED, HEIGHTMAP_BASED):
            tables |= dict.fromkeys(cross(world, mapper=MAPPERS, **view, **options), names)
        for view in (OURS, SOLID_BASED):
            for config in cross(world, robot=ROBOTS, mapper=MAPPERS, **view, **options):
                tables[config] = (*tables.get(config, ()), "robots")
    experiments: list[SlamExperiment | CollisionExperiment] = [
        *(SlamExperiment(config, names) for config, names in tables.items()),
        *(CollisionExperiment(source=world, robot=robot) for world in TABLES for robot in ROBOTS),
    ]
    return tuple(sorted(experiments, key=lambda each: tuple(TABLES).index(each.world_config.source)))


SUITES: Mapping[str, Callable[..., tuple[Experiment, ...]]] = {"paper": make_paper_suite}


def make_suite(name: str, **options: Any) -> tuple[Experiment, ...]:
    """Return the experiments of a suite (see `make_paper_suite`).

    Raises:
        ConfigError: there is no such suite, or an option is not legal.
    """
    if name not in SUITES:
        raise unknown_name("suite", name, SUITES)
    return SUITES[name](**options)
