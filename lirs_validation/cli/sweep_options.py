"""From the words of `validate` to the experiments of a sweep."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from lirs_validation.cli.build_options import mujoco_terrain
from lirs_wct.errors import ConfigError
from lirs_wct.sources.options import BuildOptions

if TYPE_CHECKING:
    from lirs_validation.sweep.experiment import Experiment

DEFAULT_SECONDS = 120.0


def listed(text: str | None, option: str, default: str) -> tuple[str, ...]:
    """Return the words of a comma-separated list.

    Raises:
        ConfigError: a word is missing.
    """
    words = tuple(word.strip() for word in (default if text is None else text).split(","))
    if not all(words):
        raise ConfigError(f"{option} must be a list such as a,b,c, got {text!r}")
    return tuple(dict.fromkeys(words))


def seeds_of(seed: int | None, seeds: str | None) -> tuple[int, ...] | None:
    """Return the seeds; None = not said.

    Raises:
        ConfigError: both options are given, or they are no seeds.
    """
    from lirs_validation.sweep.axes import read_seeds

    if seed is not None and seeds is not None:
        raise ConfigError("both name seeds: give one of --seed, --seeds")
    if seeds is not None:
        return read_seeds(seeds)
    return None if seed is None else (seed,)


def axes_experiments(
    sources: list[str],
    given: Mapping[str, str | None],
    seeds: tuple[int, ...] | None,
    seconds: float | None,
    wall_limit: float | None,
    build: BuildOptions,
) -> tuple[Experiment, ...]:
    """Return the experiments at the crossings of the axes that were given.

    Args:
        sources: worlds.
        given: axis -> what was said of it, for `robot`, `mapper`, `lidar`, `terrain` and `rays`.
        seeds: None = 1.
        seconds: None = 120.
        wall_limit: of each drive.
        build: how sources become worlds.

    Raises:
        ConfigError: an axis is empty or holds what is not legal.
    """
    from lirs_envs.lidar.casters import ALIASES, RAYS
    from lirs_validation.sweep.axes import Axes, Representation

    terrains = [mujoco_terrain(word) for word in listed(given["terrain"], "--terrain", "hfield")]
    rays = listed(given["rays"], "--rays", "builtin")
    if not set(rays) <= {*RAYS, *ALIASES}:
        raise ConfigError(f"--rays must be {' or '.join(RAYS)}, got {given['rays']!r}")
    return Axes(
        sources=tuple(sources),
        robots=listed(given["robot"], "--robot", "husky"),
        mappers=listed(given["mapper"], "--mapper", "hector"),
        lidars=(None,) if given["lidar"] is None else listed(given["lidar"], "--lidar", ""),
        representations=tuple(
            Representation(terrain=terrain, rays=ray) for terrain in terrains for ray in rays
        ),
        seeds=seeds or (1,),
        seconds=DEFAULT_SECONDS if seconds is None else seconds,
        wall_limit=wall_limit,
        build=build,
    ).experiments()


def suite_experiments(
    name: str,
    others: Mapping[str, bool],
    seeds: tuple[int, ...] | None,
    seconds: float | None,
    wall_limit: float | None,
) -> tuple[Experiment, ...]:
    """Return the experiments of a suite.

    Args:
        name: of the suite.
        others: options that a suite leaves no room for -> whether they were given.
        seeds: None = the suite's own; so for the others.
        seconds: simulated seconds of each run.
        wall_limit: of each drive.

    Raises:
        ConfigError: there is no such suite, or one of the others was given.
    """
    from lirs_validation.sweep.suites import suite_named

    suite = suite_named(name)
    clash = [option for option, given in others.items() if given]
    if clash:
        raise ConfigError(f"--suite {name} has its own worlds and axes: leave out {', '.join(clash)}")
    return suite.experiments(seconds=seconds, seeds=seeds, wall_limit=wall_limit)
