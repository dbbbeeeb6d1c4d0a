"""Suites: published experiments (a function and a row of SUITES), and files with cases."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from lirs_validation.config import NOISE_FILES, RUN_AXES, RunConfig
from lirs_validation.sweep.experiment import CollisionExperiment, Experiment, SlamExperiment
from lirs_wct import BuildOptions, unknown_name
from lirs_wct.errors import SourceError, reason_of
from lirs_wct.formats.yaml_text import load_yaml


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
        **options: options of every run, in place of the suite's own (`seconds`, `seed`, `wall_limit`).
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


CASE = "case.yaml"
"""File with the options of a run, in the folder of its world."""
SUITE_FILES = (".yaml", ".yml")
CASE_OPTIONS = (*RUN_AXES, "seconds", "stand")


def case_options(source: str | Path) -> dict[str, Any]:
    """Return the options of a case's run; empty if the source is no case.

    Raises:
        SourceError: the file cannot be used; the message begins with its path.
    """
    path = Path(source) / CASE
    if not path.is_file():
        return {}
    options = read_yaml_fields(path).get("run")
    if not isinstance(options, dict) or not set(options) <= set(CASE_OPTIONS):
        raise SourceError(
            f"{path}: `run` must hold options of a run ({', '.join(CASE_OPTIONS)}), got {options!r}"
        )
    if str(options.get("noise", "")).endswith(NOISE_FILES):
        options["noise"] = str(path.parent / options["noise"])
    return options


def suite_folders(path: Path) -> tuple[str, ...]:
    """Return the folders of a suite: the list `cases` of a YAML file.

    Raises:
        SourceError: the file or a case cannot be used; the message begins with its path.
    """
    names = read_yaml_fields(path).get("cases")
    if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names):
        raise SourceError(f"{path}: `cases` must be a list of folders, got {names!r}")
    for name in names:
        if not (path.parent / name / CASE).is_file():
            raise SourceError(f"{path}: {name} is no case: it has no {CASE}")
    return tuple(str(path.parent / name) for name in names)


def read_yaml_fields(path: Path) -> Mapping[str, Any]:
    """Return the names and values of a YAML file.

    Raises:
        SourceError: it cannot be read, or holds anything else or nothing; the message begins with its path.
    """
    try:
        entry = load_yaml(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise SourceError(f"{path}: {reason_of(error)}") from error
    if not isinstance(entry, dict) or not entry:
        raise SourceError(f"{path}: must hold names and values, got {entry!r:.40}")
    return entry
