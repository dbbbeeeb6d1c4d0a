"""The axes of a sweep, and the experiments at their crossings."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field

from lirs_validation.config import TOUR, Attitude, RunConfig
from lirs_validation.sweep.slam_experiment import SlamExperiment
from lirs_wct.contact.contact_geometry import ContactGeometry
from lirs_wct.sources.options import BuildOptions


@dataclass(frozen=True, kw_only=True)
class Representation:
    """How a world is represented: what is touched, and whose rays see it."""

    terrain: ContactGeometry = "hfield"
    rays: str = "ours"


@dataclass(frozen=True, kw_only=True)
class Axes:
    """What to cross; every combination is an experiment, a source's experiments beside each other.

    Attributes:
        sources: worlds.
        robots: names.
        mappers: names, or `module:name` of your own.
        lidars: names of LRF presets; None = the robot's own.
        representations: representations.
        attitudes: what mappers are told of roll and pitch.
        drivers: who drives.
        actors: numbers of walkers.
        threads: of a drive.
        seeds: of every random number.
        seconds: simulated time to drive.
        wall_limit: wall seconds after which a drive is stopped.
        build: how sources become worlds.
    """

    sources: tuple[str, ...]
    robots: tuple[str, ...] = ("husky",)
    mappers: tuple[str, ...] = ("hector",)
    lidars: tuple[str | None, ...] = (None,)
    representations: tuple[Representation, ...] = (Representation(),)
    attitudes: tuple[Attitude, ...] = ("imu",)
    drivers: tuple[str, ...] = (TOUR,)
    actors: tuple[int, ...] = (0,)
    threads: tuple[int, ...] = (1,)
    seeds: tuple[int, ...] = (1,)
    seconds: float = 120.0
    wall_limit: float | None = None
    build: BuildOptions = field(default_factory=BuildOptions)

    def experiments(self, tables: tuple[str, ...] = ()) -> tuple[SlamExperiment, ...]:
        """Return the experiments.

        Raises:
            ConfigError: a config is not legal.
        """
        crossings = itertools.product(
            self.sources,
            self.representations,
            self.robots,
            self.lidars,
            self.drivers,
            self.actors,
            self.mappers,
            self.attitudes,
            self.seeds,
            self.threads,
        )
        return tuple(SlamExperiment(self._config(*crossing), tables) for crossing in crossings)

    def _config(
        self,
        source: str,
        representation: Representation,
        robot: str,
        lidar: str | None,
        driver: str,
        actors: int,
        mapper: str,
        attitude: Attitude,
        seed: int,
        threads: int,
    ) -> RunConfig:
        """Return the config at a crossing, whose values come in the order of `experiments`."""
        return RunConfig(
            source=source,
            robot=robot,
            mapper=mapper,
            lidar=lidar,
            terrain=representation.terrain,
            rays=representation.rays,
            seconds=self.seconds,
            seed=seed,
            wall_limit=self.wall_limit,
            attitude=attitude,
            driver=driver,
            actors=actors,
            threads=threads,
            build=self.build,
        )
