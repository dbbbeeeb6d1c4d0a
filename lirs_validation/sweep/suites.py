"""Suites: published experiments. A new one is a function and a row of SUITES."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any

from lirs_validation.config import RunConfig
from lirs_validation.sweep.collision_experiment import CollisionExperiment
from lirs_validation.sweep.experiment import Experiment
from lirs_validation.sweep.slam_experiment import SlamExperiment
from lirs_wct import BuildOptions, unknown_name


def cross(
    sources: str | tuple[str, ...],
    *,
    build: BuildOptions | None = None,
    kind: type[RunConfig] = RunConfig,
    **options: Any,
) -> tuple[RunConfig, ...]:
    """Return the config of every combination, source by source, in the order of RunConfig's fields.

    >>> [(c.mapper, c.seed) for c in cross("simple", mapper=("hector", "gmapping"), seed=(1, 2))]
    [('hector', 1), ('hector', 2), ('gmapping', 1), ('gmapping', 2)]

    Args:
        sources: one or several.
        build: how sources become worlds; None = the defaults.
        kind: class of the configs.
        **options: fields of RunConfig; a tuple holds the values to cross, anything else is one value.

    Raises:
        ConfigError: a value is not legal.
    """
    names = sorted(options, key=[f.name for f in fields(kind)].index)
    values = [options[name] if isinstance(options[name], tuple) else (options[name],) for name in names]
    worlds = (sources,) if isinstance(sources, str) else sources
    shared: dict[str, Any] = {} if build is None else {"build": build}
    return tuple(
        kind(source=source, **dict(zip(names, crossing, strict=True)), **shared)
        for source, *crossing in itertools.product(worlds, *values)
    )


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
